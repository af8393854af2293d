"""Laws of the differentiable closed loop: it is the design's own. Laws of the vector of its weights
and gains."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tuned
from msgspec.structs import replace

from jaxtube import qp
from jaxtube.control.laws import TubeMpc
from jaxtube.simulation import components
from jaxtube.simulation.components import make_wheel_map
from jaxtube.simulation.rollout import realisation_keys, rollout
from jaxtube.synthesis.design import finish, prepare
from jaxtube.synthesis.feasible import boundary
from jaxtube.synthesis.problem import with_controller
from jaxtube.tuning.loop import (
    ROOM,
    Weights,
    condense_windows,
    make_design_constants,
    tightened_bounds,
)
from jaxtube.tuning.parameters import LEAST_PIVOT, make_parameters

SAME_WINDOWS = 1e-9
"""Relative and absolute; the same sets and weights, support numbers by sums and by vertices."""
SAME_LAPS = 1e-8
"""In m, rad and m/s; closed loops under windows that agree to rounding."""
SAME_WEIGHTS = 1e-14
"""Relative; weights from their Cholesky factors."""
SAME_VECTOR = 1e-7
"""Cholesky factors of weights of condition number 1e6 and more."""

LAPS = 16
STEPS = 30

condense = jax.jit(condense_windows)
drive = jax.jit(rollout.__wrapped__)


@pytest.fixture(
    scope="module", params=["decoupled", pytest.param("vertices", marks=pytest.mark.slow)]
)
def loop(request):
    """A design at a random point, and the windows that tuning gives it."""
    problem = tuned.problem_of(request.param)
    parameters = make_parameters(problem)
    point = tuned.random_point(problem, np.random.default_rng(3))
    scenario = parameters.scenario(problem.scenario, point)
    design = finish(prepare(with_controller(problem, scenario)))
    constants = make_design_constants(design)
    return design, constants, condense(constants, parameters.weights(jnp.asarray(point)))


def test_windows_are_those_of_the_design(loop):
    design, _, windows = loop
    expected = design.tube_qps
    m = expected.lower.shape[1]
    # Spare rows bound nothing.
    assert np.isinf(windows.lower[:, m:]).all() and np.isinf(windows.upper[:, m:]).all()
    by_row = {"lower", "upper", "row_errors", "free_rows"}
    for name in set(expected._fields) - {"factors", "regions", "free_region"}:
        value = getattr(windows, name)
        value = value[:, :m] if name in by_row else value
        assert_close(value, getattr(expected, name), name)
    factors = windows.factors
    assert_close(factors.hessian, expected.factors.hessian, "hessian")
    assert_close(factors.optimum, expected.factors.optimum, "optimum")
    assert_close(factors.rows[:, :m], expected.factors.rows, "rows")
    assert_close(factors.row_norms[:, :m], expected.factors.row_norms, "row norms")


def assert_close(value, expected, name):
    close = {"rtol": SAME_WINDOWS, "atol": SAME_WINDOWS}
    np.testing.assert_allclose(value, expected, **close, err_msg=name)


def with_spare_rows(window, like):
    """Repeat the last row of a design's QPs, without bounds, up to the shape of others: one program
    drives both."""

    def pad(mine, other, **how):
        missing = [(0, b - a) for a, b in zip(mine.shape, other.shape, strict=True)]
        return np.pad(mine, missing, **how)

    lower = pad(window.lower, like.lower, constant_values=-np.inf)
    upper = pad(window.upper, like.upper, constant_values=np.inf)
    repeated = jax.tree.map(lambda *pair: pad(*pair, mode="edge"), window, like)
    return repeated._replace(lower=lower, upper=upper)


@pytest.mark.slow
def test_laps_are_those_of_the_design_rows_active_or_not(loop):
    design, constants, windows = loop
    settings = design.problem.scenario.controller
    first = int(design.windows.index[0])
    edge = boundary(design.tube_qps, first, design.problem.operating_set, LAPS - 2, seed=1)
    outside = 1.5 * edge[:1]
    starts = jnp.asarray(np.vstack([design.problem.initial_error, 0.99 * edge, outside]))
    plant = tuned.shortened(components.slipping_robot(design), STEPS)
    keys = realisation_keys(0, 0, LAPS)

    def run(windows):
        windows = jax.device_put(windows)
        index = jnp.asarray(constants.index)
        controller = TubeMpc(windows, index, make_wheel_map(design.problem), settings.restart)
        return drive(controller, plant, keys, starts)

    laps = run(windows)
    expected = run(with_spare_rows(design.tube_qps, windows))
    active = laps.diagnostics.active
    status = laps.diagnostics.status
    assert active.any(axis=0).sum() >= 2 and (~active).any() and (status[0, -1] != qp.SOLVED)
    np.testing.assert_array_equal(active, expected.diagnostics.active)
    np.testing.assert_array_equal(status, expected.diagnostics.status)
    for name in ("errors", "inputs", "demanded"):
        value = getattr(laps, name)
        wanted = getattr(expected, name)
        np.testing.assert_allclose(value, wanted, rtol=0, atol=SAME_LAPS, err_msg=name)


def test_a_tube_that_outgrows_its_limits_leaves_some_room(loop):
    design, constants, _ = loop
    kappa = 40.0 * jnp.asarray(design.problem.given_gains)
    bounds = tightened_bounds(constants, kappa)
    limits = ((bounds.errors, constants.error_offsets), (bounds.inputs, constants.limits.offsets))
    for left, offsets in limits:
        assert (left >= ROOM * offsets * (1 - SAME_WINDOWS)).all() and (left <= offsets).all()
    assert (bounds.errors <= ROOM * constants.error_offsets * (1 + SAME_WINDOWS)).any()
    assert (bounds.terminal > 0).all()


@pytest.fixture(scope="module", params=list(tuned.SCENARIOS))
def problem(request):
    return tuned.problem_of(request.param)


def test_the_start_is_the_scenarios_own_weights_and_gains(problem):
    parameters = make_parameters(problem)
    scenario = parameters.scenario(problem.scenario, parameters.vector)
    controller = scenario.controller
    again = with_controller(problem, scenario)
    close = {"rtol": SAME_WEIGHTS, "atol": 0}
    np.testing.assert_allclose(again.error_weight, problem.error_weight, **close)
    np.testing.assert_allclose(again.input_weight, problem.input_weight, **close)
    np.testing.assert_allclose(again.given_gains, problem.given_gains, **close)
    assert bool(controller.tracking_gains) != bool(controller.vertex_gains)


@pytest.mark.parametrize("seed", range(5))
def test_the_scenario_of_a_vector_holds_its_weights_which_are_positive_definite(problem, seed):
    parameters = make_parameters(problem)
    vector = tuned.random_point(problem, np.random.default_rng(seed), weights=2.0, gains=1.0)
    weights = parameters.weights(jnp.asarray(vector))
    for weight in weights[:2]:
        np.testing.assert_array_equal(weight, weight.T)
        assert np.linalg.eigvalsh(weight).min() > 0
    again = with_controller(problem, parameters.scenario(problem.scenario, vector))
    read = Weights(again.error_weight, again.input_weight, again.given_gains)
    jax.tree.map(np.testing.assert_array_equal, read, weights)
    if len(vector) == 12:
        assert (weights.kappa > 0).all()
    # And back again: the vector is the only one with these weights.
    inverse = make_parameters(again)
    kappa = inverse.weights(inverse.vector).kappa
    np.testing.assert_allclose(kappa, weights.kappa, rtol=1e-13)
    least = [np.linalg.eigvalsh(weight)[0] / np.abs(weight).max() for weight in weights[:2]]
    if min(least) > LEAST_PIVOT:  # a weight closer to a singular one is raised
        np.testing.assert_allclose(inverse.vector[:9], vector[:9], rtol=0, atol=SAME_VECTOR)


def test_only_what_is_tuned_moves(problem):
    everything = make_parameters(problem)
    count = len(problem.given_gains)
    assert len(everything.names) == len(set(everything.names)) == 9 + count
    moved = {
        "both": everything.names,
        "weights": everything.names[:9],
        "gains": everything.names[9:],
        "diagonal": ("Q11", "Q22", "Q33", "R11", "R22"),
    }
    start = everything.weights(jnp.asarray(everything.vector))
    for variables, names in moved.items():
        parameters = make_parameters(problem, variables)
        assert parameters.free_names == tuple(names) and len(parameters.vector) == len(names)
        weights = parameters.weights(jnp.asarray(parameters.vector + 0.1))
        changed = [not np.array_equal(new, old) for new, old in zip(weights, start, strict=True)]
        moves_weights = variables != "gains"
        moves_gains = variables in ("both", "gains")
        assert changed == [moves_weights, moves_weights, moves_gains]


def test_what_cannot_be_tuned_is_refused(problem):
    with pytest.raises(
        ValueError, match="'all' is unknown; choose one of both, weights, gains, diagonal"
    ):
        make_parameters(problem, "all")
    settings = replace(problem.scenario.controller, tracking_gains=(), vertex_gains=())
    scenario = replace(problem.scenario, controller=settings)
    with pytest.raises(ValueError, match="no gains to tune"):
        make_parameters(with_controller(problem, scenario))
