"""The numbers of an exported controller certified again, in exact rational arithmetic, as they were
written: rounded to float64 or float32.

The certificate of a design is about plans that keep the sets of its `bounds` under the predictions
of its model. An exported controller takes a plan x from errors e as soon as its rounded rows are
met, to a tolerance, in arithmetic that rounds. With every float the binary rational it is, and
errors and inputs within twice their caps, this module bounds for each row

    over     by how much a plan that the controller accepts may miss the row of the design
    under    by how much a plan that meets the row of the design may miss that of the controller

A plan that was accepted, shifted by one period, is admissible again with some room, which the exact
re-check of the design proves (`synthesis.certificate.exact`); where the room of every kind of row
is at least its largest over and its largest under together, the shifted plan is accepted again, and
the guarantee of the design is that of the controller. A terminal row that is missed by a share of
its bound enlarges the terminal set by that share, and so all that is asked of it. All other numbers
of the controller have to be those of the design to the bit.

A design without an exact re-check is not certified again: the back-off of its constraints is then
compared with over and under, which says how exact the rows are, and no more.

Not proved here: that a plan is found where there is one (where none is found, the controller says
so); what the matrices of the model, which are floats, differ by from those of the exact re-check
(at most `sets.certificate.ROUNDING` an entry, some 1e-11 in a row); and the compiled code.

Source: Higham 2002, Accuracy and Stability of Numerical Algorithms, lemma 3.1, for the rounding of
inner products; the rest is new.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from fractions import Fraction

import numpy as np

from jaxtube.exporting.constants import DOUBLE, SINGLE, Constants, gather_constants
from jaxtube.exporting.rows import KINDS, RowComparison
from jaxtube.synthesis.certificate.exact import recheck
from jaxtube.synthesis.condense import tube_bounds
from jaxtube.synthesis.design import finish
from jaxtube.synthesis.parts import Condensed, Design
from jaxtube.synthesis.problem import Problem
from jaxtube.synthesis.tightening import EmptySetError, find_back_off, reach_of_limits

SPARE = 1.25
"""Times what the rows of floats miss that constraints are first drawn in by."""
ATTEMPTS = 4
"""Designs that are drawn in for floats before it is given up."""
SAME_NUMBERS = "other numbers"
"""The name of the margin of all numbers that are no rows: 0, or minus infinity."""
PROVED_ROWS = ("rows", "row_errors", "lower", "upper")
"""The constants that rows are made of, which may differ by what is proved; no others may."""


@dataclass(frozen=True)
class Proof:
    """What was proved of constants.

    Attributes:
        constants: as they are exported.
        design: whose sets they keep.
        missed: over + under by kind of row, in the units of the rows of the design.
        margins: what is left of each room; all at least 0 where it is proved.
        is_exact: whether the rooms are those of an exact re-check, not the back-off alone.
    """

    constants: Constants
    design: Design
    missed: dict[str, float]
    margins: dict[str, float]
    is_exact: bool

    @property
    def holds(self) -> bool:
        """Whether the rows are exact enough, and all other numbers those of the design."""
        return min(self.margins.values()) >= 0

    @property
    def certifies(self) -> bool:
        """Whether the controller has the guarantee of the design for the robot."""
        return self.holds and self.is_exact and self.design.certificate.holds_for_robot

    def describe(self) -> dict[str, object]:
        """Return all of it as plain numbers and names."""
        return {
            "precision": self.constants.precision.name,
            "certified": self.certifies,
            "verdict_of_sets": self.design.certificate.verdict,
            "rooms": "of the exact re-check" if self.is_exact else "the back-off of constraints",
            "missed": self.missed,
            "margins": self.margins,
        }


def prove_doubles(design: Design) -> Proof:
    """Prove what float64 constants of a design keep."""
    return prove(design, gather_constants(design, DOUBLE), find_back_off(design.problem))


def prove_floats(design: Design) -> Proof | None:
    """Draw the constraints of a design in until float32 constants keep its guarantee; return the
    proof, or None where no such design was found, or the verdict would be another."""
    missed = RowComparison(design, gather_constants(design, SINGLE)).find_missed()
    limits = _find_least_limits(design.problem)
    once = SPARE * max(float(missed[kind]) / limits[kind] for kind in limits)
    for _ in range(ATTEMPTS):
        try:
            drawn_in = _draw_in(design, once)
        except EmptySetError:
            return None
        if drawn_in.certificate.verdict != design.certificate.verdict:
            return None
        proof = prove(drawn_in, gather_constants(drawn_in, SINGLE), once)
        if proof.holds:
            return proof
        once = 2 * once
    return None


def _draw_in(design: Design, once: float) -> Design:
    """Return the design with constraints backed off by such a share of each in every stage,
    certified anew."""
    bounds = tube_bounds(design.problem, design.windows, design.tightening, design.terminal, once)
    condensed = Condensed(design.problem, design.windows, design.terminal, design.cost.cost, bounds)
    return finish(replace(design, bounds=bounds, condensed=condensed))


def prove(design: Design, constants: Constants, once: float) -> Proof:
    """Compare constants with a design whose constraints are backed off by such a share of each more
    in every stage than in the one before."""
    comparison = RowComparison(design, constants)
    missed = comparison.find_missed()
    rooms = _find_rooms(design)
    is_exact = bool(rooms)
    margins = {SAME_NUMBERS: 0.0 if _are_others_the_same(design, constants) else -np.inf}
    if not is_exact:
        limits = _find_least_limits(design.problem) | _find_least_terminal(design)
        margins |= {
            f"{kind} backed off": float(Fraction(once * limits[kind]) - missed[kind])
            for kind in KINDS
        }
    enlarged = comparison.enlarge_terminal(missed["terminal"])
    for name, room in rooms.items():
        kind, condition = name.split(" ")
        needed = missed[kind]
        if condition == "returns" or name == "terminal reach":
            needed += enlarged * comparison.find_largest_bound(kind)
        margins[name] = float(room - needed)
    as_floats = {kind: float(value) for kind, value in missed.items()}
    return Proof(constants, design, as_floats, margins, is_exact)


def _find_least_limits(problem: Problem) -> dict[str, float]:
    """Return the narrowest limits of errors and of inputs, of which constraints are backed off by a
    share."""
    return {
        "errors": float(problem.operating_set.offsets.min()),
        "inputs": float(problem.input_rows.offsets.min()),
    }


def _find_least_terminal(design: Design) -> dict[str, float]:
    """Return the same of the rows on the last error."""
    reach = reach_of_limits(design.problem, design.bounds.terminal_normals)
    return {"terminal": float(reach.min())}


def _are_others_the_same(design: Design, constants: Constants) -> bool:
    """Return whether all numbers that are no rows are those of the design, to the bit."""
    expected = gather_constants(design, constants.precision)
    names = [field.name for field in fields(Constants) if field.name not in PROVED_ROWS]
    return all(
        np.array_equal(getattr(constants, name), getattr(expected, name))
        for name in names
        if name != "precision"
    )


def _find_rooms(design: Design) -> dict[str, Fraction]:
    """Return the proved room of every condition under which shifted plans are admissible; none
    where the design has no exact re-check, or it fails."""
    try:
        report = recheck(design)
    except ValueError:
        return {}
    if not report.holds:
        return {}
    margins = report.margins
    return {name: margin for name, margin in margins.items() if _is_of_rows(name)}


def _is_of_rows(name: str) -> bool:
    """Tell whether a condition of the exact re-check is about the rows that a plan keeps."""
    kind, _, condition = name.partition(" ")
    return kind in KINDS and condition in ("reach", "shifted", "returns")


def list_margins(proofs: Mapping[str, Proof | None]) -> list[str]:
    """Return a line for each precision: what is proved of it, with the least margin."""
    return [f"{name}: {_say_what_holds(proof)}" for name, proof in proofs.items()]


def _say_what_holds(proof: Proof | None) -> str:
    if proof is None:
        return "not offered; constraints cannot be drawn in as far as it needs"
    least = min(margin for name, margin in proof.margins.items() if name != SAME_NUMBERS)
    if proof.certifies:
        return f"certified again, least margin {least:.3g}"
    missed = max(proof.missed.values())
    return f"not certified; its rows are those of the design to {missed:.2g}"
