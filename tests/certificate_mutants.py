"""Certificates changed somewhere, anywhere: numbers nudged, rows dropped, signs flipped."""

import copy
import json
import random
from fractions import Fraction
from functools import cache

import pytest
from certificate_oracle import holds_in_floats

from jaxtube.synthesis.proof_file import FILE
from jaxtube.synthesis.proof_search import PROGRAMS, load_checker

NUDGE = Fraction(1, 10**6)

HARMLESS = {
    "period": "a period for which everything is proved as well",
    "track": "a track for which everything is proved as well",
    "lever_arm": "a lever arm for which W holds as well",
    "noise": "other noise, for which W holds as well",
    "slips": "other slips, for which W holds as well",
    "sideslip": "other sideslip, for which W holds as well",
    "wheel_speeds": "wheels of other speeds that can do what is asked as well",
    "constraints": "other limits that caps and noise keep as well",
    "name": "another name",
    "bands": "the same bands in another order, or promises of fewer of them",
    "bands.errors": "other caps that the proof has room for",
    "bands.u1": "other caps that the proof has room for",
    "bands.u2": "other caps that the proof has room for",
    "bands.coupling": "another coupling that the proof has room for",
    "bands.gains": "other gains under which the set is invariant as well",
    "bands.regions": "other speeds for which everything is proved as well",
    "bands.disturbance": "another W, which is proved and which sets have room for",
    "bands.losses": "other losses, which are proved and under which W holds as well",
    "estimate": "another estimate, whose error keeps its bound and for which W holds as well",
    "lateness.lag": "other lags of the wheels, for which W holds as well",
    "lateness.delay": "other delays, for which W holds as well",
    "lateness.nominal": "another lag or delay to count on, for which W holds as well",
    "lateness.lever": "another lever of kicks, with which W holds as well",
    "lateness.noise": "other noise of the pose, which that of the committed pose holds as well",
    "lateness.wheels": "other ranges of commands, which are proved and for which W holds as well",
    "lateness.speeds": "other ranges of commands, which are proved and for which W holds as well",
    "learning": "other changes of slips or speeds, from which as much is proved to be learnt",
    "bands.cells": "cells cut otherwise, each of which is proved",
    "sets.rows": "another set that is invariant as well",
    "sets.offsets": "another set that is invariant as well",
    "sets.extents": "other multipliers that prove as much",
    "inclusions": "the same inclusions in another order",
    "inclusions.multipliers": "other multipliers that prove as much",
    "cost": "another cost that decreases as well, or no decrease is promised",
    "plans": "no plans are promised, but what the law alone does",
    "plans.tolerance": "another tolerance that rows have room for",
    "plans.sequence": "another order of windows that follow each other",
    "plans.windows": "other rows that plans keep as well",
    "plans.terminal": "other terminal rows, whose multipliers prove as much",
    "plans.ends": "other multipliers that prove as much",
}
"""What a changed certificate may be that is accepted, by what was changed; all else is refused."""
PROOFS = (
    "bands.cells",
    "sets.extents",
    "inclusions",
    "inclusions.multipliers",
    "plans.ends",
    "name",
)
"""Parts that promise nothing, so that a certificate that is accepted promises what it did."""


def mutate(certificate, source):
    """Return a certificate with one change, and where it is."""
    mutant = copy.deepcopy(certificate)
    path = []
    place = mutant
    while True:
        keys = list(place) if isinstance(place, dict) else range(len(place))
        # What holds much is changed more often than what is one number.
        weights = [1 + 2 * isinstance(place[key], dict | list) for key in keys]
        (key,) = source.choices(keys, weights)
        path.append(key)
        entry = place[key]
        # Now and then a whole part is changed, mostly a number at the end of the way.
        if not isinstance(entry, dict | list) or not entry or source.random() < 0.07:
            break
        place = entry
    _change(place, key, source)
    return mutant, name_part(path)


def name_part(path) -> str:
    """Return what a path leads to, without the numbers and names on the way."""
    head = str(path[0])
    if head in ("bands", "inclusions", "sets") and len(path) > 2:
        return f"{head}.{path[2]}"
    return f"{head}.{path[1]}" if head in ("plans", "lateness") and len(path) > 1 else head


def _change(place, key, source):
    entry = place[key]
    if isinstance(entry, str) and entry and not _is_number(entry) and set(entry) <= TREE:
        place[key] = _change_tree(entry, source)
    elif _is_number(entry):
        place[key] = _change_number(Fraction(entry), source)
    elif isinstance(entry, list) and len(entry) > 1 and source.random() < 0.5:
        other = source.randrange(len(entry) - 1)
        entry[other], entry[other + 1] = entry[other + 1], entry[other]
    else:
        del place[key]


TREE = set("abcdefghijklmnop-.")


def _is_number(entry) -> bool:
    try:
        return isinstance(entry, str) and Fraction(entry) is not None
    except ValueError:
        return False


def _change_number(number: Fraction, source):
    changes = (
        lambda: str(number * (1 + NUDGE)),
        lambda: str(number * (1 - NUDGE)),
        lambda: str(number * Fraction(11, 10)),
        lambda: str(number * Fraction(9, 10)),
        lambda: str(-number),
        lambda: str(number + source.choice((-1, 1)) * NUDGE),
        lambda: "0",
        lambda: float(number),
        lambda: None,
    )
    return source.choice(changes)()


def _change_tree(tree: str, source) -> str:
    place = source.randrange(len(tree))
    other = source.choice(sorted(TREE))
    changes = (
        tree[:place] + tree[place + 1 :],
        tree[:place] + other + tree[place + 1 :],
        tree[:place] + other + tree[place:],
        tree[:place],
    )
    return source.choice(changes)


def change(certificate, *path, by):
    """Return a certificate whose number at a path is another one."""
    changed = copy.deepcopy(certificate)
    place = changed
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = str(by(Fraction(place[path[-1]])))
    return changed


def is_accepted(certificate, folder, capsys) -> bool:
    """Return whether the checker accepts a certificate; it says so in its last line, and with its
    exit code."""
    path = folder / FILE
    path.write_text(json.dumps(certificate))
    code = load_checker(PROGRAMS[0]).main(str(path))
    said = capsys.readouterr().out
    last = said.splitlines()[-1]
    assert code in (0, 1) and last.startswith("CHECKED" if code == 0 else "REFUSED"), said
    return code == 0


def survey_mutants(written, seeds, folder, capsys) -> dict[str, str]:
    """Return of changed certificates what was accepted, by the reason why that is harmless; each
    holds in floats."""
    accepted = {}
    program = load_checker(PROGRAMS[0])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(program, "prove", remember(program.prove))
        for seed in seeds:
            mutant, part = mutate(written, random.Random(seed))
            if mutant == written or not is_accepted(mutant, folder, capsys):
                continue
            assert part in HARMLESS, (seed, part)
            assert part in PROOFS or holds_in_floats(mutant), (seed, part)
            accepted[part] = HARMLESS[part]
    return accepted


def remember(prove):
    """Return the same proof of a motion, which is not gone through again where it has passed."""

    @cache
    def prove_once(output, sign, level, tree, cell, robot, piece):
        prove(output, sign, level, tree, cell, robot, piece)

    def prove_frozen(output, sign, level, tree, cell, robot, piece):
        prove_once(output, sign, level, tree, tuple(cell), tuple(robot), tuple(piece))

    return prove_frozen
