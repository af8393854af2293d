"""Local gains, the four tubes, and what each takes from E and U along the reference.

    K(th) = K^n + K^r dV_r + K^l dV_l     (LQR at the centre of the box, compensating gains of eqs. (22)-(25)), or the
    terminal gains themselves; all are bilinear in the schedule and kept as their values at the four vertices.

    E_j = E - R_j,  j = 1..N-1        U_j = U - co u_i K_i R_j,  j = 0..N-1        (eqs. (28)-(29))

Rows that couple input and error, D u + C e <= d, lose the support numbers of (D K_i + C) R_j.

Windows are the distinct stretches of N schedules along the reference: on a circle all steps share
one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from jaxtube.plant.model import VERTEX_SIDES, Model, bilinear_weights
from jaxtube.synthesis.problem import Problem
from sets import tubes
from sets.lmi import lqr_gain
from sets.tubes import Section

BACK_OFF = 1e-7
"""What constraints are drawn in by for the solver, once more at every stage: more than the residual
it accepts, in the units of E and U. So a plan that misses its constraints by a residual still
meets, shifted, those of a stage less."""


class EmptySetError(ValueError):
    """A tightened set is empty: no plan can exist. The message says which one and by how much."""


@dataclass(frozen=True, eq=False)
class LocalGain:
    """A gain u = +K(th) e scheduled bilinearly between its vertex values."""

    nominal: Float[np.ndarray, "2 3"]  # at the centre of the box
    vertices: Float[np.ndarray, "4 2 3"]

    def at(self, weights: Float[np.ndarray, "... 4"]) -> Float[np.ndarray, "... 2 3"]:
        """Return the gain at the schedules with these bilinear weights."""
        return np.tensordot(weights, self.vertices, axes=1)


@dataclass(frozen=True, eq=False)
class DecoupledGain(LocalGain):
    """u1 = -k1 e_x - Om e_y, u2 = -k2 e_y - k3 e_th, with T Om the model's own A_12: e_x+ = (1 - T
    k1) e_x + w_x.

    Under the exact Jacobian the closed loop depends on h and c alone, and affinely: on the
    stretched wheel speeds.
    """


@dataclass(frozen=True, eq=False)
class Windows:
    """Distinct stretches of N schedules, and which one each step of the run has ahead."""

    schedules: Float[np.ndarray, "windows horizon 2"]
    index: Int[np.ndarray, " steps"]
    loops: Float[np.ndarray, "windows horizon 3 3"]
    gains: Float[np.ndarray, "windows horizon 2 3"]


@dataclass(frozen=True, eq=False)
class Tightening:
    """Support numbers of the tube that the controller uses, window by window.

    `error_reach[w, j]` along the rows of E for R_j, `input_reach[w, j]` along the input rows under
    u = K e for R_j; `sections` are the R_j themselves where all windows share them, None for
    `sequence`.
    """

    error_reach: Float[np.ndarray, "windows horizon+1 6"]
    input_reach: Float[np.ndarray, "windows horizon k"]
    sections: list[Section] | None


def compensating_gain(problem: Problem) -> LocalGain:
    """Return the gain of eqs. (22)-(25): LQR at the centre, first rows of A_r and A_l cancelled."""
    model = problem.model
    nominal = lqr_gain(*model.matrices(model.centre), problem.error_weight, problem.input_weight)
    slopes = np.stack(model.compensating_gains())
    return LocalGain(nominal, nominal + np.tensordot(model.vertices - model.centre, slopes, axes=1))


def decoupled_gain(
    problem: Problem, gains: Sequence[float] | Float[np.ndarray, "3"]
) -> DecoupledGain:
    """Return the gain with k1 (1/s), k2 (rad/(m s)) and k3 (1/s)."""
    model, (k1, k2, k3) = problem.model, gains

    def at(schedules) -> np.ndarray:
        transitions, _ = model.matrices(schedules)
        law = np.tile([[-k1, 0.0, 0.0], [0.0, -k2, -k3]], (*transitions.shape[:-2], 1, 1))
        law[..., 0, 1] = -transitions[..., 0, 1] / model.dt
        return law

    return DecoupledGain(at(model.centre), at(model.vertices))


def given_gain(problem: Problem, numbers: Float[np.ndarray, " kappa"]) -> LocalGain:
    """Return the gain of numbers in the order of `Problem.given_gains`: three decouple, 24 are the
    vertex gains."""
    if len(numbers) == 3:
        return decoupled_gain(problem, numbers)
    vertices = np.reshape(numbers, (4, 2, 3))
    return LocalGain(vertices.mean(axis=0), vertices)


def vertex_loops(problem: Problem, gain: LocalGain) -> Float[np.ndarray, "v 3 3"]:
    """Return loops whose mixtures are to hold A + B K at every schedule in the regions
    (`vertices_cover_schedule`).

    Those at the corners of each region; of a decoupled gain under the exact Jacobian, those at the
    corners of the stretched wheel speeds.
    """
    return _distinct(vertex_pairs(problem, gain)[0])


def vertex_pairs(
    problem: Problem, gain: LocalGain
) -> tuple[Float[np.ndarray, "v 3 3"], Float[np.ndarray, "v 2 3"]]:
    """Return loops and gains whose joint mixtures are to hold (A + B K, K) at every schedule in the
    regions."""
    model, gains = problem.model, gains_at_corners(problem, gain)
    if isinstance(gain, DecoupledGain) and model.discretisation == "exact":
        loops = _distinct(
            np.concatenate([_region_loops(problem, gain, region) for region in problem.regions])
        )
        gains = _distinct(gains)
        return np.repeat(loops, len(gains), axis=0), np.tile(gains, (len(loops), 1, 1))
    transitions, inputs = model.matrices(problem.corners)
    return transitions + inputs @ gains, gains


def _distinct(matrices: Float[np.ndarray, "v m n"]) -> Float[np.ndarray, "w m n"]:
    """Return the matrices without repetitions, in the order of their first appearance."""
    first = np.unique(matrices.reshape(len(matrices), -1), axis=0, return_index=True)[1]
    return matrices[np.sort(first)]


def gains_at_corners(problem: Problem, gain: LocalGain) -> Float[np.ndarray, "4m 2 3"]:
    """Return the gains at the corners of the regions, whose mixtures hold every gain that is used
    there."""
    return gain.at(problem.model.weights(problem.corners))


def _region_loops(problem: Problem, gain: LocalGain, region) -> Float[np.ndarray, "4 3 3"]:
    return exact_loops(
        problem.model, gain, np.stack(problem.model.stretched_box(*region))[VERTEX_SIDES, [0, 1]]
    )


def exact_loops(
    model: Model, gain: LocalGain, stretched: Float[np.ndarray, "v 2"]
) -> Float[np.ndarray, "v 3 3"]:
    """Return the loops of a decoupled gain under the exact Jacobian, affine in stretched wheel
    speeds."""
    T = model.dt
    k1, k2, k3 = -gain.nominal[0, 0], -gain.nominal[1, 1], -gain.nominal[1, 2]
    loops = np.zeros((len(stretched), 3, 3))
    loops[:, 0, 0], loops[:, 2, 1], loops[:, 2, 2] = 1 - T * k1, -T * k2, 1 - T * k3
    for loop, (h, c) in zip(loops, model.turn_and_reach(stretched), strict=True):
        loop[1] = -h * (2 - T * k1), 1 - c * T * k2 / 2, c * (1 - T * k3 / 2)
    return loops


def coverage_gap(problem: Problem, gain: LocalGain, schedules: Float[np.ndarray, "k 2"], region):
    """Return by how much A + B K at each schedule misses the mixtures of the corner loops of a
    region (k numbers)."""
    model = problem.model
    if isinstance(gain, DecoupledGain) and model.discretisation == "exact":
        weights = bilinear_weights(model.stretched(schedules), *model.stretched_box(*region))
        loops = _region_loops(problem, gain, region)
    else:
        weights, corners = bilinear_weights(schedules, *region), region[VERTEX_SIDES, [0, 1]]
        transitions, inputs = model.matrices(corners)
        loops = transitions + inputs @ gain.at(model.weights(corners))
    transitions, inputs = model.matrices(schedules)
    found = transitions + inputs @ gain.at(model.weights(schedules))
    missed = np.abs(found - np.tensordot(weights, loops, axes=1)).max(axis=(1, 2))
    return np.maximum(missed, -weights.min(axis=1))


def make_windows(problem: Problem, gain: LocalGain) -> Windows:
    """Collect the distinct windows of the reference with their closed loops."""
    horizon, steps = problem.horizon, problem.reference.steps
    stretches = np.stack([problem.schedule[j : j + steps] for j in range(horizon)], axis=1)
    schedules, index = np.unique(stretches.round(12), axis=0, return_inverse=True)
    transitions, inputs = problem.model.matrices(schedules)
    gains = gain.at(problem.model.weights(schedules))
    return Windows(schedules, index.reshape(-1), transitions + inputs @ gains, gains)


def make_tubes(problem: Problem, gain: LocalGain, windows: Windows) -> dict[str, list[Section]]:
    """Return the sections R_0 .. R_N of the four tubes; `sequence` along the window with the widest
    lateral reach.

    `paper` is left out where eq. (27) does not apply, that is where the loop is not affine in the
    schedule.
    """
    W, N = problem.disturbance_set, problem.horizon
    loops = vertex_loops(problem, gain)
    found = {}
    slopes = loop_slopes(problem, gain)
    if slopes is not None:
        nominal, right, left = slopes
        right_range, left_range = ((-half, half) for half in problem.model.half_widths)
        found["paper"] = tubes.paper_tube(nominal, (right, left), (right_range, left_range), W, N)
    found["hull"] = tubes.hull_tube(loops, W, N)
    found["summed"] = tubes.summed_tube(loops, W, N)
    found["sequence"] = tubes.sequence_tube(windows.loops[widest_window(problem, windows)], W)
    return found


def widest_window(problem: Problem, windows: Windows) -> int:
    """Return the window whose `sequence` tube has the widest lateral reach: the one that is shown."""
    lateral = np.broadcast_to([0.0, 1.0, 0.0], (len(windows.loops), 1, 3))
    return int(
        np.argmax(
            tubes.sequence_support(windows.loops, problem.disturbance_set, lateral, problem.horizon)
        )
    )


def loop_slopes(problem: Problem, gain: LocalGain):
    """Return (Phi_n, slope in V_r, slope in V_l) where Phi is affine in the schedule, else None."""
    model = problem.model
    if model.discretisation != "euler":
        return None
    transitions, inputs = model.matrices(model.vertices)
    loops = (transitions + inputs @ gain.vertices).reshape(4, 9)
    corners = np.column_stack([np.ones(4), model.vertices - model.centre])
    fitted, *_ = np.linalg.lstsq(corners, loops, rcond=None)
    return None if np.max(np.abs(corners @ fitted - loops)) > 1e-12 else fitted.reshape(3, 3, 3)


def tighten(
    problem: Problem, gain: LocalGain, windows: Windows, sections: list[Section], tube: str
) -> Tightening:
    """Return the support numbers that E and U lose at every stage, window by window."""
    error_rows, rows = problem.operating_set.normals, problem.input_rows
    count, N, k = len(windows.schedules), problem.horizon, len(problem.input_rows.offsets)
    if tube != "sequence":
        under = rows.under(gains_at_corners(problem, gain))
        errors = np.stack([section.support(error_rows) for section in sections])
        inputs = np.stack(
            [np.max([section.support(each) for each in under], axis=0) for section in sections[:N]]
        )
        shared = np.broadcast_to(errors, (count, N + 1, 6)), np.broadcast_to(inputs, (count, N, k))
        return Tightening(*shared, sections)
    W = problem.disturbance_set
    along = np.broadcast_to(error_rows, (count, 6, 3))
    errors = [tubes.sequence_support(windows.loops, W, along, j) for j in range(N + 1)]
    inputs = [
        tubes.sequence_support(windows.loops, W, rows.under(windows.gains[:, j]), j)
        for j in range(N)
    ]
    return Tightening(np.stack(errors, axis=1), np.stack(inputs, axis=1), None)


ERROR_NAMES = ("longitudinal error", "lateral error", "heading error")
WHEEL_NAMES = ("right wheel deficit", "left wheel deficit")
CAP_NAMES = ("speed deficit", "yaw rate deficit", "coupled cap, outwards", "coupled cap, inwards")


def input_names(problem: Problem) -> tuple[str, ...]:
    """Return the names of the input rows, one for each opposite pair."""
    if problem.scenario.operating.yaw_rate_deficit_radps is None:
        return WHEEL_NAMES
    return CAP_NAMES[: len(problem.input_rows.offsets) // 2]


def refuse_empty(problem: Problem, tightening: Tightening) -> None:
    """Raise EmptySetError for the first stage at which E_j or U_j has nothing left."""
    checks = (
        (
            "E",
            problem.operating_set.offsets,
            tightening.error_reach[:, : problem.horizon],
            ERROR_NAMES,
        ),
        ("U", problem.input_rows.offsets, tightening.input_reach, input_names(problem)),
    )
    for name, offsets, reach, coordinates in checks:
        left = offsets - reach
        size = len(coordinates)
        width = left[..., :size] + left[..., size:]
        if np.any(width < 0):
            narrowest = width.min(axis=0)
            stage = int(np.argmax(np.any(narrowest < 0, axis=1)))
            row = int(np.argmin(narrowest[stage]))
            worst = narrowest[stage, row]
            whole = offsets[row] + offsets[row + size]
            raise EmptySetError(
                f"{name}_{stage} is empty: in the {coordinates[row]} the tube of stage {stage} is {whole - worst:.4g} "
                f"wide and {name} only {whole:.4g} (short by {-worst:.4g}); shrink [disturbance], shorten "
                "controller.horizon or widen the limits"
            )
