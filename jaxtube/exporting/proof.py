"""The constants of an exported controller certified again, in exact rational arithmetic, as they
were written: rounded to float64 or float32.

The certificate of a design is about plans that keep the sets of its `bounds` under exact
predictions. An exported controller takes a plan x from errors e as soon as its rounded rows are
met, to a tolerance, in arithmetic that rounds. With every float the binary rational it is, and
errors and inputs within twice their caps, this module bounds for each row

    over     by how much a plan that the controller accepts may miss the row of the design
    under    by how much a plan that meets the row of the design may miss that of the controller

Plans shifted by one period are admissible again with some room, which the exact re-check of the
design measures (`synthesis.certificate.exact`; elsewhere it is what constraints are backed off by
in every stage). Where that room is at least over + under, in every kind of row, the guarantee of
the design is that of the controller. A terminal row that is missed by a share of its bound enlarges
the terminal set by that share, and so all that is asked of it.

Not proved here: that a plan is found (where none is, the controller says so), and the compiled
code.

Source: Higham 2002, Accuracy and Stability of Numerical Algorithms, lemma 3.1, for the rounding of
inner products; the rest is new.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from jaxtube.exporting.constants import DOUBLE, SINGLE, Constants, gather_constants
from jaxtube.synthesis.certificate.exact import recheck
from jaxtube.synthesis.condense import tube_bounds
from jaxtube.synthesis.design import finish
from jaxtube.synthesis.parts import Condensed, Design
from jaxtube.synthesis.prediction import UNREACHED
from jaxtube.synthesis.tightening import EmptySetError, find_back_off

WIDER = 2
"""Times their caps that errors and inputs are taken to be."""
SPARE = 1.25
"""Times what the rows of floats miss that constraints are first drawn in by."""
ATTEMPTS = 4
"""Designs that are drawn in for floats before it is given up."""
KINDS = ("errors", "inputs", "terminal")

Exact = np.ndarray
"""Fractions, as an array of objects."""

as_fractions = np.vectorize(Fraction, otypes=[object])


@dataclass(frozen=True)
class Proof:
    """What was proved of constants.

    Attributes:
        constants: as they are exported.
        design: whose sets they keep.
        missed: over + under by kind of row, in the units of the rows of the design.
        margins: what is left of the room of each condition; all at least 0 where it is proved.
        is_exact: whether the rooms are proved in rationals too, not the back-off of the design.
    """

    constants: Constants
    design: Design
    missed: dict[str, float]
    margins: dict[str, float]
    is_exact: bool

    @property
    def holds(self) -> bool:
        """Whether the constants keep the guarantee of the design."""
        return min(self.margins.values()) >= 0

    def describe(self) -> dict[str, object]:
        """Return all of it as plain numbers and names."""
        return {
            "precision": self.constants.precision.name,
            "holds": self.holds,
            "verdict_of_sets": self.design.certificate.verdict,
            "rooms": "proved in rationals" if self.is_exact else "the back-off of the design",
            "missed": self.missed,
            "margins": self.margins,
        }


def prove_doubles(design: Design) -> Proof:
    """Prove what float64 constants of a design keep."""
    return prove(design, gather_constants(design, DOUBLE), find_back_off(design.problem))


def prove_floats(design: Design) -> Proof | None:
    """Draw the constraints of a design in until float32 constants keep its guarantee; return the
    proof, or None where no such design was found."""
    missed = _Comparison(design, gather_constants(design, SINGLE)).find_missed()
    once = SPARE * float(max(missed["errors"], missed["inputs"]))
    for _ in range(ATTEMPTS):
        try:
            drawn_in = _draw_in(design, once)
        except EmptySetError:
            return None
        if drawn_in.certificate.holds_for_robot < design.certificate.holds_for_robot:
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
    rooms, is_exact = _find_rooms(design, once)
    enlarged = comparison.enlarge_terminal(missed["terminal"])
    margins = {}
    for name, room in rooms.items():
        kind, condition = name.split(" ")
        needed = missed[kind]
        if condition == "returns" or name == "terminal reach":
            needed += enlarged * comparison.find_largest_bound(kind)
        margins[name] = float(room - needed)
    as_floats = {kind: float(value) for kind, value in missed.items()}
    return Proof(constants, design, as_floats, margins, is_exact)


def _find_rooms(design: Design, once: float) -> tuple[dict[str, Fraction], bool]:
    """Return the room of every condition under which shifted plans are admissible, and whether it
    is proved."""
    try:
        margins = recheck(design).margins
    except ValueError:
        normals = np.linalg.norm(design.bounds.terminal_normals, axis=1)
        least = Fraction(once) * Fraction(min(1.0, float(normals.min(initial=1.0))))
        return {f"{kind} shifted": least for kind in KINDS}, False
    rooms = {name: margin for name, margin in margins.items() if name.split(" ")[0] in KINDS}
    return {name: margin for name, margin in rooms.items() if _is_of_rows(name)}, True


def _is_of_rows(name: str) -> bool:
    """Tell whether a condition of the exact re-check is about the rows that a plan keeps."""
    return name.split(" ")[-1] in ("reach", "shifted", "returns")


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
        """Return over + under at worst, by kind of row."""
        worst = np.array([self._miss_rows(w) for w in range(len(self._constants.rows))])
        by_row = worst.max(axis=0)
        return {
            kind: max(by_row[of_kind], default=Fraction(0))
            for kind, of_kind in zip(KINDS, self._kinds, strict=True)
        }

    def _miss_rows(self, window: int) -> Exact:
        """Return over + under of every row of a window."""
        constants = self._constants
        norms = as_fractions(self._norms[window])
        exact = _predict_rows(self._design, window)[self._order]
        written = np.hstack([constants.row_errors[window], constants.rows[window]])
        scaled = as_fractions(written.astype(float))
        differs = np.abs(norms[:, None] * scaled - exact) @ self._box
        size = np.abs(scaled) @ self._box
        tolerance = Fraction(constants.precision.tolerance)
        total = 2 * differs
        lower, upper = _bound_rows(self._design, window)
        of_bounds = np.full(len(norms), Fraction(0), object)
        for ours, theirs in ((-lower, -constants.lower[window]), (upper, constants.upper[window])):
            finite = np.isfinite(ours[self._order])
            exported = as_fractions(np.where(finite, theirs, 0.0).astype(float))
            designed = as_fractions(np.where(finite, ours[self._order], 0.0))
            rounding = self._bound_rounding(size + np.abs(exported))
            # What one side takes by its bound, the other one gives.
            taken = np.abs(norms * exported - designed) + norms * (2 * rounding + tolerance)
            of_bounds = np.where(finite, np.maximum(of_bounds, taken), of_bounds)
        return total + of_bounds

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
        return "not certified; constraints cannot be drawn in as far as it needs"
    least = min(proof.margins, key=lambda condition: proof.margins[condition])
    words = "certified again" if proof.holds else "NOT certified"
    if proof.holds and not proof.constants.is_certified:
        words = "as exact as the design, which is NOT certified for the robot"
    return f"{words}, least margin {proof.margins[least]:.3g} ({least})"
