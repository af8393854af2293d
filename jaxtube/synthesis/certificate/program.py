"""The QPs that run, compared with the sets that are certified: plans are predicted by the model
along the reference, and bounded by the tightened sets.

Predictions are affine in the first error and in the inputs, so they agree everywhere if they agree
at the unit vectors of both. Errors are advanced period by period here, not by products of matrices.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from jaxtube.synthesis.parts import Design
from jaxtube.synthesis.prediction import UNREACHED
from sets.certificate import Condition, judge

SAME = 1e-11
"""Difference that is rounding, relative to the greatest entry of what is compared."""

Block = tuple[str, np.ndarray, np.ndarray]
"""What is compared, as the QPs have it, and as it must be."""


def check_program(design: Design) -> Condition:
    """Check that the tube-MPC's QPs, of every window and of every step of the run, ask of a plan
    what the certificate is about."""
    name, excess = max(map(_compare, _blocks(design)), key=lambda compared: compared[1])
    return judge(
        "plans_keep_these_sets",
        SAME - excess,
        "The QPs of every window predict by the model, along the reference, and bound their plans "
        "by the tightened sets.",
        f"In the QPs {name} are not those of the certified sets; they differ by {excess:.3g} of "
        "the greatest.",
    )


def _compare(block: Block) -> tuple[str, float]:
    """Return the name of a block and its greatest difference, relative to its greatest entry."""
    name, actual, expected = block
    if actual.shape != expected.shape:
        return name, np.inf
    finite = np.isfinite(expected)
    if not np.array_equal(actual[~finite], expected[~finite]):
        return name, np.inf
    scale = np.max(np.abs(expected), where=finite, initial=1.0)
    missed = np.abs(np.where(finite, actual, 0.0) - np.where(finite, expected, 0.0))
    return name, float(np.max(missed, initial=0.0) / scale)


def _blocks(design: Design) -> Iterator[Block]:
    """Yield what is compared."""
    problem = design.problem
    windows = design.windows
    steps = np.arange(len(windows.index))[:, None] + np.arange(problem.horizon)
    yield "wheel speeds ahead", windows.schedules[windows.index], problem.schedule[steps]
    yield "regimes ahead", windows.regimes[windows.index], problem.period_regimes[steps]
    transitions, inputs = problem.model.matrices(windows.schedules)
    yield "loops", windows.loops, transitions + inputs @ windows.gains
    qp = design.tube_qps
    yield "gains of the tube", qp.tube_gain, windows.gains[:, 0]
    yield "the first transitions", qp.transition, transitions[:, 0]
    yield "the first input matrices", qp.input_matrix, inputs[:, 0]
    rows = predict_rows(design)
    lower, upper = bound_rows(design)
    is_reached = np.abs(rows[:, :, 3:]).max(axis=(0, 2)) > UNREACHED
    on_inputs = qp.factors.rows * qp.factors.row_norms[..., None]
    yield "the rows", np.concatenate([qp.row_errors, on_inputs], axis=2), rows[:, is_reached]
    yield "the lower bounds", qp.lower, lower[:, is_reached]
    yield "the upper bounds", qp.upper, upper[:, is_reached]
    yield "the rows on the first error", qp.check_errors, rows[:, ~is_reached, :3]
    yield "the lower bounds on the first error", qp.check_lower, lower[:, ~is_reached]
    yield "the upper bounds on the first error", qp.check_upper, upper[:, ~is_reached]
    free_rows = rows[:, is_reached, :3] + rows[:, is_reached, 3:] @ qp.free_inputs
    yield "the rows without constraints", qp.free_rows, free_rows


def predict_rows(design: Design) -> Float[np.ndarray, "windows m 3+n"]:
    """Return what the rows on E_1 .. E_{N-1}, on U_0 .. U_{N-1} and on e_N become at the unit
    vectors of the first error and of the inputs; of opposite rows the first stands for both."""
    problem = design.problem
    N = problem.horizon
    transitions, input_matrices = problem.model.matrices(design.windows.schedules)
    half = len(problem.input_rows.offsets) // 2
    error_rows = problem.operating_set.normals[:3]
    on_inputs = problem.input_rows.inputs[:half]
    on_errors = problem.input_rows.errors[:half]
    probes = np.eye(3 + 2 * N)
    inputs = probes[3:].reshape(N, 2, -1)
    errors = np.broadcast_to(probes[:3], (len(transitions), 3, len(probes)))
    of_errors = []
    of_inputs = []
    for stage in range(N):
        if stage > 0:
            of_errors.append(error_rows @ errors)
        of_inputs.append(on_inputs @ inputs[stage] + on_errors @ errors)
        errors = transitions[:, stage] @ errors + input_matrices[:, stage] @ inputs[stage]
    of_terminal = design.bounds.terminal_normals @ errors
    return np.concatenate([*of_errors, *of_inputs, of_terminal], axis=1)


def bound_rows(
    design: Design,
) -> tuple[Float[np.ndarray, "windows m"], Float[np.ndarray, "windows m"]]:
    """Return the lower and upper bounds of these rows."""
    bounds = design.bounds
    N = design.problem.horizon
    half = len(design.problem.input_rows.offsets) // 2
    upper = [bounds.errors[:, stage, :3] for stage in range(1, N)]
    upper += [bounds.inputs[:, stage, :half] for stage in range(N)]
    lower = [-bounds.errors[:, stage, 3:] for stage in range(1, N)]
    lower += [-bounds.inputs[:, stage, half:] for stage in range(N)]
    unbounded = np.full(bounds.terminal.shape, -np.inf)
    return (
        np.concatenate([*lower, unbounded], axis=1),
        np.concatenate([*upper, bounds.terminal], axis=1),
    )
