"""Laws of the differentiable margins: values and derivatives are those of the sets that a design
computes."""

import itertools
from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tuned
from tolerances import TUBE_BOUND, TUBE_REACH, TUBE_RESIDUAL, TUBE_SLOPE, TUBE_TIGHT

import sets.invariant
from jaxtube.synthesis.certificate import fill
from jaxtube.synthesis.disturbance import kinematics, operation
from jaxtube.synthesis.estimate import Caps, Estimate
from jaxtube.synthesis.gains import given_gain
from jaxtube.synthesis.tightening import tighten
from jaxtube.synthesis.tubes import make_tubes
from jaxtube.synthesis.windows import make_windows
from jaxtube.tuning import minimal, residual, tube
from jaxtube.tuning.gains import Affine, gain_maps
from sets.robot.plant import split_residual

SEEDS = (0, 1, 2)


@pytest.fixture(scope="module")
def decoupled():
    """Three decoupled gains, a computed W: a yaw kick and a box."""
    return tuned.problem_of("decoupled")


@pytest.fixture(scope="module")
def vertices():
    """Four free vertex gains, W a box."""
    return tuned.problem_of("vertices")


@pytest.fixture(scope="module", params=list(tuned.SCENARIOS))
def problem(request):
    return request.getfixturevalue(request.param)


def drawn(problem, seed):
    """Draw stable gains, as the numbers that are tuned, and a direction in them."""
    rng = np.random.default_rng(seed)
    if problem.disturbance_bound is not None:
        centre = np.array([9.0, 8.0, 8.0])
    else:
        centre = np.tile([[-2.5, 0.0, 0.0], [0.0, -2.6, -3.0]], (4, 1, 1))
        centre[:, 0, 1] = -problem.model.matrices(problem.corners)[0][:, 0, 1] / problem.model.dt
    size = 0.05 * np.abs(centre).max(axis=-1, keepdims=True)
    numbers, direction = (
        centre + size * rng.uniform(-1, 1, centre.shape),
        size * rng.uniform(-1, 1, centre.shape),
    )
    return numbers.ravel(), direction.ravel()


def quick_for(kind):
    """Leave the other problem to the slow tests."""
    cases = [
        each if each == kind else pytest.param(each, marks=pytest.mark.slow)
        for each in tuned.SCENARIOS
    ]
    return pytest.mark.parametrize("problem", cases, indirect=True)


@cache
def maps_of(problem):
    """Give all gains and loops of a problem as functions of the tuned numbers."""
    return gain_maps(
        problem, make_windows(problem, given_gain(problem, problem.given_gains)).schedules
    )


def distinct(matrices: Affine):
    """Leave out those matrices that are others for all numbers."""
    everything = np.concatenate([matrices.constant[None], matrices.slopes]).swapaxes(0, 1)
    first = np.unique(everything.reshape(len(everything), -1), axis=0, return_index=True)[1]
    return Affine(matrices.constant[first], matrices.slopes[:, first])


def loops_and_gains(problem, numbers):
    """Give vertex loops and gains as functions of the tuned numbers."""
    maps = maps_of(problem)
    return distinct(maps.vertex_loops).at(jnp.asarray(numbers)), maps.corner_gains.at(
        jnp.asarray(numbers)
    )


def under(problem, gains):
    rows = problem.input_rows
    return tube.rows_under(jnp.asarray(rows.inputs), jnp.asarray(rows.errors), gains)


def reaches(problem, numbers, kind):
    """Give what the tube takes from E and U at every stage: the differentiable `tighten`."""
    W, rows = (
        jnp.asarray(tube.disturbance_generators(problem)),
        jnp.asarray(problem.operating_set.normals),
    )
    N = problem.horizon
    if kind == "summed":
        loops, gains = loops_and_gains(problem, numbers)
        errors = tube.summed_reach(loops, W, rows, N)
        return errors, tube.summed_input_reach(loops, W, under(problem, gains), N)[:N]
    maps = maps_of(problem)
    loops, gains = maps.window_loops.at(numbers), maps.window_gains.at(numbers)
    along = jnp.broadcast_to(rows, (len(loops), N + 1, *rows.shape))
    return tube.sequence_reaches(loops, W, along), tube.sequence_reaches(
        loops, W, under(problem, gains)
    )


def tightened(problem, numbers, kind):
    """Give the same from `tighten` itself, stages of the shared sections once."""
    gain = given_gain(problem, numbers)
    windows = make_windows(problem, gain)
    tubes = make_tubes(problem, gain, windows)
    found = tighten(problem, tubes[kind], len(windows.schedules))
    arrays = found.error_reach, found.input_reach
    return arrays if kind == "sequence" else tuple(array[0] for array in arrays)


def central(function, at, direction, step=1e-4):
    return (function(at + step * direction) - function(at - step * direction)) / (2 * step)


def assert_slope_agrees(gradient, function, at, direction):
    size = np.linalg.norm(gradient) * np.linalg.norm(direction)
    assert np.vdot(gradient, direction) == pytest.approx(
        central(function, at, direction), rel=0, abs=TUBE_SLOPE * size
    )


def test_generators_have_the_support_numbers_of_w(problem):
    rows = np.random.default_rng(0).normal(size=(50, 3))
    found = tube.support(jnp.asarray(tube.disturbance_generators(problem)), jnp.asarray(rows))
    np.testing.assert_allclose(found, problem.disturbance_set.support(rows), rtol=TUBE_REACH)


@pytest.mark.parametrize(
    ("problem", "kind"),
    [
        ("decoupled", "sequence"),
        ("vertices", "summed"),
        pytest.param("decoupled", "summed", marks=pytest.mark.slow),
        pytest.param("vertices", "sequence", marks=pytest.mark.slow),
    ],
    indirect=["problem"],
)
def test_reaches_and_their_slopes_are_those_of_the_tightening(problem, kind):
    rng = np.random.default_rng(9)
    weights = [
        rng.uniform(0.5, 1.5, array.shape)
        for array in tightened(problem, drawn(problem, 0)[0], kind)
    ]

    def weighted(arrays):
        return sum((weight * array).sum() for weight, array in zip(weights, arrays, strict=True))

    def objective(numbers):
        arrays = reaches(problem, numbers, kind)
        return weighted(arrays), arrays

    evaluate = jax.jit(jax.grad(objective, has_aux=True))
    for seed in SEEDS:
        numbers, direction = drawn(problem, seed)
        gradient, arrays = evaluate(jnp.asarray(numbers))
        for found, wanted in zip(arrays, tightened(problem, numbers, kind), strict=True):
            np.testing.assert_allclose(found, wanted, rtol=TUBE_REACH)
        assert_slope_agrees(
            gradient, lambda at: weighted(tightened(problem, at, kind)), numbers, direction
        )


def test_the_empty_sum_reaches_nothing_and_one_step_reaches_w(problem):
    loops, _ = loops_and_gains(problem, drawn(problem, 0)[0])
    W, rows = jnp.asarray(tube.disturbance_generators(problem)), jnp.asarray(np.eye(3))
    first, second, _ = jax.jit(tube.summed_reach, static_argnums=3)(loops, W, rows, 2)
    assert not first.any()
    np.testing.assert_allclose(second, tube.support(W, rows), rtol=TUBE_REACH)


def shares_of(problem):
    """Give the differentiable shares of caps, and what finds their active facets."""
    W, limits = jnp.asarray(tube.disturbance_generators(problem)), minimal.limits(problem)

    def find(numbers):
        loops, gains = loops_and_gains(problem, numbers)
        return minimal.active_caps(limits, loops, W, gains)

    def shares(active, numbers):
        loops, gains = loops_and_gains(problem, numbers)
        return minimal.cap_shares(active, limits, loops, W, gains)

    return find, shares


def shares_of_design(problem, numbers):
    return np.array(list(fill.cap_shares(problem, given_gain(problem, numbers)).values()))


@quick_for("decoupled")
def test_shares_of_caps_and_their_slopes_are_those_of_the_design(problem, monkeypatch):
    find, shares = shares_of(problem)
    points = [drawn(problem, seed) for seed in SEEDS]
    evaluate = jax.jit(
        jax.jacrev(lambda active, numbers: (shares(active, numbers),) * 2, argnums=1, has_aux=True)
    )
    slopes = []
    for numbers, direction in points:
        jacobian, found = evaluate(find(numbers), jnp.asarray(numbers))
        np.testing.assert_allclose(found, shares_of_design(problem, numbers), rtol=TUBE_BOUND)
        slopes.append(np.tensordot(jacobian, direction, axes=direction.ndim))
    # The iteration stops at a change of a thousandth of the inflation: a smaller one makes
    # differences exact enough.
    inflation, fine = sets.invariant.INFLATION, 1e-9
    monkeypatch.setattr(sets.invariant, "INFLATION", fine)
    for slope, (numbers, direction) in zip(slopes, points, strict=True):
        expected = (
            central(lambda at: shares_of_design(problem, at), numbers, direction)
            * (1 + inflation)
            / (1 + fine)
        )
        np.testing.assert_allclose(
            slope, expected, rtol=0, atol=TUBE_SLOPE * np.abs(expected).max()
        )


@quick_for("vertices")
def test_offsets_are_a_fixed_point_that_holds_the_reach_along_any_direction(problem):
    numbers, _ = drawn(problem, 4)
    loops, gains = loops_and_gains(problem, numbers)
    W = jnp.asarray(tube.disturbance_generators(problem))
    normals = jax.jit(minimal.cap_normals)(minimal.limits(problem), gains)
    directions = np.random.default_rng(4).normal(size=(20, 3))
    active = minimal.active_facets(loops, W, normals, directions)
    assert active is not None
    offsets = jax.jit(minimal.minimal_offsets)(active, loops, W, normals)
    bound = sets.invariant.Polytope(np.asarray(normals), np.asarray(offsets))
    steps = (1 + sets.invariant.INFLATION) * tube.support(W, normals)
    reach = np.max([bound.support(np.asarray(normals @ loop)) for loop in loops], axis=0) + steps
    np.testing.assert_allclose(reach, offsets, rtol=TUBE_TIGHT)
    found = jax.jit(minimal.minimal_reach)(active, loops, W, normals, jnp.asarray(directions))
    np.testing.assert_allclose(found, bound.support(directions), rtol=TUBE_TIGHT)


def test_a_wider_w_widens_the_bound_as_its_slope_says(decoupled):
    loops, gains = loops_and_gains(decoupled, drawn(decoupled, 0)[0])
    W, limits = jnp.asarray(tube.disturbance_generators(decoupled)), minimal.limits(decoupled)
    active = minimal.active_caps(limits, loops, W, gains)
    assert active is not None
    shares = jax.jit(lambda W: minimal.cap_shares(active, limits, loops, W, gains))
    shares, slope = jax.jvp(shares, (W,), (W,))
    np.testing.assert_allclose(slope, shares, rtol=TUBE_TIGHT)


def test_unstable_loops_have_no_bound(problem):
    find, _ = shares_of(problem)
    assert find(-drawn(problem, 0)[0]) is None


def numbers_of(caps):
    return np.array([*caps.errors, *caps.speeds, caps.turning, *caps.coupling])


def caps_of(numbers):
    return residual.Caps(numbers[:3], numbers[3:5], numbers[5], numbers[6:8])


def test_the_residual_and_its_slopes_are_those_at_corners_of_the_operating_set(decoupled):
    search, corners = Estimate(decoupled), residual.corners(decoupled)
    weights = np.array([[0.0, 1.0, 2.0], [3.0, 0.0, 0.0], [0.0, 5.0, 0.0], [0.0, 0.0, 7.0]])

    def expected(numbers):
        yaw, box, _ = search.disturbance(Caps(*numbers))
        return np.vstack([yaw * np.array([0.0, search.period.lateral_per_yaw, 1.0]), np.diag(box)])

    def weighted(numbers):
        generators = residual.residual_generators(corners, caps_of(numbers))
        return (weights * generators).sum(), generators

    evaluate = jax.jit(jax.grad(weighted, has_aux=True))
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        own = numbers_of(residual.caps(decoupled))
        numbers, direction = own * rng.uniform(0.8, 1.1, 8), 0.05 * own * rng.uniform(-1, 1, 8)
        slope, generators = evaluate(jnp.asarray(numbers))
        np.testing.assert_allclose(generators, expected(numbers), rtol=0, atol=TUBE_RESIDUAL)
        assert_slope_agrees(slope, lambda at: (weights * expected(at)).sum(), numbers, direction)


@quick_for("decoupled")
def test_the_residual_of_every_input_map_is_the_plants_where_nothing_couples(problem):
    corners, caps = residual.corners(problem), replace(residual.caps(problem), coupling=None)
    (x, y, heading), (slower, faster), turning = caps.errors, caps.speeds, caps.turning
    schedules, noise = np.unique(problem.corners, axis=0), np.asarray(corners.noise)
    axes = (
        [-x, x],
        [-y, y],
        np.linspace(-heading, heading, residual.HEADINGS),
        [-slower, faster],
        [-turning, turning],
    )
    slips = ([-error, error] for error in corners.wheel_error)
    points = np.array(
        [np.hstack(p) for p in itertools.product(*axes, schedules, *slips, [-noise, noise])]
    ).T
    parts = split_residual(kinematics(problem), operation(problem).period, points)
    kick, rest = jax.jit(residual.residual_bound)(corners, caps)
    assert np.abs(parts.yaw).max() == pytest.approx(float(kick), abs=TUBE_RESIDUAL)
    np.testing.assert_allclose(
        rest, [np.abs(each).max() for each in parts.rest], rtol=0, atol=TUBE_RESIDUAL
    )


def test_caps_of_inputs_are_what_the_gain_asks_for_at_corners_of_the_errors(problem):
    gains, widths = loops_and_gains(problem, drawn(problem, 5)[0])[1], np.array([0.1, 0.2, 0.3])
    errors = widths * np.array(list(itertools.product((-1, 1), repeat=3)))
    expected = np.max([np.asarray(gain) @ errors.T for gain in gains], axis=(0, 2))
    np.testing.assert_allclose(
        residual.input_caps(gains, jnp.asarray(widths)), expected, rtol=TUBE_REACH
    )


def test_single_precision_stays_single(decoupled):
    find, _ = shares_of(decoupled)
    numbers = drawn(decoupled, 0)[0]
    single = lambda tree: jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), tree)  # noqa: E731
    W, limits, rows = single(
        (tube.disturbance_generators(decoupled), minimal.limits(decoupled), np.eye(3))
    )
    loops, gains = single(loops_and_gains(decoupled, numbers))
    corners, caps = single((residual.corners(decoupled), residual.caps(decoupled)))
    shapes = (
        jax.eval_shape(lambda: tube.summed_reach(loops, W, rows, 3)),
        jax.eval_shape(lambda: tube.sequence_reach(loops[None], W, rows[None], 3)),
        jax.eval_shape(minimal.cap_shares, find(numbers), limits, loops, W, gains),
        jax.eval_shape(residual.residual_generators, corners, caps),
        jax.eval_shape(single(maps_of(decoupled)).vertex_loops.at, single(numbers)),
    )
    assert {leaf.dtype for leaf in jax.tree.leaves(shapes)} == {jnp.dtype("float32")}
