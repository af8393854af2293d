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
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from jaxtube.exporting.constants import DOUBLE, SINGLE, WIDER, Constants, gather_constants
from jaxtube.synthesis.certificate.exact import recheck
from jaxtube.synthesis.condense import tube_bounds
from jaxtube.synthesis.design import finish
from jaxtube.synthesis.parts import Condensed, Design
from jaxtube.synthesis.prediction import UNREACHED
from jaxtube.synthesis.tightening import EmptySetError, find_back_off

SPARE = 1.25
"""Times what the rows of floats miss that constraints are first drawn in by."""
ATTEMPTS = 4
"""Designs that are drawn in for floats before it is given up."""
KINDS = ("errors", "inputs", "terminal")

Exact = np.ndarray
"""Fractions, as an array of objects."""

NOTHING = Fraction(0)
UNBOUNDED = Fraction(10) ** 9
"""What rows miss that are bounded in the design or in the constants alone."""
SAME_NUMBERS = "other numbers"
"""The name of the margin of all numbers that are no rows: 0, or minus infinity."""
PROVED_ROWS = ("rows", "row_errors", "lower", "upper")
"""The constants that rows are made of, which may differ by what is proved; no others may."""

as_fractions = np.vectorize(Fraction, otypes=[object])


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
    missed = _Comparison(design, gather_constants(design, SINGLE)).find_missed()
    once = SPARE * float(max(missed["errors"], missed["inputs"]))
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
    """Return the design with constraints backed off by so much in every stage, certified anew."""
    bounds = tube_bounds(design.problem, design.tightening, design.terminal, once)
    condensed = Condensed(design.problem, design.windows, design.terminal, design.cost.cost, bounds)
    return finish(replace(design, bounds=bounds, condensed=condensed))


def prove(design: Design, constants: Constants, once: float) -> Proof:
    """Compare constants with a design whose constraints are backed off by so much more in every
    stage than in the one before."""
    comparison = _Comparison(design, constants)
    missed = comparison.find_missed()
    rooms = _find_rooms(design)
    is_exact = bool(rooms)
    margins = {SAME_NUMBERS: 0.0 if _are_others_the_same(design, constants) else -np.inf}
    if not is_exact:
        margins |= {f"{kind} backed off": float(Fraction(once) - missed[kind]) for kind in KINDS}
    enlarged = comparison.enlarge_terminal(missed["terminal"])
    for name, room in rooms.items():
        kind, condition = name.split(" ")
        needed = missed[kind]
        if condition == "returns" or name == "terminal reach":
            needed += enlarged * comparison.find_largest_bound(kind)
        margins[name] = float(room - needed)
    as_floats = {kind: float(value) for kind, value in missed.items()}
    return Proof(constants, design, as_floats, margins, is_exact)


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


class _Comparison:
    """Rows of the design, exact, beside those of the constants, in the order of the constants."""

    def __init__(self, design: Design, constants: Constants):
        self._design = design
        self._constants = constants
        reached = np.abs(_predict_rows_as_floats(design)[:, :, 3:]).max(axis=(0, 2)) > UNREACHED
        self._order = np.concatenate([np.flatnonzero(reached), np.flatnonzero(~reached)])
        self._norms = self._find_norms(int(reached.sum()))

    def _find_norms(self, reached: int) -> Float[np.ndarray, "windows m"]:
        """Return by what the rows of the design were divided."""
        norms = np.ones((len(self._constants.rows), len(self._order)))
        norms[:, :reached] = self._design.tube_qps.factors.row_norms
        return norms

    @cached_property
    def _kinds(self) -> Bool[np.ndarray, "3 m"]:
        """Which rows are of which kind."""
        design = self._design
        N = design.problem.horizon
        half = len(design.problem.input_rows.offsets) // 2
        counts = (3 * (N - 1), half * N, len(design.bounds.terminal_normals))
        kinds = np.repeat(np.arange(3), counts)[self._order]
        return kinds == np.arange(3)[:, None]

    @cached_property
    def _box(self) -> Exact:
        """Magnitudes of errors and inputs."""
        problem = self._design.problem
        errors = problem.operating_set.support(np.eye(3))
        inputs = problem.input_set.support(np.concatenate([np.eye(2), -np.eye(2)]))
        largest = np.maximum(inputs[:2], inputs[2:])
        box = np.concatenate([errors, np.tile(largest, problem.horizon)])
        return WIDER * as_fractions(box)

    def find_missed(self) -> dict[str, Fraction]:
        """Return the largest over and the largest under together, by kind of row; infinite where a
        row is bounded in one of both alone."""
        misses = [self._miss_rows(window) for window in range(len(self._constants.rows))]
        over = np.max([over for over, _ in misses], axis=0)
        under = np.max([under for _, under in misses], axis=0)
        return {
            kind: max(over[of_kind], default=NOTHING) + max(under[of_kind], default=NOTHING)
            for kind, of_kind in zip(KINDS, self._kinds, strict=True)
        }

    def _miss_rows(self, window: int) -> tuple[Exact, Exact]:
        """Return over and under of every row of a window."""
        constants = self._constants
        norms = as_fractions(self._norms[window])
        exact = _predict_rows(self._design, window)[self._order]
        written = np.hstack([constants.row_errors[window], constants.rows[window]])
        scaled = as_fractions(written.astype(float))
        differs = np.abs(norms[:, None] * scaled - exact) @ self._box
        size = np.abs(scaled) @ self._box
        tolerance = Fraction(constants.precision.tolerance)
        lower, upper = _bound_rows(self._design, window)
        over = np.full(len(norms), NOTHING, object)
        under = np.full(len(norms), NOTHING, object)
        sides = ((-lower, -constants.lower[window]), (upper, constants.upper[window]))
        for ours, theirs in sides:
            designed = ours[self._order]
            finite = np.isfinite(designed)
            if not np.array_equal(finite, np.isfinite(theirs)):
                return over + UNBOUNDED, under
            given = as_fractions(np.where(finite, theirs, 0.0).astype(float))
            wider = norms * given - as_fractions(np.where(finite, designed, 0.0))
            rounding = norms * self._bound_rounding(size + np.abs(given))
            by_tolerance = differs + rounding + norms * tolerance
            over = np.where(finite, np.maximum(over, wider + by_tolerance), over)
            under = np.where(finite, np.maximum(under, differs + rounding - wider), under)
        return over, under

    def _bound_rounding(self, size: Exact) -> Exact:
        """Return what the arithmetic of a row may be off by, its terms being of this size."""
        unit = Fraction(self._constants.precision.epsilon) / 2
        terms = len(self._box) + 6
        return size * (terms * unit / (1 - terms * unit))

    def enlarge_terminal(self, missed: Fraction) -> Fraction:
        """Return by which share rows missed by so much enlarge the terminal set."""
        offsets = self._design.bounds.terminal
        return (
            missed / Fraction(float(offsets.min())) if np.isfinite(offsets).all() else Fraction(0)
        )

    def find_largest_bound(self, kind: str) -> Fraction:
        """Return the largest bound of the rows of a kind."""
        return Fraction(float(np.max(getattr(self._design.bounds, kind))))


def _predict_rows(design: Design, window: int) -> Exact:
    """Return the exact rows on the first error and the inputs of a plan, those on E_1 .. E_{N-1},
    on U_0 .. U_{N-1} and on e_N, by the model's matrices; of opposite rows the first stands for
    both."""
    problem = design.problem
    N = problem.horizon
    half = len(problem.input_rows.offsets) // 2
    transitions, matrices = problem.model.matrices(design.windows.schedules[window][None])
    error_rows = as_fractions(problem.operating_set.normals[:3])
    on_inputs = as_fractions(problem.input_rows.inputs[:half])
    on_errors = as_fractions(problem.input_rows.errors[:half])
    probes = as_fractions(np.eye(3 + 2 * N))
    errors = probes[:3]
    of_errors = []
    of_inputs = []
    for stage in range(N):
        inputs = probes[3 + 2 * stage : 5 + 2 * stage]
        if stage > 0:
            of_errors.append(error_rows @ errors)
        of_inputs.append(on_inputs @ inputs + on_errors @ errors)
        transition = as_fractions(transitions[0, stage])
        errors = transition @ errors + as_fractions(matrices[0, stage]) @ inputs
    of_terminal = as_fractions(design.bounds.terminal_normals) @ errors
    return np.concatenate([*of_errors, *of_inputs, of_terminal])


def _predict_rows_as_floats(design: Design) -> Float[np.ndarray, "windows m 3+n"]:
    return np.array([_predict_rows(design, w) for w in range(len(design.windows.schedules))], float)


def _bound_rows(
    design: Design, window: int
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """Return the lower and upper bounds of these rows."""
    bounds = design.bounds
    half = bounds.inputs.shape[2] // 2
    upper = [
        bounds.errors[window, 1:, :3],
        bounds.inputs[window, :, :half],
        bounds.terminal[window],
    ]
    lower = [-bounds.errors[window, 1:, 3:], -bounds.inputs[window, :, half:]]
    unbounded = np.full(bounds.terminal[window].shape, -np.inf)
    return (
        np.concatenate([*map(np.ravel, lower), unbounded]),
        np.concatenate([*map(np.ravel, upper)]),
    )


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
