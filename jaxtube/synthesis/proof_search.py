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
PROGRAMS = (
    "check_certificate.py",
    "check_intervals.py",
    "check_motion.py",
    "check_estimate.py",
    "check_sets.py",
    "check_plans.py",
    "check_learning.py",
    "check_model.py",
    "check_travel.py",
    "check_losses.py",
    "check_lag.py",
    "check_pose.py",
    "check_words.py",
)
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
    rows: Float[np.ndarray, "k 3"], offsets: Float[np.ndarray, " k"], row: Sequence[float]
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
    program = load_checker("check_sets.py")
    for shape in certificate["sets"].values():
        prove_extents(shape, shape["offsets"])
    certificate["inclusions"] = []
    for band in certificate["bands"]:
        if not program.is_lasting(certificate, band):
            continue
        shape = certificate["sets"][band["set"]]
        for into, wanted in program.list_targets(certificate, band).items():
            inclusion = {"set": band["set"], "loop": band["name"], "into": into}
            proofs = [_find_multipliers_in(shape, row, shape["offsets"]) for row, _ in wanted]
            certificate["inclusions"].append({**inclusion, "multipliers": proofs})


def prove_extents(shape: dict[str, Any], offsets: Sequence[Fraction]) -> None:
    """Add to a set the multipliers that bound its coordinates."""
    axes = load_checker("check_sets.py").AXES
    shape["extents"] = [_find_multipliers_in(shape, axis, offsets) for axis in axes]


def _find_multipliers_in(
    shape: Mapping[str, Any], row: Sequence[tuple[int, int]], offsets: Sequence[float | Fraction]
) -> dict[str, Fraction]:
    middle = [_find_middle(entry) for entry in row]
    return find_multipliers(np.array(shape["rows"], float), np.array(offsets, float), middle)


def _find_middle(ends: tuple[int, int]) -> float:
    """Return a float near an interval of the checker."""
    return float(Fraction(sum(ends), 2 * load_checker("check_intervals.py").ONE))


def prove_plans(certificate: dict[str, Any]) -> None:
    """Add to a certificate the multipliers at the ends of its plans."""
    plans = certificate["plans"]
    shape = plans["terminal"]
    prove_extents(shape, [Fraction(1)] * len(shape["rows"]))
    plans["ends"] = {}
    successions = load_checker("check_plans.py").list_successions(certificate)
    for pair, key, row, _, reached, end_set in successions:
        if reached is None:
            of_pair = plans["ends"].setdefault(pair, {})
            offsets = [_find_middle(ends) for ends in end_set.offsets]
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
    program = load_checker("check_motion.py")
    formula = program.note_motion(output, cell, robot, piece)
    letters = []
    cells = [cell]
    while cells:
        cell = cells.pop()
        slopes = formula.find_slopes(cell, sign)
        shrunk = program.shrink(cell, slopes)
        if program.bound(formula, sign, shrunk, slopes) <= level:
            letters.append(".")
            continue
        if shrunk != list(cell):
            # What is left of the cell has narrower slopes.
            letters.append("-")
            cells.append(shrunk)
            continue
        index = _find_widest(cell, slopes)
        low, high = cell[index]
        if low == high or len(letters) > MOST_LETTERS:
            raise ValueError(f"motions: {output} is not proved to keep its bound; widen W")
        letters.append(program.VARIABLES[index])
        middle = (low + high) // 2
        halves = ((middle, high), (low, middle))
        cells += [[*cell[:index], half, *cell[index + 1 :]] for half in halves]
    return "".join(letters)


def _find_widest(cell: list, slopes: list) -> int:
    """Return the variable whose unknown slope contributes most to the bound of a cell."""
    widths = [
        (most - least) * (high - low)
        for (low, high), (least, most) in zip(cell, slopes, strict=True)
    ]
    return max(range(len(widths)), key=widths.__getitem__)
