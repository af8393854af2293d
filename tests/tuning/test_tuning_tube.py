"""Laws of the differentiable margins: values and derivatives are those of the sets that a design
computes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tuned

import sets.invariant
from jaxtube.synthesis.certificate import fill
from jaxtube.synthesis.gains import given_gain
from jaxtube.synthesis.tightening import tighten
from jaxtube.synthesis.tubes import make_following_tube
from jaxtube.synthesis.windows import make_windows
from jaxtube.tuning import caps, minimal, tube
from jaxtube.tuning.gains import Affine

TUBE_REACH = 1e-9
"""Relative; sums of support numbers against vertices, of which those closer than 1e-10 are one."""
TUBE_BOUND = 1e-7
"""Relative; where the iteration for the minimal set stops, tenfold."""
TUBE_TIGHT = 1e-9
"""Relative; the fixed point itself, active facets found where that iteration stopped."""
TUBE_SLOPE = 1e-6
"""Relative to the gradient; central differences with steps of 1e-4 of a twentieth of the gains."""

SEEDS = (0, 1, 2)


@pytest.fixture(scope="module")
def decoupled():
    """Three decoupled gains, a computed W: a yaw kick and a box."""
    return tuned.problem_of("decoupled")


@pytest.fixture(scope="module", params=list(tuned.SCENARIOS))
def problem(request):
    return tuned.problem_of(request.param)


def draw(problem, seed):
    """Draw stable gains, as the numbers that are tuned, and a direction in them."""
    rng = np.random.default_rng(seed)
    if problem.disturbance_bound is not None:
        centre = np.array([9.0, 8.0, 8.0])
    else:
        centre = np.tile([[-2.5, 0.0, 0.0], [0.0, -2.6, -3.0]], (4, 1, 1))
        transitions, _ = problem.model.matrices(problem.corners)
        centre[:, 0, 1] = -transitions[:, 0, 1] / problem.model.dt
    size = 0.05 * np.abs(centre).max(axis=-1, keepdims=True)
    numbers = centre + size * rng.uniform(-1, 1, centre.shape)
    direction = size * rng.uniform(-1, 1, centre.shape)
    return numbers.ravel(), direction.ravel()


def quick_for(kind):
    """Leave the other problem to the slow tests."""
    cases = [
        each if each == kind else pytest.param(each, marks=pytest.mark.slow)
        for each in tuned.SCENARIOS
    ]
    return pytest.mark.parametrize("problem", cases, indirect=True)


def distinct(matrices: Affine) -> Affine:
    """Leave out those matrices that equal others for all numbers."""
    everything = np.concatenate([matrices.constant[None], matrices.slopes]).swapaxes(0, 1)
    rows = everything.reshape(len(everything), -1)
    first = np.unique(rows, axis=0, return_index=True)[1]
    return Affine(matrices.constant[first], matrices.slopes[:, first])


def loops_and_gains(problem, numbers):
    """Return distinct vertex loops, and the gains at the corners."""
    maps = tuned.gain_maps_of(problem)
    kappa = jnp.asarray(numbers)
    return distinct(maps.vertex_loops).at(kappa), maps.corner_gains.at(kappa)


def generators_of(problem):
    return jnp.asarray(tube.disturbance_generators(problem))


def reaches(problem, numbers):
    """Return what the tube takes from E and U at every stage: the differentiable `tighten`."""
    maps = tuned.gain_maps_of(problem)
    W = generators_of(problem)
    loops = maps.window_loops.at(numbers)
    gains = maps.window_gains.at(numbers)
    error_rows = jnp.asarray(problem.operating_set.normals)
    along = jnp.broadcast_to(error_rows, (len(loops), problem.horizon + 1, *error_rows.shape))
    inputs = jnp.asarray(problem.input_rows.inputs)
    errors = jnp.asarray(problem.input_rows.errors)
    input_rows = tube.closed_loop_rows(inputs, errors, gains)
    of_errors = tube.sequence_reaches(loops, W, along)
    of_inputs = tube.sequence_reaches(loops, W, input_rows)
    return of_errors, of_inputs


def tighten_again(problem, numbers):
    """Return the same from `tighten` itself."""
    gain = given_gain(problem, numbers)
    windows = make_windows(problem, gain)
    tube = make_following_tube(problem, gain, windows)
    tightening = tighten(problem, tube, windows)
    return tightening.error_reach, tightening.input_reach


def central(function, at, direction, step=1e-4):
    return (function(at + step * direction) - function(at - step * direction)) / (2 * step)


def test_generators_have_the_support_numbers_of_w(problem):
    rows = np.random.default_rng(0).normal(size=(50, 3))
    numbers = tube.support(generators_of(problem), jnp.asarray(rows))
    np.testing.assert_allclose(numbers, problem.disturbance_set.support(rows), rtol=TUBE_REACH)


@quick_for("decoupled")
def test_reaches_and_their_slopes_are_those_of_the_tightening(problem):
    rng = np.random.default_rng(9)
    first, _ = draw(problem, 0)
    weights = [rng.uniform(0.5, 1.5, array.shape) for array in tighten_again(problem, first)]

    def weigh(arrays):
        return sum((weight * array).sum() for weight, array in zip(weights, arrays, strict=True))

    def objective(numbers):
        arrays = reaches(problem, numbers)
        return weigh(arrays), arrays

    evaluate = jax.jit(jax.grad(objective, has_aux=True))
    for seed in SEEDS:
        numbers, direction = draw(problem, seed)
        gradient, arrays = evaluate(jnp.asarray(numbers))
        expected = tighten_again(problem, numbers)
        for array, wanted in zip(arrays, expected, strict=True):
            np.testing.assert_allclose(array, wanted, rtol=TUBE_REACH)
        slope = central(lambda at: weigh(tighten_again(problem, at)), numbers, direction)
        size = np.linalg.norm(gradient) * np.linalg.norm(direction)
        assert np.vdot(gradient, direction) == pytest.approx(slope, rel=0, abs=TUBE_SLOPE * size)


def test_the_empty_sum_reaches_nothing_and_one_step_reaches_w(decoupled):
    numbers, _ = draw(decoupled, 0)
    loops = tuned.gain_maps_of(decoupled).window_loops.at(jnp.asarray(numbers))[:1]
    W = generators_of(decoupled)
    rows = jnp.asarray(np.eye(3))[None]
    assert not tube.reach_along(loops, W, rows, 0).any()
    np.testing.assert_allclose(
        tube.reach_along(loops, W, rows, 1), tube.support(W, rows), rtol=TUBE_REACH
    )


def find_active(problem, numbers):
    """Find the active facets of the shares of caps."""
    loops, gains = loops_and_gains(problem, numbers)
    return caps.find_active_caps(caps.make_limits(problem), loops, generators_of(problem), gains)


def shares_at(problem, active, numbers):
    """Return the differentiable shares of caps."""
    loops, gains = loops_and_gains(problem, numbers)
    limits = caps.make_limits(problem)
    return caps.shares_of_caps(active, limits, loops, generators_of(problem), gains)


def shares_of_design(problem, numbers):
    return np.array(list(fill.cap_shares(problem, given_gain(problem, numbers)).values()))


@quick_for("decoupled")
def test_shares_of_caps_and_their_slopes_are_those_of_the_design(problem, monkeypatch):
    @jax.jit
    def shares_and_slope(active, numbers, direction):
        return jax.jvp(lambda at: shares_at(problem, active, at), (numbers,), (direction,))

    points = [draw(problem, seed) for seed in SEEDS]
    slopes = []
    for numbers, direction in points:
        active = find_active(problem, numbers)
        at = jnp.asarray(numbers)
        shares, slope = shares_and_slope(active, at, jnp.asarray(direction))
        np.testing.assert_allclose(shares, shares_of_design(problem, numbers), rtol=TUBE_BOUND)
        slopes.append(slope)
    # The iteration stops at a change of a thousandth of the inflation: a smaller one makes
    # differences exact enough.
    inflation = sets.invariant.INFLATION
    fine = 1e-9
    monkeypatch.setattr(sets.invariant, "INFLATION", fine)
    for slope, (numbers, direction) in zip(slopes, points, strict=True):
        finer = central(lambda at: shares_of_design(problem, at), numbers, direction)
        expected = finer * (1 + inflation) / (1 + fine)
        largest = np.abs(expected).max()
        np.testing.assert_allclose(slope, expected, rtol=0, atol=TUBE_SLOPE * largest)


@quick_for("vertices")
def test_offsets_are_a_fixed_point_that_holds_the_reach_along_any_direction(problem):
    numbers, _ = draw(problem, 4)
    loops, gains = loops_and_gains(problem, numbers)
    W = generators_of(problem)
    normals = jax.jit(caps.cap_normals)(caps.make_limits(problem), gains)
    directions = np.random.default_rng(4).normal(size=(20, 3))
    active = minimal.find_active_facets(loops, W, normals, directions)
    assert active is not None
    offsets = jax.jit(minimal.minimal_offsets)(active, loops, W, normals)
    bound = sets.invariant.Polytope(np.asarray(normals), np.asarray(offsets))
    steps = (1 + sets.invariant.INFLATION) * tube.support(W, normals)
    images = [bound.support(np.asarray(normals @ loop)) for loop in loops]
    np.testing.assert_allclose(np.max(images, axis=0) + steps, offsets, rtol=TUBE_TIGHT)
    reach = jax.jit(minimal.minimal_reach)(active, loops, W, normals, jnp.asarray(directions))
    np.testing.assert_allclose(reach, bound.support(directions), rtol=TUBE_TIGHT)


def test_a_wider_w_widens_the_bound_as_its_slope_says(decoupled):
    numbers, _ = draw(decoupled, 0)
    loops, gains = loops_and_gains(decoupled, numbers)
    limits = caps.make_limits(decoupled)
    W = generators_of(decoupled)
    active = caps.find_active_caps(limits, loops, W, gains)
    assert active is not None
    shares_of_w = jax.jit(lambda W: caps.shares_of_caps(active, limits, loops, W, gains))
    shares, slope = jax.jvp(shares_of_w, (W,), (W,))
    np.testing.assert_allclose(slope, shares, rtol=TUBE_TIGHT)


def test_unstable_loops_have_no_bound(problem):
    numbers, _ = draw(problem, 0)
    assert find_active(problem, -numbers) is None


def test_single_precision_stays_single(decoupled):
    numbers, _ = draw(decoupled, 0)
    active = find_active(decoupled, numbers)

    def single(tree):
        return jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), tree)

    W = single(tube.disturbance_generators(decoupled))
    limits = single(caps.make_limits(decoupled))
    rows = single(np.eye(3))[None]
    loops, gains = single(loops_and_gains(decoupled, numbers))
    shapes = (
        jax.eval_shape(lambda: tube.reach_along(loops[None], W, rows, 3)),
        jax.eval_shape(caps.shares_of_caps, active, limits, loops, W, gains),
        jax.eval_shape(single(tuned.gain_maps_of(decoupled)).vertex_loops.at, single(numbers)),
    )
    assert {leaf.dtype for leaf in jax.tree.leaves(shapes)} == {jnp.dtype("float32")}
