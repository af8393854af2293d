"""Laws of the condensed QP: predictions, cost, rows and bounds are those of plain loops over the
stages; many windows and long horizons are condensed in no time."""

import dataclasses
import re
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import SEQUENCE, TIGHT, PlainMpc, model, simulate_model, terminal_gain, tube_gain
from tolerances import CLOSED_LOOP, ROUNDING, WORLD_FRAME

from jaxtube.simulation import components
from jaxtube.synthesis import condense
from jaxtube.synthesis.prediction import predict
from jaxtube.synthesis.tightening import BACK_OFF
from sets.tubes import sequence_tube

EXACT_MODEL = ("controller.model=consistent", "controller.discretisation=zoh")
CASES = {
    "summed, T-B": ("robust",),
    "sequence, T-A": ("paper", *SEQUENCE),
    "no terminal set": ("robust", *TIGHT),
    "zero-order hold": ("robust", *EXACT_MODEL),
    "one stage": ("robust", "controller.horizon=1"),
}


@pytest.fixture(params=CASES, scope="module")
def condensed(request, uncertified):
    return uncertified(*CASES[request.param])


def samples(found, seed, count=3):
    """Yield (window, schedules ahead, error, inputs) at random for every distinct window."""
    generator = np.random.default_rng(seed)
    N = found.problem.horizon
    for window, schedules in enumerate(found.windows.schedules):
        for _ in range(count):
            yield window, schedules, generator.normal(size=3), generator.normal(size=(N, 2))


def take(found, window, which="tube_qps"):
    return jax.tree.map(lambda array: array[window], getattr(found, which))


def test_windows_are_the_stretches_of_the_reference(condensed):
    problem = condensed.problem
    windows = condensed.windows
    for step, window in enumerate(windows.index):
        ahead = problem.schedule[step : step + problem.horizon]
        np.testing.assert_allclose(windows.schedules[window], ahead, atol=1e2 * ROUNDING)
    assert len(windows.index) == problem.reference.steps
    assert len(np.unique(windows.schedules.round(9), axis=0)) == len(windows.schedules)


def test_the_next_error_is_that_of_a_step_by_step_simulation(condensed):
    for window, schedules, error, inputs in samples(condensed, 1):
        w = take(condensed, window)
        expected = simulate_model(condensed.problem, schedules, error, inputs)
        step = w.transition @ error + w.input_matrix @ inputs[0]
        np.testing.assert_allclose(step, expected[1], atol=CLOSED_LOOP)


def plain_cost(found, schedules, error, inputs):
    """The cost of section 9: sum of e'Qe + g'Rg over N stages, and e'Pe at the end."""
    problem = found.problem
    errors = simulate_model(problem, schedules, error, inputs)
    stages = sum(
        e @ problem.error_weight @ e + g @ problem.input_weight @ g
        for e, g in zip(errors[:-1], inputs, strict=True)
    )
    return stages + errors[-1] @ found.cost.cost @ errors[-1]


def test_the_quadratic_program_has_the_cost_of_the_plan_up_to_one_factor(condensed):
    ratios = []
    for window, schedules, error, inputs in samples(condensed, 2):
        w = take(condensed, window)
        g = inputs.ravel()
        moving = plain_cost(condensed, schedules, error, inputs)
        standing = plain_cost(condensed, schedules, error, 0 * inputs)
        expected = moving - standing
        ratios.append(expected / (g @ w.factors.hessian @ g / 2 + w.linear @ error @ g))
    np.testing.assert_allclose(ratios, ratios[0], rtol=1e3 * CLOSED_LOOP)
    largest = np.max(
        np.abs(condensed.tube_qps.linear) @ condensed.problem.operating_set.offsets[:3]
    )
    assert largest == pytest.approx(1) if ratios[0] > 1 else largest <= 1 + ROUNDING
    assert ratios[0] >= 1 - 1e3 * CLOSED_LOOP


def section_of(found, window, j):
    """R_j of a window."""
    if found.tube.follows_reference:
        return sequence_tube(found.windows.loops[window], found.problem.disturbance_set)[j]
    return found.tube[j]


def input_reach(found, window, schedules, j, row):
    """Support number of K R_j along a row of U, over every gain that may act."""
    vertices = [schedules[j]] if found.tube.follows_reference else found.problem.model.vertices
    section = section_of(found, window, j)
    return max(section.support(row @ tube_gain(found, wheels))[0] for wheels in vertices)


def plain_rows(found, window, schedules, error, inputs):
    """Return the arrays (values, lower, upper) of every constraint on a plan in turn."""
    problem = found.problem
    errors = simulate_model(problem, schedules, error, inputs)
    limits = problem.error_set.offsets[:3]
    rows = []
    for j in range(1, problem.horizon):
        for axis in range(3):
            left = (
                limits[axis]
                - section_of(found, window, j).support(np.eye(3)[axis])[0]
                - (j + 1) * BACK_OFF * limits[axis]
            )
            rows.append((errors[j, axis], -left, left))
    b = problem.robot.track_width
    U = problem.input_set.offsets
    for j in range(problem.horizon):
        for wheel, sign in enumerate((1, -1)):
            row = np.array([1, sign * b / 2])
            left = 1 - (j + 1) * BACK_OFF
            upper = left * U[wheel] - input_reach(found, window, schedules, j, row)
            lower = input_reach(found, window, schedules, j, -row) - left * U[2 + wheel]
            rows.append((row @ inputs[j], lower, upper))
    terminal = found.terminal
    last = (problem.horizon + 1) * BACK_OFF
    for row, offset in zip(
        terminal.constraint_normals, terminal.constraint_offsets[window], strict=True
    ):
        rows.append((row @ errors[-1], -np.inf, offset - last * abs(row) @ limits))
    return np.array(rows).T


def unreached_rows(found):
    """Tell which constraints no input moves: their values are the same for any two plans."""
    schedules = found.windows.schedules[0]
    N = found.problem.horizon
    generator = np.random.default_rng(4)
    plans = generator.normal(size=(2, N, 2))
    first = plain_rows(found, 0, schedules, np.ones(3), plans[0])[0]
    second = plain_rows(found, 0, schedules, np.ones(3), plans[1])[0]
    return np.abs(first - second) <= CLOSED_LOOP


def test_rows_and_bounds_are_the_constraints_and_rows_no_input_reaches_stand_apart(condensed):
    unreached = unreached_rows(condensed)
    for window, schedules, error, inputs in samples(condensed, 3, count=1):
        w = take(condensed, window)
        value, lower, upper = plain_rows(condensed, window, schedules, error, inputs)
        rows = w.factors.rows * w.factors.row_norms[:, None]
        np.testing.assert_allclose(
            w.row_errors @ error + rows @ inputs.ravel(), value[~unreached], atol=WORLD_FRAME
        )
        np.testing.assert_allclose(w.lower, lower[~unreached], atol=CLOSED_LOOP)
        np.testing.assert_allclose(w.upper, upper[~unreached], atol=CLOSED_LOOP)
        np.testing.assert_allclose(w.check_errors @ error, value[unreached], atol=CLOSED_LOOP)
        np.testing.assert_allclose(w.check_lower, lower[unreached], atol=CLOSED_LOOP)
        np.testing.assert_allclose(w.check_upper, upper[unreached], atol=CLOSED_LOOP)


def test_no_input_reaches_the_lateral_error_one_step_ahead_and_every_other_row_is_reached(
    uncertified,
):
    lateral_one_ahead = 1
    for name, expected in (
        ("summed, T-B", [lateral_one_ahead]),
        ("sequence, T-A", [lateral_one_ahead]),
    ):
        np.testing.assert_array_equal(
            np.flatnonzero(unreached_rows(uncertified(*CASES[name]))), expected
        )
    # Zero-order hold moves it within the step: V T^2 / 2 u2.
    assert not unreached_rows(uncertified(*CASES["zero-order hold"])).any()


def test_without_tube_the_rows_are_E_and_U_themselves_and_no_terminal_set(condensed):
    problem = condensed.problem
    unreached = unreached_rows(condensed)
    E = problem.error_set.offsets[:3]
    U = problem.input_set.offsets
    N = problem.horizon
    facets = len(condensed.terminal.constraint_normals)
    upper = np.concatenate([np.tile(E, N - 1), np.tile(U[:2], N), np.full(facets, np.inf)])
    lower = np.concatenate([np.tile(-E, N - 1), np.tile(-U[2:], N), np.full(facets, -np.inf)])
    plain = condensed.plain_qps
    for window in range(len(condensed.windows.schedules)):
        np.testing.assert_allclose(plain.upper[window], upper[~unreached], atol=ROUNDING)
        np.testing.assert_allclose(plain.lower[window], lower[~unreached], atol=ROUNDING)
        np.testing.assert_allclose(plain.check_upper[window], upper[unreached], atol=ROUNDING)
        np.testing.assert_allclose(plain.check_lower[window], lower[unreached], atol=ROUNDING)
    np.testing.assert_array_equal(plain.factors.hessian, condensed.tube_qps.factors.hessian)


def test_gains_of_a_window_are_those_of_its_first_schedule(condensed):
    for window, schedules in enumerate(condensed.windows.schedules):
        w = take(condensed, window)
        np.testing.assert_allclose(
            w.tube_gain, tube_gain(condensed, schedules[0]), atol=CLOSED_LOOP
        )
        np.testing.assert_allclose(
            w.terminal_gain, terminal_gain(condensed, schedules[0]), atol=CLOSED_LOOP
        )
        for j, wheels in enumerate(schedules):
            A, B = model(condensed.problem, wheels)
            loop = A + B @ tube_gain(condensed, wheels)
            np.testing.assert_allclose(condensed.windows.loops[window, j], loop, atol=CLOSED_LOOP)


def test_the_static_laws_are_the_tubes_gain_and_the_mpc_without_constraints(robust_design):
    controllers = components.controllers(robust_design)
    plain = PlainMpc(robust_design)
    for step in (0, 112, 115, 299):
        wheels = robust_design.problem.schedule[step]
        qp = plain.qp(step)
        first_inputs = -np.linalg.solve(qp.hessian, qp.linear)[:2]
        np.testing.assert_allclose(
            controllers["local_gain"].gains[step],
            tube_gain(robust_design, wheels),
            atol=CLOSED_LOOP,
        )
        np.testing.assert_allclose(
            controllers["equal_gain"].gains[step], first_inputs, atol=CLOSED_LOOP
        )


def test_the_free_plan_is_the_optimum_without_constraints(condensed):
    for window, _, error, _ in samples(condensed, 5):
        w = take(condensed, window)
        inputs = w.free_inputs @ error
        gradient = w.factors.hessian @ inputs + w.linear @ error
        assert (
            np.abs(gradient).max() <= 5 * np.finfo(float).eps * w.free_scale * np.abs(error).max()
        )
        rows = w.row_errors @ error + w.factors.rows * w.factors.row_norms[:, None] @ inputs
        np.testing.assert_allclose(w.free_rows @ error, rows, atol=CLOSED_LOOP)


# ---------------------------------------------------------------------------- many windows, in jax


def condense_in_jax(found, bounds):
    """The condensed QPs of a design as tuning computes them."""
    problem = found.problem
    ahead = predict(problem, found.windows, found.bounds.terminal_normals)
    schedules = found.windows.schedules[:, 0]
    gains = condense.Gains(found.windows.gains[:, 0], found.terminal.gains.along(schedules))
    cost = condense.Cost(problem.error_weight, problem.input_weight, found.cost.cost)
    ahead, gains, cost = jax.device_put((ahead, gains, cost))
    return condense.weigh(
        ahead, condense.row_bounds(bounds, ahead), gains, cost, condense.widths(problem)
    )


def test_jax_condenses_as_numpy_does(uncertified):
    found = uncertified(*CASES["sequence, T-A"])
    windows = jax.jit(lambda: condense_in_jax(found, found.bounds))()
    arrays = jax.tree.leaves(windows)
    for mine, expected in zip(arrays, jax.tree.leaves(found.tube_qps), strict=True):
        np.testing.assert_allclose(mine, expected, rtol=CLOSED_LOOP, atol=CLOSED_LOOP)


def test_no_lapack_call_of_the_differentiated_program_has_a_batch(uncertified):
    """Two such calls of one program may wait for each other for ever (see `qp.factors`)."""
    found = uncertified(*CASES["sequence, T-A"])

    def total(errors):
        bounds = dataclasses.replace(found.bounds, errors=errors)
        windows = condense_in_jax(found, bounds)
        return jnp.sum(windows.free_rows) + jnp.sum(windows.factors.rho), windows

    program = jax.jit(jax.grad(total, has_aux=True)).lower(jnp.asarray(found.bounds.errors))
    calls = [line for line in program.as_text().splitlines() if "custom_call @lapack" in line]
    assert len(found.windows.schedules) > 1 and calls
    for call in calls:
        assert not re.search(r"tensor<\d+x\d+x\d+x", call), call


LONG = """
from jaxtube.scenario import load
from jaxtube.synthesis.design import prepare
from jaxtube.synthesis.disturbance import complete_problem

for name, overrides in {cases!r}:
    found = prepare(complete_problem(load(name, overrides)))
    print(len(found.tube_qps.linear))
"""
LONG_PATH = ("reference.shape=lemniscate", "reference.duration_s=60")


def test_many_windows_and_long_horizons_do_not_stand_still():
    cases = [("paper", LONG_PATH), ("certified", ("controller.horizon=25",))]
    command = [sys.executable, "-c", LONG.format(cases=cases)]
    answer = subprocess.run(command, capture_output=True, text=True, timeout=300, check=True)
    assert answer.stdout.split() == ["600", "50"]


def test_bounds_are_drawn_in_by_a_share_of_each_limit(robust_design):
    problem = robust_design.problem
    windows = robust_design.windows
    bounds = robust_design.bounds
    share = 1e-3
    drawn = condense.draw_in(problem, windows, bounds, share)
    E = problem.operating_set.offsets
    limits = np.broadcast_to(E, bounds.errors.shape)
    np.testing.assert_allclose(bounds.errors - drawn.errors, share * limits, rtol=1e-9)
    limits = np.broadcast_to(problem.input_rows.offsets, bounds.inputs.shape)
    np.testing.assert_allclose(bounds.inputs - drawn.inputs, share * limits, rtol=1e-9)
    reach = np.broadcast_to(np.abs(bounds.terminal_normals) @ E[:3], bounds.terminal.shape)
    np.testing.assert_allclose(bounds.terminal - drawn.terminal, share * reach, rtol=1e-9)
