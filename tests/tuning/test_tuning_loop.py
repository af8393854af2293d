"""Laws of the differentiable closed loop: it is the design's own. Laws of the vector of its weights
and gains."""

from operator import itemgetter

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tolerances as tol
import tuned
from msgspec.structs import replace

from jaxtube import qp
from jaxtube.control.laws import TubeMpc
from jaxtube.simulation import closed_loop
from jaxtube.simulation.closed_loop import make_wheel_map
from jaxtube.simulation.rollout import realisation_keys, rollout
from jaxtube.synthesis.design import finish, prepare
from jaxtube.synthesis.feasible import boundary
from jaxtube.synthesis.problem import with_controller
from jaxtube.tuning.loop import ROOM, Weights, fix, tightened, windows_of
from jaxtube.tuning.parameters import LEAST_PIVOT, parameters

LAPS, STEPS = 16, 30
PARTS = "errors", "inputs", "terminal"

condensed = jax.jit(windows_of)
drive = jax.jit(rollout.__wrapped__)


@pytest.fixture(
    scope="module", params=["decoupled", pytest.param("vertices", marks=pytest.mark.slow)]
)
def loop(request):
    """A design at a random point, and the windows that tuning gives it."""
    problem = tuned.problem_of(request.param)
    chosen = parameters(problem)
    point = tuned.random_point(problem, np.random.default_rng(3))
    design = finish(prepare(with_controller(problem, chosen.scenario(problem.scenario, point))))
    fixed = fix(design)
    return design, fixed, condensed(fixed, chosen.weights(jnp.asarray(point)))


def test_windows_are_those_of_the_design(loop):
    design, _, found = loop
    expected = design.tube_window
    m = expected.lower.shape[1]
    assert (
        np.isinf(found.lower[:, m:]).all() and np.isinf(found.upper[:, m:]).all()
    )  # spare rows bound nothing
    close = {"rtol": tol.SAME_WINDOWS, "atol": tol.SAME_WINDOWS}
    for name in ("lower", "upper", "row_errors", "free_rows"):
        np.testing.assert_allclose(
            getattr(found, name)[:, :m], getattr(expected, name), **close, err_msg=name
        )
    cut = {"rows", "row_norms", "optimum_rows", "pair_products"}
    for name in set(expected._fields) - {"lower", "upper", "row_errors", "free_rows", "factors"}:
        np.testing.assert_allclose(
            getattr(found, name), getattr(expected, name), **close, err_msg=name
        )
    for name in ("hessian", "rows", "row_norms", "optimum"):
        mine = getattr(found.factors, name)
        mine = mine[:, :m] if name in cut else mine
        np.testing.assert_allclose(mine, getattr(expected.factors, name), **close, err_msg=name)


def with_spare_rows(window, like):
    """Repeat the last row of a design's QPs, without bounds, up to the shape of others: one program
    drives both."""

    def padded(mine, other, **how):
        return np.pad(
            mine, [(0, b - a) for a, b in zip(mine.shape, other.shape, strict=True)], **how
        )

    bounds = {
        name: padded(getattr(window, name), getattr(like, name), constant_values=value)
        for name, value in (("lower", -np.inf), ("upper", np.inf))
    }
    return jax.tree.map(lambda *pair: padded(*pair, mode="edge"), window, like)._replace(**bounds)


@pytest.mark.slow
def test_laps_are_those_of_the_design_rows_active_or_not(loop):
    design, fixed, windows = loop
    settings = design.problem.scenario.controller
    edge = boundary(
        design.tube_window,
        int(design.windows.index[0]),
        design.problem.operating_set,
        LAPS - 2,
        seed=1,
    )
    outside = 1.5 * edge[:1]
    starts = jnp.asarray(np.vstack([design.problem.initial_error, 0.99 * edge, outside]))
    plant, keys = (
        tuned.shortened(closed_loop.slipping_robot(design), STEPS),
        realisation_keys(0, 0, LAPS),
    )
    loops = (
        TubeMpc(
            jax.tree.map(jnp.asarray, each),
            jnp.asarray(fixed.index),
            make_wheel_map(design.problem),
            settings.restart,
        )
        for each in (windows, with_spare_rows(design.tube_window, windows))
    )
    found, expected = (drive(each, plant, keys, starts) for each in loops)
    active, status = found.diagnostics.active, found.diagnostics.status
    assert active.any(axis=0).sum() >= 2 and (~active).any() and (status[0, -1] != qp.SOLVED)
    np.testing.assert_array_equal(active, expected.diagnostics.active)
    np.testing.assert_array_equal(status, expected.diagnostics.status)
    for name in ("errors", "inputs", "demanded"):
        np.testing.assert_allclose(
            getattr(found, name), getattr(expected, name), rtol=0, atol=tol.SAME_LAPS, err_msg=name
        )


def test_a_tube_that_outgrows_its_limits_leaves_some_room(loop):
    design, fixed, _ = loop
    kappa = 3.0 * jnp.asarray(design.problem.given_gains)
    errors, inputs, terminal = jax.jit(lambda *of: itemgetter(*PARTS)(vars(tightened(*of))))(
        fixed, kappa
    )
    for left, offsets in ((errors, fixed.error_offsets), (inputs, fixed.input_offsets)):
        assert (left >= ROOM * offsets * (1 - tol.SAME_WINDOWS)).all() and (left <= offsets).all()
    assert (errors <= ROOM * fixed.error_offsets * (1 + tol.SAME_WINDOWS)).any()
    assert (terminal > 0).all()


@pytest.fixture(scope="module", params=list(tuned.SCENARIOS))
def problem(request):
    return tuned.problem_of(request.param)


def test_the_start_is_the_scenarios_own_weights_and_gains(problem):
    chosen = parameters(problem)
    controller = chosen.scenario(problem.scenario, chosen.vector).controller
    again = with_controller(problem, chosen.scenario(problem.scenario, chosen.vector))
    np.testing.assert_allclose(
        again.error_weight, problem.error_weight, rtol=tol.SAME_WEIGHTS, atol=0
    )
    np.testing.assert_allclose(
        again.input_weight, problem.input_weight, rtol=tol.SAME_WEIGHTS, atol=0
    )
    np.testing.assert_allclose(again.given_gains, problem.given_gains, rtol=tol.SAME_WEIGHTS)
    assert bool(controller.tracking_gains) != bool(controller.vertex_gains)


@pytest.mark.parametrize("seed", range(5))
def test_the_scenario_of_a_vector_holds_its_weights_which_are_positive_definite(problem, seed):
    chosen = parameters(problem)
    vector = tuned.random_point(problem, np.random.default_rng(seed), weights=2.0, gains=1.0)
    weights = chosen.weights(jnp.asarray(vector))
    for weight in weights[:2]:
        np.testing.assert_array_equal(weight, weight.T)
        assert np.linalg.eigvalsh(weight).min() > 0
    again = with_controller(problem, chosen.scenario(problem.scenario, vector))
    found = Weights(again.error_weight, again.input_weight, again.given_gains)
    jax.tree.map(np.testing.assert_array_equal, found, weights)
    if len(vector) == 12:
        assert (weights.kappa > 0).all()
    # And back again: the vector is the only one with these weights.
    np.testing.assert_allclose(
        parameters(again).weights(parameters(again).vector).kappa, weights.kappa, rtol=1e-13
    )
    least = [np.linalg.eigvalsh(weight)[0] / np.abs(weight).max() for weight in weights[:2]]
    if min(least) > LEAST_PIVOT:  # a weight closer to a singular one is raised
        np.testing.assert_allclose(
            parameters(again).vector[:9], vector[:9], rtol=0, atol=tol.SAME_VECTOR
        )


def test_only_what_is_tuned_moves(problem):
    everything = parameters(problem)
    count = len(problem.given_gains)
    assert len(everything.names) == len(set(everything.names)) == 9 + count
    moved = {
        "both": everything.names,
        "weights": everything.names[:9],
        "gains": everything.names[9:],
        "diagonal": ("Q11", "Q22", "Q33", "R11", "R22"),
    }
    for tuned_part, names in moved.items():
        chosen = parameters(problem, tuned_part)
        assert chosen.free_names == tuple(names) and len(chosen.vector) == len(names)
        weights = chosen.weights(jnp.asarray(chosen.vector + 0.1))
        start = everything.weights(jnp.asarray(everything.vector))
        changed = [not np.array_equal(new, old) for new, old in zip(weights, start, strict=True)]
        assert changed == [
            tuned_part != "gains",
            tuned_part != "gains",
            tuned_part in ("both", "gains"),
        ]


def test_what_cannot_be_tuned_is_refused(problem):
    with pytest.raises(
        ValueError, match="'all' is unknown; choose one of both, weights, gains, diagonal"
    ):
        parameters(problem, "all")
    settings = replace(problem.scenario.controller, tracking_gains=(), vertex_gains=())
    scenario = replace(problem.scenario, controller=settings)
    with pytest.raises(ValueError, match="no gains to tune"):
        parameters(with_controller(problem, scenario))
