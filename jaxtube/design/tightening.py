"""Local gains, the four tubes, and what each takes from E and U along the reference.

    K(th) = K^n + K^r dV_r + K^l dV_l     (LQR at the centre of the box, compensating gains of eqs. (22)-(25)), or the
    terminal gains themselves; both are bilinear in the schedule and kept as their values at the four vertices.

    E_j = E - R_j,  j = 1..N-1        U_j = U - co u_i K_i R_j,  j = 0..N-1        (eqs. (28)-(29))

Windows are the distinct stretches of N schedules along the reference: on a circle all steps share one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from jaxtube.design.problem import Problem
from sets import tubes
from sets.lmi import lqr_gain
from sets.tubes import Section

BACK_OFF = 1e-7
"""Share of the solver: ten times the residual it accepts, in the units of E and U."""


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
class Windows:
    """Distinct stretches of N schedules, and which one each step of the run has ahead."""

    schedules: Float[np.ndarray, "windows horizon 2"]
    index: Int[np.ndarray, " steps"]
    loops: Float[np.ndarray, "windows horizon 3 3"]
    gains: Float[np.ndarray, "windows horizon 2 3"]


@dataclass(frozen=True, eq=False)
class Tightening:
    """Support numbers of the tube that the controller uses, window by window.

    `error_reach[w, j]` along the rows of E for R_j, `input_reach[w, j]` along the rows of U for K R_j; `sections` are
    the R_j themselves where all windows share them, None for `sequence`.
    """

    error_reach: Float[np.ndarray, "windows horizon+1 6"]
    input_reach: Float[np.ndarray, "windows horizon 4"]
    sections: list[Section] | None


def compensating_gain(problem: Problem) -> LocalGain:
    """Return the gain of eqs. (22)-(25): LQR at the centre, first rows of A_r and A_l cancelled."""
    model = problem.model
    nominal = lqr_gain(*model.matrices(model.centre), problem.error_weight, problem.input_weight)
    slopes = np.stack(model.compensating_gains())
    return LocalGain(nominal, nominal + np.tensordot(model.vertices - model.centre, slopes, axes=1))


def vertex_loops(problem: Problem, gain: LocalGain) -> Float[np.ndarray, "4 3 3"]:
    """Return Phi_i = A_i + B_i K_i at the vertices of the box."""
    transitions, inputs = problem.model.matrices(problem.model.vertices)
    return transitions + inputs @ gain.vertices


def make_windows(problem: Problem, gain: LocalGain) -> Windows:
    """Collect the distinct windows of the reference with their closed loops."""
    horizon, steps = problem.horizon, problem.reference.steps
    stretches = np.stack([problem.schedule[j : j + steps] for j in range(horizon)], axis=1)
    schedules, index = np.unique(stretches.round(12), axis=0, return_inverse=True)
    transitions, inputs = problem.model.matrices(schedules)
    gains = gain.at(problem.model.weights(schedules))
    return Windows(schedules, index.reshape(-1), transitions + inputs @ gains, gains)


def make_tubes(problem: Problem, gain: LocalGain, windows: Windows) -> dict[str, list[Section]]:
    """Return the sections R_0 .. R_N of the four tubes; `sequence` along the window with the widest lateral reach.

    `paper` is left out where eq. (27) does not apply, that is where the loop is not affine in the schedule.
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
    return int(np.argmax(tubes.sequence_support(windows.loops, problem.disturbance_set, lateral, problem.horizon)))


def loop_slopes(problem: Problem, gain: LocalGain):
    """Return (Phi_n, slope in V_r, slope in V_l) where Phi is affine in the schedule, else None."""
    model = problem.model
    loops = vertex_loops(problem, gain)
    corners = np.column_stack([np.ones(4), model.vertices - model.centre])
    fitted, *_ = np.linalg.lstsq(corners, loops.reshape(4, 9), rcond=None)
    if np.max(np.abs(corners @ fitted - loops.reshape(4, 9))) > 1e-12 or model.discretisation != "euler":
        return None
    return fitted.reshape(3, 3, 3)


def tighten(problem: Problem, gain: LocalGain, windows: Windows, sections: list[Section], tube: str) -> Tightening:
    """Return the support numbers that E and U lose at every stage, window by window."""
    error_rows, input_rows = problem.error_set.normals, problem.input_set.normals
    count, N = len(windows.schedules), problem.horizon
    if tube != "sequence":
        errors = np.stack([section.support(error_rows) for section in sections])
        inputs = np.stack([tubes.input_support(section, gain.vertices, input_rows) for section in sections[:N]])
        shared = np.broadcast_to(errors, (count, N + 1, 6)), np.broadcast_to(inputs, (count, N, 4))
        return Tightening(*shared, sections)
    W = problem.disturbance_set
    rows = np.broadcast_to(error_rows, (count, 6, 3))
    errors = [tubes.sequence_support(windows.loops, W, rows, j) for j in range(N + 1)]
    inputs = [tubes.sequence_support(windows.loops, W, input_rows @ windows.gains[:, j], j) for j in range(N)]
    return Tightening(np.stack(errors, axis=1), np.stack(inputs, axis=1), None)


ERROR_NAMES = ("longitudinal error", "lateral error", "heading error")
INPUT_NAMES = ("right wheel deficit", "left wheel deficit")


def refuse_empty(problem: Problem, tightening: Tightening) -> None:
    """Raise EmptySetError for the first stage at which E_j or U_j has nothing left."""
    checks = (
        ("E", problem.error_set.offsets, tightening.error_reach[:, : problem.horizon], ERROR_NAMES),
        ("U", problem.input_set.offsets, tightening.input_reach, INPUT_NAMES),
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
