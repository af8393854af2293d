"""Laws of the objective: its derivatives against differences with the host's parts solved again,
and what it counts."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tolerances as tol
import tuned

from jaxtube import qp
from jaxtube.control import mpc, planning
from jaxtube.control.laws import ScheduledGain, TubeMpc
from jaxtube.qp import fixed_point, parametric
from jaxtube.simulation import components
from jaxtube.simulation.components import make_wheel_map
from jaxtube.simulation.rollout import realisation_keys, rollout
from jaxtube.simulation.usage import play
from jaxtube.synthesis.design import finish, prepare
from jaxtube.synthesis.feasible import boundary
from jaxtube.synthesis.terminal_cost import in_shares
from jaxtube.tuning import minimal, objective, terminal, tube
from jaxtube.tuning.caps import make_limits
from jaxtube.tuning.loop import tightened_bounds
from jaxtube.tuning.objective import LapInputs
from jaxtube.tuning.parameters import make_parameters
from jaxtube.tuning.tuner import Tuner, make_evaluation_constants
from sets.lyapunov import cost_of_gains

ACTIVE_ROW = 1e-8
"""In m, rad and units of the inputs; distance from its bound below which a row is active."""
LEAST_SLOPE = 0.01
"""Of the greatest of a gradient; below, rounding hides what differences tell."""
SLOPES_KEPT = 0.7
"""Of the differences, that see the same rows active at all their points."""
UNROLLED = 1e-6
"""Relative; 400 iterations of ADMM."""
SAME_REDUCTION = 1e-12
"""Relative; means of numbers of order one."""
SAME_STEEP = 1e-9
"""Relative; a difference of objectives."""
NO_EFFORT = 1e-11
"""In m, rad and m/s; what rounding makes of zero in 40 steps, and the least root."""
NO_PRODUCT = 1e-15
"""Of rows and generators, below which its sign is rounding."""

STEP = 5e-5  # of an entry, or of the size of its matrix; the differences are of fourth order
LAPS = 4


class Watched(TubeMpc):
    """The tube-MPC, which says more in place of its backups: those, whether a row is active, and
    which rows are."""

    def act(self, step, memory, measurement, reference_wheels):
        command, following, diagnostics = super().act(step, memory, measurement, reference_wheels)
        window = self.condensed_qp(step)
        active = tuned.active_rows(window, measurement.errors, following.inputs, ACTIVE_ROW)
        active = active & ~diagnostics.backup[:, None]
        parts = [diagnostics.backup.astype(float), active.any(axis=1).astype(float), code(active)]
        return command, following, diagnostics._replace(backup=jnp.stack(parts, axis=1))


def code(flags):
    """Return numbers, equal to the last bit for equal flags along the last axis and, but by chance,
    only for those."""
    marks = np.random.default_rng(0).uniform(1, 2, flags.shape[-1])
    return jnp.where(flags, jnp.asarray(marks), 0.0).sum(axis=-1)


def watch(controller, plant, keys, starts, *, widths, margin):
    """Play with a controller that is watched, and return of every lap:

    its backups, its steps with active rows, which those are, and what is used beyond the margin or
    saturates.
    """
    seen = play(Watched(**vars(controller)), plant, keys, starts)
    wheels = seen["wheels"] / plant.robot.wheel_speed_max
    errors = jnp.abs(seen["error"]) / widths
    beyond = code(jnp.concatenate([errors > margin, wheels > margin, jnp.abs(wheels) > 1], axis=2))
    order = 1.0 + jnp.cos(jnp.arange(float(len(wheels))))[:, None]  # tells the steps apart
    backup, active, rows = jnp.moveaxis(seen["backup"], 2, 0)
    return jnp.stack([backup, active, rows * order, beyond * order], axis=2).sum(axis=0)


class Loop:
    """The objective of laps of some steps, compiled once for all points, keys and starts."""

    def __init__(self, kind: str, steps: int):
        problem = tuned.problem_of(kind)
        self.parameters = make_parameters(problem)
        self.weights = jax.jit(self.parameters.weights)
        settled = min(100, steps // 3)
        aim = objective.make_aim(problem.scenario, settled)
        aim = dataclasses.replace(aim, effort_limit=0.05, tail_share=0.5)
        plant = tuned.shortened(components.robot_of(problem), steps)
        self.tuner = Tuner(problem, plant, self.parameters, aim, laps=LAPS)
        widths = make_limits(problem).widths

        def evaluate(weights, constants, lap_inputs):
            controller = constants.controller(jax.lax.stop_gradient(weights))
            pattern = watch(controller, *lap_inputs, widths=widths, margin=aim.margin)
            return objective.objective(weights, constants, lap_inputs, aim), pattern

        self.evaluate = jax.jit(jax.value_and_grad(evaluate, has_aux=True))

    def random_point(self, seed: int):
        """Draw a point that has a design, and starts: the scenario's, and others at the edge of the
        feasible set."""
        for attempt in range(20):
            point = tuned.random_point(self.tuner.problem, np.random.default_rng([seed, attempt]))
            candidate = self.tuner.candidate(point)
            if candidate.constants is not None:
                break
        design = finish(candidate.prepared)
        first = int(design.windows.index[0])
        operating = design.problem.operating_set
        edge = boundary(design.tube_qps, first, operating, LAPS - 1, seed)
        starts = jnp.asarray(np.vstack([design.problem.initial_error, 0.98 * edge]))
        keys = self.tuner.keys(seed * LAPS, LAPS)
        return point, candidate.constants, LapInputs(self.tuner.plant, keys, starts)


def solve_again(problem, constants, weights, other_gains: bool):
    """Return what an evaluation holds, solved again for other weights and gains.

    Only the terminal cost follows the weights; for other gains everything is designed anew, the
    terminal set as well, but for the facets that attain the widest tube.
    """
    if other_gains:
        again = make_evaluation_constants(prepare(tuned.problem_with(problem, weights)))
        return dataclasses.replace(again, active=constants.active)
    maps = constants.design.maps
    loops = np.asarray(maps.vertex_loops.at(weights.kappa))
    gains = np.asarray(maps.vertex_gains.at(weights.kappa))
    error_weight = np.asarray(weights.error_weight)
    input_weight = np.asarray(weights.input_weight)
    limits = problem.operating_set.offsets[:3]
    of_shares = cost_of_gains(*in_shares(loops, gains, error_weight, limits), input_weight)
    cost = jnp.asarray(of_shares / np.outer(limits, limits))
    return dataclasses.replace(constants, design=constants.design._replace(terminal_cost=cost))


@jax.jit
def signs_in_the_tube(constants, kappa):
    """Return the signs of all products c g_i whose sizes the tube and its widest extent sum up."""
    signs = []
    support = tube.support

    def record(generators, rows):
        products = jnp.ravel(rows @ generators.T)
        signs.append(jnp.where(jnp.abs(products) > NO_PRODUCT, jnp.sign(products), 0.0))
        return support(generators, rows)

    with pytest.MonkeyPatch.context() as patch:
        for module in (tube, minimal, terminal):
            patch.setattr(module, "support", record)
        tightened_bounds(constants.design, kappa)
        constants.tube_shares(kappa)
    return jnp.concatenate(signs)


class Slopes:
    """Derivatives and differences at a point, in units of the size of each direction.

    Along the numbers of the point and along the entries, one in `every`, others for every seed. Not
    smooth is where, at some end of a difference, other rows are active than at the point, or other
    errors and wheel speeds are beyond the margin, or where a product in the tube has another sign.

    Attributes:
        derivatives, differences, smooth: by direction.
        pattern: what every lap did at the point.
    """

    def __init__(self, loop: Loop, seed: int, every: int):
        self._loop = loop
        point, self._frozen, self._conditions = loop.random_point(seed)
        self._weights = loop.weights(jnp.asarray(point))
        _, pull_back = jax.vjp(loop.weights, jnp.asarray(point))
        (_, self.pattern), slope = loop.evaluate(self._weights, self._frozen, self._conditions)
        self._signs = np.asarray(signs_in_the_tube(self._frozen, self._weights.kappa))
        chosen = slice(seed % every, None, every)
        entries = tuned.entries(self._weights)
        sizes = sizes_of_entries(self._weights)
        unit = np.ones(len(point))
        along_numbers = np.asarray(pull_back(slope)[0])
        along_entries = sizes * tuned.slope_of_entries(slope)
        self.derivatives = np.append(along_numbers[chosen], along_entries[chosen])
        pairs = [
            *self._differentiate(loop.weights, point, np.diag(unit)[chosen]),
            *self._differentiate(tuned.weights_of, entries, np.diag(sizes)[chosen]),
        ]
        self.differences = np.array([difference for difference, _ in pairs])
        self.smooth = np.array([smooth for _, smooth in pairs])

    def _differentiate(self, of, numbers, directions):
        """Return differences of the objective along directions, and whether each is smooth."""
        pairs = []
        for direction in directions:
            evaluate = partial(self._evaluate, of)
            difference, ends = tuned.fourth_order(evaluate, numbers, direction, STEP)
            pairs.append((difference, all(same for _, same in ends)))
        return pairs

    def _evaluate(self, of, numbers):
        """Return the objective with the host's parts solved again, and whether the laps and the
        tube do the same as at the point."""
        weights = of(numbers)
        other_gains = not np.array_equal(weights.kappa, self._weights.kappa)
        problem = self._loop.tuner.problem
        again = solve_again(problem, self._frozen, weights, other_gains)
        (value, pattern), _ = self._loop.evaluate(weights, again, self._conditions)
        same = np.array_equal(pattern, self.pattern)
        if same and other_gains:
            same = np.array_equal(signs_in_the_tube(self._frozen, weights.kappa), self._signs)
        return float(value), same

    def errors(self):
        """Return the error of every smooth derivative relative to itself, or to the least one that
        a difference can tell."""
        sizes = np.abs(self.differences)
        scale = np.maximum(sizes, LEAST_SLOPE * sizes.max())
        return (np.abs(self.derivatives - self.differences) / scale)[self.smooth]


def sizes_of_entries(weights):
    """Return the scale of every entry: of a weight what it takes to make it singular, of gains
    their own size."""
    sizes = []
    for weight in (weights.error_weight, weights.input_weight):
        roots = 1 / np.sqrt(np.diag(np.linalg.inv(weight)))
        sizes.append(np.outer(roots, roots)[np.tril_indices(len(roots))])
    kappa = np.abs(np.asarray(weights.kappa))
    return np.concatenate([*sizes, np.maximum(kappa, 0.1 * kappa.max())])


def check_slopes(loop: Loop, seeds: range, every: int = 1):
    """Compare derivatives with differences at random points, and print the worst error and what was
    left out."""
    worst = 0.0
    kept = 0
    count = 0
    active = 0
    for seed in seeds:
        slopes = Slopes(loop, seed, every)
        worst = max(worst, *slopes.errors(), 0.0)
        kept += slopes.smooth.sum()
        count += len(slopes.smooth)
        active += bool(slopes.smooth.any() and np.any(slopes.pattern[:, 1]))
    print(f"worst relative error {worst:.2e}; {count - kept} of {count} differences are not smooth")
    assert worst <= tol.OBJECTIVE_SLOPE
    assert kept >= SLOPES_KEPT * count and active >= len(seeds) / 2


@pytest.fixture(scope="module")
def short():
    """Laps of 15 steps."""
    return Loop("decoupled", 15)


def test_derivatives_are_differences_with_the_host_solved_again(short):
    check_slopes(short, range(2, 3), every=5)  # a point without kinks close by


@pytest.mark.slow
def test_derivatives_along_every_direction_are_differences_with_the_host_solved_again(short):
    check_slopes(short, range(1))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "points", "every"), [("decoupled", 10, 1), ("firm", 25, 1), ("vertices", 15, 5)]
)
def test_derivatives_of_whole_laps_are_differences_with_the_host_solved_again(kind, points, every):
    check_slopes(Loop(kind, 300), range(points), every)


@pytest.mark.slow
def test_the_slope_of_the_terminal_set_counts(monkeypatch):
    loop = Loop("firm", 15)
    point, constants, lap_inputs = loop.random_point(0)
    weights = loop.weights(jnp.asarray(point))
    slope = loop.evaluate(weights, constants, lap_inputs)[1].kappa

    def hold(*arguments):
        return jax.lax.stop_gradient(terminal.compute_terminal_set(*arguments))

    monkeypatch.setattr("jaxtube.tuning.loop.compute_terminal_set", hold)
    other = Loop("firm", 15).evaluate(weights, constants, lap_inputs)[1].kappa
    assert np.abs(slope - other).max() > 1e-2 * np.abs(slope).max()


def test_a_lap_without_plans_counts_its_backups_and_has_the_derivative_of_its_terminal_gain(short):
    point, constants, lap_inputs = short.random_point(0)
    weights = short.weights(jnp.asarray(point))
    starts = lap_inputs.starts
    outside = lap_inputs._replace(starts=starts.at[:].set(20 * starts[1]))
    (value, told), slope = short.evaluate(weights, constants, outside)
    assert np.isfinite(value)
    np.testing.assert_array_equal(told[:, 0], np.full(LAPS, 15.0))
    assert not slope.error_weight.any() and not slope.input_weight.any()
    assert np.isfinite(slope.kappa).all() and slope.kappa.all()


def test_a_lap_without_plans_leaves_the_derivatives_of_the_others_finite(short):
    point, constants, lap_inputs = short.random_point(0)
    weights = short.weights(jnp.asarray(point))
    starts = lap_inputs.starts
    mixed = lap_inputs._replace(starts=starts.at[2].set(2 * starts[2]))
    (value, told), slope = short.evaluate(weights, constants, mixed)
    backups = np.asarray(told)[:, 0]
    assert backups[2] > 0 and not backups[[0, 1, 3]].any() and np.isfinite(value)
    assert all(np.isfinite(part).all() and part.any() for part in slope)


@pytest.mark.slow
def test_agrees_with_unrolled_iterations(monkeypatch):
    loop = Loop("decoupled", 4)
    point, constants, lap_inputs = loop.random_point(1)
    weights = loop.weights(jnp.asarray(point))
    (value, pattern), slope = loop.evaluate(weights, constants, lap_inputs)
    assert (pattern[:, 1] > 0).sum() >= 2

    def unrolled(factors, q, lower, upper):
        # What the iterations go by has a derivative here, which `qp` leaves out.
        gram = factors.rows.T @ factors.rows
        gain = jnp.linalg.inv(factors.hessian + factors.rho * gram)
        iterated = factors.iterated._replace(admm_gain=gain)
        # The product of an infinite bound with its cotangent, zero, would be NaN.
        finite = (jnp.maximum(lower, -1e6), jnp.minimum(upper, 1e6))
        given = fixed_point.unit_rows(factors, q, *finite)
        x, y = fixed_point.admm(factors, iterated, given, jnp.zeros_like(given.q), 400)
        status = jnp.full(len(q), qp.SOLVED, jnp.int32)
        return qp.Solution(
            x.T, y.T / factors.row_norms, status, fixed_point.residual(factors, given, x, y)
        )

    traced = []

    def act_unrolled(qps, index, state, errors, restart):
        assert restart
        traced.append(index)
        condensed = planning.take_qp(qps, index)
        solution = unrolled(condensed.factors, *parametric.form(condensed.parametric, errors))
        free = planning.is_free(condensed, errors)
        plan = planning.choose_plan(condensed, errors, free, solution)
        return mpc._follow(condensed, state, errors, errors, plan)

    monkeypatch.setattr(mpc, "act", act_unrolled)
    again = Loop("decoupled", 4)
    (expected, of_unrolled), expected_slope = again.evaluate(weights, constants, lap_inputs)
    assert traced
    np.testing.assert_array_equal(of_unrolled[:, :2], pattern[:, :2])
    assert value == pytest.approx(float(expected), rel=UNROLLED)
    for mine, other in zip(slope, expected_slope, strict=True):
        if mine.ndim == 2:
            mine = mine + mine.T
            other = other + other.T
        np.testing.assert_allclose(mine, other, rtol=0, atol=UNROLLED * np.abs(mine).max())


STEPS_OF_LAW = 40


@pytest.fixture(scope="module")
def law():
    """A static law on the slipping robot: laps that cost no time to compile."""
    problem = tuned.problem_of("decoupled")
    gains = jnp.broadcast_to(
        jnp.asarray([[-1.0, 0.1, 0.0], [0.0, -2.0, -3.0]]), (STEPS_OF_LAW, 2, 3)
    )
    aim = dataclasses.replace(objective.make_aim(problem.scenario, 10), margin=0.5)
    controller = ScheduledGain(gains, make_wheel_map(problem))
    plant = tuned.shortened(components.robot_of(problem), STEPS_OF_LAW)
    return problem, controller, plant, aim


run_laps = jax.jit(objective.measure_laps)
drive = jax.jit(rollout.__wrapped__)


def root_mean_square(values, axis=0):
    return np.sqrt((np.asarray(values) ** 2).mean(axis=axis))


def test_laps_are_reduced_as_defined(law):
    problem, controller, plant, aim = law
    starts = jnp.asarray(np.random.default_rng(0).uniform(-0.2, 0.2, (6, 3)))
    lap_inputs = LapInputs(plant, realisation_keys(0, 0, 6), starts)
    limits = make_limits(problem)
    laps = run_laps(controller, lap_inputs, limits, aim)
    seen = drive(controller, *lap_inputs)
    close = {"rtol": SAME_REDUCTION}
    np.testing.assert_allclose(laps.errors, root_mean_square(seen.errors[10:]), **close)
    slip = problem.scenario.slip
    grip = 1 - np.array([slip.nominal_right, slip.nominal_left])
    extra = np.asarray(seen.demanded) - np.asarray(plant.reference_wheels / grip)[:, None]
    effort = root_mean_square(extra, axis=(0, 2))
    settled_effort = root_mean_square(extra[9:], axis=(0, 2))
    np.testing.assert_allclose(laps.effort, effort, **close)
    np.testing.assert_allclose(laps.settled_effort, settled_effort, **close)
    error_share = np.abs(seen.errors[1:]) / limits.widths
    wheel_share = np.asarray(seen.demanded) / problem.robot.wheel_speed_max
    excess = mean_square_beyond(error_share, 0.5) + mean_square_beyond(wheel_share, 0.5)
    np.testing.assert_allclose(laps.excess, excess, **close)
    assert (laps.excess > 0).all() and not laps.backups.any()


def mean_square_beyond(shares, margin):
    return (np.maximum(shares - margin, 0) ** 2).sum(axis=2).mean(axis=0)


def test_a_robot_that_follows_exactly_makes_no_effort_and_exceeds_nothing(law):
    problem, controller, _, aim = law
    exact = components.robot_of(problem)
    known = exact.slips.without_errors()
    shortened = tuned.shortened(exact, STEPS_OF_LAW)
    plant = dataclasses.replace(shortened, slips=known, noise=None)
    lap_inputs = LapInputs(plant, realisation_keys(0, 0, 6), jnp.zeros((6, 3)))
    loose = dataclasses.replace(aim, margin=0.9)
    laps = run_laps(controller, lap_inputs, make_limits(problem), loose)
    for part in laps:
        assert np.abs(part).max() < NO_EFFORT
    slope = jax.grad(lambda squares: objective._root(squares).sum())(jnp.zeros(3))
    assert not slope.any()


def some_laps(count=40):
    rng = np.random.default_rng(1)
    errors = jnp.asarray(rng.uniform(0, 0.01, (count, 3)))
    effort = jnp.asarray(rng.uniform(0, 0.03, count))
    nothing = jnp.zeros(count)
    return objective.LapMeasures(errors, effort, effort, nothing, nothing)


AIM = objective.Aim((1e4, 2e4, 0.0), 50.0, 0.05, 1.0, 1.0, 0.0, 0.9, 0)
NO_SHARES = jnp.zeros(3)


def tail(laps, share):
    """Return the mean cost of the worst laps, as the objective has it."""
    with_tail = dataclasses.replace(AIM, tail_share=share, tail_weight=1.0)
    without = dataclasses.replace(with_tail, tail_weight=0.0)
    total = objective.total_cost
    return float(total(laps, NO_SHARES, with_tail) - total(laps, NO_SHARES, without))


def test_the_tail_is_the_mean_of_the_worst_laps_and_shrinks_to_the_mean():
    laps = some_laps()
    costs = laps.errors**2 @ np.array(AIM.error_costs) + AIM.effort_cost * laps.effort**2
    np.testing.assert_allclose(objective.lap_costs(laps, AIM), costs, rtol=SAME_REDUCTION)
    shares = np.array([0.025, 0.1, 0.5, 1.0])
    tails = [tail(laps, share) for share in shares]
    worst = [np.sort(costs)[-round(40 * share) :].mean() for share in shares]
    np.testing.assert_allclose(tails, worst, rtol=SAME_REDUCTION)
    assert (np.diff(tails) < 0).all() and tails[-1] == pytest.approx(
        float(np.mean(costs)), rel=SAME_REDUCTION
    )


def test_steep_costs_are_zero_inside_the_limits_and_quadratic_beyond():
    laps = some_laps()
    aim = dataclasses.replace(AIM, tail_weight=0.0, tube_weight=2.0)
    inside = objective.total_cost(laps, jnp.asarray([0.9, 0.4, 0.1]), aim)
    mean = float(np.mean(objective.lap_costs(laps, aim)))
    assert inside == pytest.approx(mean + 2.0 * 0.4, rel=SAME_REDUCTION)
    outside = objective.total_cost(laps, jnp.asarray([1.0, 0.4, 0.95]), aim) - inside
    assert outside == pytest.approx(objective.STEEPNESS * (0.1**2 + 0.05**2), rel=SAME_STEEP)
    effort = float(root_mean_square(laps.effort))
    limited = dataclasses.replace(aim, effort_limit=effort / 1.2)
    outside = objective.total_cost(
        laps._replace(excess=jnp.full(40, 3e-3)), jnp.asarray([0.9, 0.4, 0.1]), limited
    )
    assert outside - inside == pytest.approx(objective.STEEPNESS * (0.2**2 + 3e-3), rel=SAME_STEEP)
