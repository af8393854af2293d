"""The bounds that a certificate rests on, W, S and the ground speeds, proved a second time on
integers.

The certificate proves them by interval arithmetic on floats. Here they are taken as they are, and
the motions of the robot are bounded once more by `sets.robot.exact_disturbance`. That takes
seconds, some twenty for the widest sets, so it is done where a certificate is what was asked for.

Source: new.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from jaxtube.synthesis.disturbance import kinematics, operation, prove_bound
from jaxtube.synthesis.parts import Design
from jaxtube.synthesis.problem import Problem
from sets.certificate import Certificate, Condition
from sets.exact_supremum import Room
from sets.robot.exact_committed import find_lateness_rooms
from sets.robot.exact_disturbance import find_disturbance_rooms, find_estimate_rooms

NAME = "motions_checked_in_rationals"


def confirm_motions(design: Design) -> Design:
    """Return a design, if it is certified, with the second proof as one more condition."""
    if not design.certificate.holds_for_robot:
        return design
    started = time.perf_counter()
    conditions = (*design.certificate.checked, check_motions(design.problem))
    seconds = {**design.seconds, "motions": time.perf_counter() - started}
    certificate = Certificate(conditions, design.certificate.assumptions)
    return replace(design, certificate=certificate, seconds=seconds)


def check_motions(problem: Problem) -> Condition:
    """Prove once more, on integers, that motions stay within W and its ground speeds, and the error
    of an estimate within S.

    A motion that leaves them refutes the certificate, and so does a bound of lag and delay below
    the one derived anew; a search that gives up is told, no more.
    """
    try:
        rooms = _find_rooms(problem)
    except ValueError as error:
        sentence = f"Not proved a second time: {error}."
        return Condition(NAME, -np.inf, sentence, "information")
    tightest = min(rooms, key=lambda name: rooms[name].proved)
    proved = float(rooms[tightest].proved)
    refuted = [name for name, room in rooms.items() if room.met < 0]
    if refuted:
        met = min(float(rooms[name].met) for name in refuted)
        sentence = f"Exact integer arithmetic does not confirm: {', '.join(refuted)}."
        return Condition(NAME, met, sentence, "robot")
    if proved < 0:
        sentence = (
            f"Not proved a second time: the search gave up {-proved:.3g} short of {tightest}, "
            "beyond which nothing was found."
        )
        return Condition(NAME, proved, sentence, "information")
    sentence = (
        f"Exact integer arithmetic proves the {len(rooms)} bounds that W, S and the ground speeds "
        "are made of once more, from the same split of a motion into its parts, for the caps and "
        "the ranges of slip, noise and steps of commands as they are."
    )
    return Condition(NAME, proved, sentence, "robot")


def _find_rooms(problem: Problem) -> dict[str, Room]:
    """Return the rooms within W, S and the ground speeds by name, of several regimes the
    least."""
    least: dict[str, Room] = {}
    for regime in problem.every_regime:
        for name, room in _find_regime_rooms(regime).items():
            before = least.get(name, room)
            least[name] = Room(min(before.proved, room.proved), min(before.met, room.met))
    return least


def _find_regime_rooms(problem: Problem) -> dict[str, Room]:
    """Return the rooms of one regime."""
    where = operation(problem)
    how = kinematics(problem)
    rooms = find_disturbance_rooms(where, how, prove_bound(problem))
    rooms |= find_lateness_rooms(where, how)
    if not problem.scenario.controller.has_observer:
        return rooms
    of_estimate = find_estimate_rooms(where, how)
    return rooms | {f"S in {name}": room for name, room in of_estimate.items()}
