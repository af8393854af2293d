"""Tightened constraints: what the tube in use takes from E and U at every stage.

    E_j = E - R_j,  j = 1..N-1        U_j = U - co u_i K_i R_j,  j = 0..N-1        (eqs. (28)-(29))

Rows that couple input and error, D u + C e <= d, lose the support numbers of (D K_i + C) R_j.

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (28)-(29).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxtube.coordinates import ERROR_NAMES, INPUT_NAMES
from jaxtube.qp.regions import AnyArray
from jaxtube.synthesis.advice import say_what_helps
from jaxtube.synthesis.control_problem import ControlProblem
from jaxtube.synthesis.linear_problem import LinearProblem
from jaxtube.synthesis.problem import Problem
from jaxtube.synthesis.tubes import Tube
from jaxtube.synthesis.windows import Windows

BACK_OFF = 1e-7
"""Share of its limit that a constraint is drawn in by for the solver, at least."""
LONG_ROW = 10.0
"""Norm of a row, divided by its limit, from which on its answers miss it by more."""

WHEEL_NAMES = ("right wheel deficit", "left wheel deficit")
CAP_NAMES = (*INPUT_NAMES, "coupled cap, outwards", "coupled cap, inwards")
STEP_NAMES = (
    "right command beside its law",
    "right command's step",
    "left command beside its law",
    "left command's step",
)
UNITS = {
    "longitudinal error": "m",
    "lateral error": "m",
    "heading error": "deg",
    "right wheel deficit": "m/s",
    "left wheel deficit": "m/s",
    "speed deficit": "m/s",
    "yaw rate deficit": "rad/s",
    **dict.fromkeys(STEP_NAMES, "m/s"),
}
"""Units in which constraints are told, by name; the coupled cap is a share and has none."""


class EmptySetError(ValueError):
    """A tightened set is empty: no plan can exist. The message says which one and by how much."""


@dataclass(frozen=True, eq=False)
class Tightening:
    """Support numbers of the tube in use, window by window: `error_reach[w, j]` of R_j along the
    rows of E, `input_reach[w, j]` along the input rows under u = K e."""

    error_reach: Float[np.ndarray, "windows horizon+1 6"]
    input_reach: Float[np.ndarray, "windows horizon k"]


def find_back_off(problem: ControlProblem) -> float:
    """Return the share of its limit that every constraint is drawn in by for the solver, once more
    at every stage: more than the slack that the solver allows.

    So a plan that misses its constraints by that slack still meets, shifted, those of a stage less.
    A solver's slack is a share of the length of a row. Beside its limit a row is long where the
    robot is small or slow; all limits are then drawn in alike, so that no unit matters.
    """
    every = [regime.input_rows for regime in problem.every_regime]
    of_inputs = [
        np.linalg.norm(np.hstack([rows.inputs, rows.errors]), axis=1) / rows.offsets
        for rows in every
    ]
    longest = max(np.max(of_inputs), (1 / problem.operating_set.offsets).max())
    return BACK_OFF * max(1.0, float(longest) / LONG_ROW)


def reach_of_limits(
    problem: ControlProblem, normals: Float[AnyArray, "k n"]
) -> Float[AnyArray, " k"]:
    """Return how far the box of the error limits reaches along rows: their own limits, to which the
    back-off of rows on the error is relative."""
    return abs(normals) @ problem.error_widths


def tighten(problem: ControlProblem, tube: Tube, windows: Windows) -> Tightening:
    """Return the support numbers that E and U lose at every stage, in every window."""
    N = problem.horizon
    count = len(windows.schedules)
    rows = problem.operating_set.normals
    errors = np.stack([tube.support(j, rows) for j in range(N + 1)], axis=1)
    by_stage = [problem.input_rows] * N
    if tube.follows_reference:
        by_stage = [problem.rows_of(regimes) for regimes in windows.regimes.T]
    inputs = np.stack([tube.input_support(j, by_stage[j]) for j in range(N)], axis=1)
    return Tightening(
        np.broadcast_to(errors, (count, *errors.shape[1:])),
        np.broadcast_to(inputs, (count, *inputs.shape[1:])),
    )


def error_names(problem: ControlProblem) -> tuple[str, ...]:
    """Return the names of the rows of E, one for each opposite pair."""
    return problem.error_names if isinstance(problem, LinearProblem) else ERROR_NAMES


def input_names(problem: ControlProblem) -> tuple[str, ...]:
    """Return the names of the input rows, one for each opposite pair."""
    if isinstance(problem, LinearProblem):
        return problem.input_names
    assert isinstance(problem, Problem)
    first = problem.every_regime[0]
    steps = () if first.first_command is None else STEP_NAMES
    if first.scenario.operating.yaw_rate_deficit_radps is None:
        return (*WHEEL_NAMES, *steps)
    return (*CAP_NAMES[: len(first.cap_rows.offsets) // 2], *steps)


def refuse_empty(problem: ControlProblem, tightening: Tightening, windows: Windows) -> None:
    """Raise EmptySetError for the first stage at which E_j or U_j has nothing left."""
    error_reach = tightening.error_reach[:, : problem.horizon]
    offsets = np.broadcast_to(problem.operating_set.offsets, error_reach.shape)
    _refuse_empty(problem, "E", offsets, error_reach, error_names(problem))
    offsets = problem.rows_of(windows.regimes).offsets
    _refuse_empty(problem, "U", offsets, tightening.input_reach, input_names(problem))


def _refuse_empty(
    problem: ControlProblem,
    name: str,
    offsets: Float[np.ndarray, "windows horizon k"],
    reach: Float[np.ndarray, "windows horizon k"],
    coordinates: tuple[str, ...],
) -> None:
    left = offsets - reach
    size = len(coordinates)
    width = left[..., :size] + left[..., size:]
    is_empty = np.any(width < 0, axis=(0, 2))
    if not is_empty.any():
        return
    stage = int(np.argmax(is_empty))
    window, row = np.unravel_index(np.argmin(width[:, stage]), width[:, stage].shape)
    missing = -width[window, stage, row]
    whole = offsets[window, stage, row] + offsets[window, stage, row + size]
    raise EmptySetError(
        f"{name}_{stage} is empty: in the {coordinates[row]} the tube of stage {stage} is "
        f"{whole + missing:.4g} wide and {name} only {whole:.4g} (short by {missing:.4g}); "
        f"shorten controller.horizon, or {say_what_helps(problem)}"
    )
