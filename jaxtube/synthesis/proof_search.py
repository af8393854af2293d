"""Proofs for `certificate.json`, as its checker reads them: multipliers, and how cells are cut.

Floats and linear programs propose; whether something is proved is asked of the checker's own
functions, which share no code with this project.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Mapping, Sequence
from fractions import Fraction
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.optimize import linprog

import sets

CHECKER = Path(sets.__file__).parent / "checker"
"""Folder of the checker: programs of the standard library alone."""
PROGRAMS = ("check_certificate.py", "check_motion.py", "check_plans.py")
"""The checker's files; the first one is the program."""
USED = 1e-9
"""Share of the largest multiplier up to which one is the rounding of zero."""
MOST_LETTERS = 200_000
"""Cells after which a search gives up."""


@cache
def load_checker(program: str) -> ModuleType:
    """Return a program of the checker, which finds the others beside itself."""
    sys.path.insert(0, str(CHECKER))
    try:
        return importlib.import_module(program.removesuffix(".py"))
    finally:
        sys.path.remove(str(CHECKER))


def find_multipliers(
    rows: Float[np.ndarray, "k 3"], offsets: Float[np.ndarray, " k"], row: Float[np.ndarray, "3"]
) -> dict[str, Fraction]:
    """Return multipliers l >= 0 by the index of their row, l rows = row up to rounding, of the
    least l offsets; none where no multiple of the rows reaches the row."""
    answer = linprog(offsets, A_eq=rows.T, b_eq=row, bounds=(0, None), method="highs")
    if answer.x is None:
        return {}
    used = np.flatnonzero(answer.x > USED * answer.x.max(initial=0.0))
    weights = np.linalg.lstsq(rows[used].T, row, rcond=None)[0]
    return {str(i): Fraction(float(w)) for i, w in zip(used, weights, strict=True) if w > 0}


def prove_sets(certificate: dict[str, Any]) -> None:
    """Add to a certificate the multipliers of the extents and inclusions of its sets."""
    program = load_checker(PROGRAMS[0])
    for shape in certificate["sets"].values():
        shape["extents"] = [
            _find_multipliers_in(shape, axis) for axis in load_checker(PROGRAMS[2]).AXES
        ]
    certificate["inclusions"] = []
    for band in certificate["bands"]:
        shape = certificate["sets"][band["set"]]
        for into, wanted in program.list_targets(certificate, band).items():
            inclusion = {"set": band["set"], "loop": band["name"], "into": into}
            proofs = [_find_multipliers_in(shape, row) for row, _ in wanted]
            certificate["inclusions"].append({**inclusion, "multipliers": proofs})


def _find_multipliers_in(
    shape: Mapping[str, Any], row: Sequence[Any], offsets: Sequence[Fraction] | None = None
) -> dict[str, Fraction]:
    bounds = shape["offsets"] if offsets is None else offsets
    middle = [_find_middle(entry) for entry in row]
    return find_multipliers(
        np.array(shape["rows"], float), np.array(bounds, float), np.array(middle, float)
    )


def _find_middle(entry: Any) -> float:
    """Return a float near a fraction or a number of the checker."""
    if not hasattr(entry, "low"):
        return float(entry)
    return float(Fraction(entry.low + entry.high, 2 * load_checker(PROGRAMS[1]).ONE))


def prove_plans(certificate: dict[str, Any]) -> None:
    """Add to a certificate the multipliers at the ends of its plans."""
    plans = certificate["plans"]
    shape = plans["terminal"]
    axes = load_checker(PROGRAMS[2]).AXES
    first = [Fraction(1)] * len(shape["rows"])
    shape["extents"] = [_find_multipliers_in(shape, axis, first) for axis in axes]
    plans["ends"] = {}
    successions = load_checker(PROGRAMS[2]).list_successions(certificate)
    for pair, key, row, _, reached, offsets in successions:
        if reached is None:
            of_pair = plans["ends"].setdefault(pair, {})
            of_pair[key] = _find_multipliers_in(shape, row, offsets)


def prove_motions(certificate: Mapping[str, Any], band: dict[str, Any]) -> None:
    """Add to a band how cells are cut so that each proves its bound.

    Raises:
        ValueError: where a bound is not proved.
    """
    band["cells"] = {}
    motions = load_checker(PROGRAMS[0]).list_motions(certificate, band)
    for output, sign, level, cells in motions:
        trees = [_grow_tree(output, sign, level, *cell) for cell in cells]
        band["cells"][output + ("+" if sign > 0 else "-")] = trees


def _grow_tree(output: str, sign: int, level: int, cell: list, robot: list, piece: tuple) -> str:
    """Return how a cell is cut, as the checker's `prove` reads it."""
    program = load_checker(PROGRAMS[1])
    constants = program.find_constants(robot, piece)
    letters = []
    cells = [cell]
    while cells:
        cell = cells.pop()
        slopes = program.find_slopes(output, sign, cell, constants)
        shrunk = program.shrink(cell, slopes)
        index = _find_widest(shrunk, slopes)
        if program.bound(output, sign, shrunk, slopes, constants) <= level:
            letters.append(".")
            continue
        low, high = shrunk[index]
        if low == high or len(letters) > MOST_LETTERS:
            raise ValueError(f"motions: {output} is not proved to keep its bound; widen W")
        letter = program.VARIABLES[index]
        letters.append(letter.upper() if shrunk == list(cell) else letter)
        middle = (low + high) // 2
        halves = ((middle, high), (low, middle))
        cells += [[*shrunk[:index], half, *shrunk[index + 1 :]] for half in halves]
    return "".join(letters)


def _find_widest(cell: list, slopes: list) -> int:
    """Return the variable whose unknown slope contributes most to the bound of a cell."""
    widths = [
        (most - least) * (high - low)
        for (low, high), (least, most) in zip(cell, slopes, strict=True)
    ]
    return max(range(len(widths)), key=widths.__getitem__)
