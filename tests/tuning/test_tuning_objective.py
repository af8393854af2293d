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
from jaxtube.control.laws import ScheduledGain, TubeMpc
from jaxtube.qp import fixed_point
from jaxtube.simulation import closed_loop
from jaxtube.simulation.closed_loop import make_wheel_map
from jaxtube.simulation.rollout import realisation_keys, rollout
from jaxtube.simulation.usage import play
from jaxtube.synthesis.design import finish, prepare
from jaxtube.synthesis.feasible import boundary
from jaxtube.tuning import minimal, objective, terminal, tube
from jaxtube.tuning.loop import tightened
from jaxtube.tuning.minimal import limits
from jaxtube.tuning.parameters import parameters
from jaxtube.tuning.tuner import Tuner, freeze
from sets.lyapunov import cost_of_gains

STEP = 5e-5  # of an entry, or of the size of its matrix; the differences are of fourth order
LAPS = 4


class Watched(TubeMpc):
    """The tube-MPC, which says more in place of its backups: those, whether a row is active, and
    which rows are."""

    def act(self, step, memory, measurement, reference_wheels):
        window = self.window(step)
        errors = measurement.errors
        command, following, found = super().act(step, memory, measurement, reference_wheels)
        active = (
            tuned.active_rows(window, errors, following.inputs, tol.ACTIVE_ROW)
            & ~found.backup[:, None]
        )
        parts = found.backup, active.any(axis=1), code(active)
        return (
            command,
            following,
            found._replace(backup=jnp.stack([part.astype(float) for part in parts], axis=1)),
        )


def code(flags):
    """Return numbers, equal to the last bit for equal flags along the last axis and, but by chance,
    only for those."""
    marks = np.random.default_rng(0).uniform(1, 2, flags.shape[-1])
    return jnp.where(flags, jnp.asarray(marks), 0.0).sum(axis=-1)


def watched_play(controller, plant, keys, starts, *, told, widths, margin):
    """Play with a controller that is watched, and tell of every lap:

    its backups, its steps with active rows, which those are, and what is used beyond the margin or
    saturates.
    """
    seen = play(Watched(**vars(controller)), plant, keys, starts)
    wheels, errors = seen["wheels"] / plant.robot.wheel_speed_max, jnp.abs(seen["error"]) / widths
    beyond = code(jnp.concatenate([errors > margin, wheels > margin, jnp.abs(wheels) > 1], axis=2))
    order = 1.0 + jnp.cos(jnp.arange(float(len(wheels))))[:, None]  # tells the steps apart
    backup, active, rows = jnp.moveaxis(seen["backup"], 2, 0)
    told.append(jnp.stack([backup, active, rows * order, beyond * order], axis=2).sum(axis=0))
    return {**seen, "backup": backup > 0}


class Loop:
    """The objective of laps of some steps, compiled once for all points, keys and starts."""

    def __init__(self, kind: str, steps: int):
        problem = tuned.problem_of(kind)
        self.parameters = parameters(problem)
        settled = min(100, steps // 3)
        self.aim = dataclasses.replace(
            objective.aim(problem.scenario, settled), effort_limit=0.05, tail_share=0.5
        )
        plant = tuned.shortened(closed_loop.robot_of(problem), steps)
        self.tuner = Tuner(problem, plant, self.parameters, self.aim, laps=LAPS)
        settings = problem.scenario.controller
        watched = partial(watched_play, widths=limits(problem).widths, margin=self.aim.margin)

        def evaluate(weights, frozen, keys, starts):
            told, arguments = (
                [],
                (frozen, plant, keys, starts, self.aim, make_wheel_map(problem), settings.restart),
            )
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(objective, "play", partial(watched, told=told))
                return objective.objective(weights, *arguments), told[0]

        self.evaluate = jax.jit(jax.value_and_grad(evaluate, has_aux=True))

    def random_point(self, seed: int):
        """Draw a point that has a design, and starts: the scenario's, and others at the edge of the
        feasible set."""
        for attempt in range(20):
            point = tuned.random_point(self.tuner.problem, np.random.default_rng([seed, attempt]))
            found = self.tuner.designed(point)
            if found.frozen is not None:
                break
        design = finish(found.ingredients)
        edge = boundary(
            design.tube_window,
            int(design.windows.index[0]),
            design.problem.operating_set,
            LAPS - 1,
            seed,
        )
        starts = jnp.asarray(np.vstack([design.problem.initial_error, 0.98 * edge]))
        return point, found.frozen, (self.tuner.keys(seed * LAPS, LAPS), starts)


def solved_again(problem, frozen, weights, other_gains: bool):
    """Return what an evaluation holds, solved again for other weights and gains.

    Only the terminal cost follows the weights; for other gains everything is designed anew, the
    terminal set as well, but for the facets that attain the widest tube.
    """
    if other_gains:
        return freeze(prepare(tuned.problem_with(problem, weights)))._replace(active=frozen.active)
    maps = frozen.fixed.maps
    loops, gains = (
        np.asarray(part.at(weights.kappa)) for part in (maps.vertex_loops, maps.vertex_gains)
    )
    P = cost_of_gains(loops, gains, *(np.asarray(part) for part in weights[:2]))
    return frozen._replace(fixed=frozen.fixed._replace(terminal_cost=jnp.asarray(P)))


def signs_in_the_tube(frozen, kappa):
    """Return the signs of all products c g_i whose sizes the tube and its widest extent sum up."""
    signs, support = [], tube.support

    def recorded(generators, rows):
        products = np.asarray(rows @ generators.T).ravel()
        signs.append(np.sign(np.where(np.abs(products) > tol.NO_PRODUCT, products, 0.0)))
        return support(generators, rows)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tube, "support", recorded)
        patch.setattr(minimal, "support", recorded)
        patch.setattr(terminal, "support", recorded)
        tightened(frozen.fixed, kappa), objective.tube_shares(frozen, kappa)
    return np.concatenate(signs)


def slopes(loop: Loop, seed: int, every: int):
    """Return derivatives, differences, scales, which are smooth and which laps have active rows at
    a point.

    Along the numbers of the point and along the entries, one in `every`, others for every seed. Not
    smooth is where, at some end of a difference, other rows are active than at the point, or other
    errors and wheel speeds are beyond the margin, or where a product in the tube has another sign.
    """
    point, frozen, drawn = loop.random_point(seed)
    weights, pull_back = jax.vjp(loop.parameters.weights, jnp.asarray(point))
    (_, pattern), slope = loop.evaluate(weights, frozen, *drawn)
    signs, chosen = signs_in_the_tube(frozen, weights.kappa), slice(seed % every, None, every)

    def along(of, numbers):
        weights_there = of(numbers)
        other_gains = not np.array_equal(weights_there.kappa, weights.kappa)
        again = solved_again(loop.tuner.problem, frozen, weights_there, other_gains)
        (value, told), _ = loop.evaluate(weights_there, again, *drawn)
        same = np.array_equal(told, pattern)
        if same and other_gains:
            same = np.array_equal(signs_in_the_tube(frozen, weights_there.kappa), signs)
        return float(value), same

    def differences(of, numbers, steps):
        found = []
        for direction, step in list(zip(np.eye(len(numbers)), steps, strict=True))[chosen]:
            difference, ends = tuned.fourth_order(partial(along, of), numbers, direction, step)
            found.append((difference, all(same for _, same in ends)))
        return np.array(found).T

    entries = tuned.entries(weights)
    sizes = np.concatenate([np.ones(len(point)), entry_sizes(weights)])
    by_number = differences(loop.parameters.weights, point, STEP * sizes[: len(point)])
    by_entry = differences(tuned.weights_of, entries, STEP * sizes[len(point) :])
    parts = [np.asarray(pull_back(slope)[0]), tuned.slope_of_entries(slope)]
    found = np.concatenate([part[chosen] for part in parts])
    sizes = np.concatenate([sizes[: len(point)][chosen], sizes[len(point) :][chosen]])
    expected, smooth = np.concatenate([by_number, by_entry], axis=1)
    return found, expected, sizes, smooth.astype(bool), pattern


def entry_sizes(weights):
    """Return the scale of every entry: of a weight what it takes to make it singular, of gains
    their own size."""
    roots = [1 / np.sqrt(np.diag(np.linalg.inv(part))) for part in weights[:2]]
    of_weights = [np.outer(root, root)[np.tril_indices(len(root))] for root in roots]
    kappa = np.abs(np.asarray(weights.kappa))
    return np.concatenate([*of_weights, np.maximum(kappa, 0.1 * kappa.max())])


def errors(found, expected, sizes):
    """Return the error of every derivative relative to itself, or to the least one that a
    difference can tell."""
    found, expected = found * sizes, expected * sizes
    return np.abs(found - expected) / np.maximum(
        np.abs(expected), tol.LEAST_SLOPE * np.abs(expected).max()
    )


def check_slopes(loop: Loop, seeds: range, every: int = 1):
    """Compare derivatives with differences at random points, and print the worst error and what was
    left out."""
    worst, kept, active, count = 0.0, 0, 0, 0
    for seed in seeds:
        found, expected, sizes, smooth, pattern = slopes(loop, seed, every)
        worst = max(worst, *errors(found, expected, sizes)[smooth], 0.0)
        kept, count = kept + smooth.sum(), count + len(smooth)
        active += bool(smooth.any() and np.any(pattern[:, 1]))
    print(f"worst relative error {worst:.2e}; {count - kept} of {count} differences are not smooth")
    assert worst <= tol.OBJECTIVE_SLOPE
    assert kept >= tol.SLOPES_KEPT * count and active >= len(seeds) / 2


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
    point, frozen, drawn = loop.random_point(0)
    weights = loop.parameters.weights(jnp.asarray(point))
    slope = loop.evaluate(weights, frozen, *drawn)[1].kappa

    def held(*arguments):
        return jax.lax.stop_gradient(terminal.terminal_set(*arguments))

    monkeypatch.setattr("jaxtube.tuning.loop.terminal_set", held)
    other = Loop("firm", 15).evaluate(weights, frozen, *drawn)[1].kappa
    assert np.abs(slope - other).max() > 1e-2 * np.abs(slope).max()


def test_a_lap_without_plans_counts_its_backups_and_has_the_derivative_of_its_terminal_gain(short):
    point, frozen, (keys, starts) = short.random_point(0)
    weights = short.parameters.weights(jnp.asarray(point))
    (value, told), slope = short.evaluate(weights, frozen, keys, starts.at[:].set(20 * starts[1]))
    assert np.isfinite(value)
    np.testing.assert_array_equal(told[:, 0], np.full(LAPS, 15.0))
    assert not slope.error_weight.any() and not slope.input_weight.any()
    assert np.isfinite(slope.kappa).all() and slope.kappa.all()


def test_a_lap_without_plans_leaves_the_derivatives_of_the_others_finite(short):
    point, frozen, (keys, starts) = short.random_point(0)
    weights = short.parameters.weights(jnp.asarray(point))
    mixed = starts.at[2].set(2 * starts[2])
    (value, told), slope = short.evaluate(weights, frozen, keys, mixed)
    backups = np.asarray(told)[:, 0]
    assert backups[2] > 0 and not backups[[0, 1, 3]].any() and np.isfinite(value)
    assert all(np.isfinite(part).all() and part.any() for part in slope)


@pytest.mark.slow
def test_agrees_with_unrolled_iterations(monkeypatch):
    loop = Loop("decoupled", 4)
    point, frozen, drawn = loop.random_point(1)
    weights = loop.parameters.weights(jnp.asarray(point))
    (value, pattern), slope = loop.evaluate(weights, frozen, *drawn)
    assert (pattern[:, 1] > 0).sum() >= 2

    def unrolled(factors, q, lower, upper):
        # What the iterations go by has a derivative here, which `qp` leaves out.
        factors = fixed_point.factorise(factors.hessian, factors.rows * factors.row_norms[:, None])
        # The product of an infinite bound with its cotangent, zero, would be NaN.
        given = fixed_point.Instances(q, jnp.maximum(lower, -1e6), jnp.minimum(upper, 1e6), q[:, 0])
        given = qp.unit_rows(factors, given)
        x, y = fixed_point.admm(factors, given, jnp.zeros_like(given.q), 400)
        status = jnp.full(len(q), qp.SOLVED, jnp.int32)
        return qp.Solution(
            x.T, y.T / factors.row_norms, status, fixed_point.residual(factors, given, x, y)
        )

    monkeypatch.setattr(qp, "solve", unrolled)
    again = Loop("decoupled", 4)
    (expected, of_unrolled), expected_slope = again.evaluate(weights, frozen, *drawn)
    np.testing.assert_array_equal(of_unrolled[:, :2], pattern[:, :2])
    assert value == pytest.approx(float(expected), rel=tol.UNROLLED)
    for mine, other in zip(slope, expected_slope, strict=True):
        mine, other = (part + part.T if part.ndim == 2 else part for part in (mine, other))
        np.testing.assert_allclose(mine, other, rtol=0, atol=tol.UNROLLED * np.abs(mine).max())


@pytest.fixture(scope="module")
def law():
    """A static law on the slipping robot: laps that cost no time to compile."""
    problem = tuned.problem_of("decoupled")
    gains = jnp.broadcast_to(jnp.asarray([[-1.0, 0.1, 0.0], [0.0, -2.0, -3.0]]), (40, 2, 3))
    aim = dataclasses.replace(objective.aim(problem.scenario, 10), margin=0.5)
    return problem, ScheduledGain(gains, make_wheel_map(problem)), aim


run_laps = jax.jit(objective.run_laps)
drive = jax.jit(rollout.__wrapped__)


def root_mean_square(values, axis=0):
    return np.sqrt((np.asarray(values) ** 2).mean(axis=axis))


def test_laps_are_reduced_as_defined(law):
    problem, controller, aim = law
    plant, keys = tuned.shortened(closed_loop.robot_of(problem), 40), realisation_keys(0, 0, 6)
    starts = jnp.asarray(np.random.default_rng(0).uniform(-0.2, 0.2, (6, 3)))
    within = limits(problem)
    laps = run_laps(controller, plant, keys, starts, within, aim)
    seen = drive(controller, plant, keys, starts)
    np.testing.assert_allclose(
        laps.errors, root_mean_square(seen.errors[10:]), rtol=tol.SAME_REDUCTION
    )
    slip = [problem.scenario.slip.nominal_right, problem.scenario.slip.nominal_left]
    extra = (
        np.asarray(seen.demanded)
        - np.asarray(plant.reference_wheels / (1 - np.array(slip)))[:, None]
    )
    for found, values in ((laps.effort, extra), (laps.settled_effort, extra[9:])):
        np.testing.assert_allclose(
            found, root_mean_square(values, axis=(0, 2)), rtol=tol.SAME_REDUCTION
        )
    used = (
        np.abs(seen.errors[1:]) / within.widths,
        np.asarray(seen.demanded) / problem.robot.wheel_speed_max,
    )
    beyond = sum((np.maximum(part - 0.5, 0) ** 2).sum(axis=2).mean(axis=0) for part in used)
    np.testing.assert_allclose(laps.excess, beyond, rtol=tol.SAME_REDUCTION)
    assert (laps.excess > 0).all() and not laps.backups.any()


def test_a_robot_that_follows_exactly_makes_no_effort_and_exceeds_nothing(law):
    problem, controller, aim = law
    plant = tuned.shortened(closed_loop.robot_of(problem, relative_error=0.0), 40)
    plant = dataclasses.replace(plant, noise=None)
    aim = dataclasses.replace(aim, margin=0.9)
    laps = run_laps(
        controller, plant, realisation_keys(0, 0, 6), jnp.zeros((6, 3)), limits(problem), aim
    )
    for part in laps:
        assert np.abs(part).max() < tol.NO_EFFORT
    slope = jax.grad(lambda squares: objective._root(squares).sum())(jnp.zeros(3))
    assert not slope.any()


def some_laps(count=40):
    rng = np.random.default_rng(1)
    errors, effort = rng.uniform(0, 0.01, (count, 3)), rng.uniform(0, 0.03, count)
    return objective.Laps(
        *(jnp.asarray(part) for part in (errors, effort, effort)), *jnp.zeros((2, count))
    )


AIM = objective.Aim((1e4, 2e4, 0.0), 50.0, 0.05, 1.0, 1.0, 0.0, 0.9, 0)
NO_SHARES = jnp.zeros(3)


def tail(laps, share):
    """Return the mean cost of the worst laps, as the objective has it."""
    of = [
        objective.total_cost(
            laps, NO_SHARES, dataclasses.replace(AIM, tail_share=share, tail_weight=w)
        )
        for w in (1.0, 0.0)
    ]
    return float(of[0] - of[1])


def test_the_tail_is_the_mean_of_the_worst_laps_and_shrinks_to_the_mean():
    laps = some_laps()
    costs = laps.errors**2 @ np.array(AIM.error_costs) + AIM.effort_cost * laps.effort**2
    np.testing.assert_allclose(objective.lap_costs(laps, AIM), costs, rtol=tol.SAME_REDUCTION)
    shares = np.array([0.025, 0.1, 0.5, 1.0])
    tails = [tail(laps, share) for share in shares]
    worst = [np.sort(costs)[-round(40 * share) :].mean() for share in shares]
    np.testing.assert_allclose(tails, worst, rtol=tol.SAME_REDUCTION)
    assert (np.diff(tails) < 0).all() and tails[-1] == pytest.approx(
        float(np.mean(costs)), rel=tol.SAME_REDUCTION
    )


def test_steep_costs_are_zero_inside_the_limits_and_quadratic_beyond():
    laps, aim = some_laps(), dataclasses.replace(AIM, tail_weight=0.0, tube_weight=2.0)
    inside = objective.total_cost(laps, jnp.asarray([0.9, 0.4, 0.1]), aim)
    mean = float(np.mean(objective.lap_costs(laps, aim)))
    assert inside == pytest.approx(mean + 2.0 * 0.4, rel=tol.SAME_REDUCTION)
    outside = objective.total_cost(laps, jnp.asarray([1.0, 0.4, 0.95]), aim) - inside
    assert outside == pytest.approx(objective.STEEPNESS * (0.1**2 + 0.05**2), rel=tol.SAME_STEEP)
    effort = float(root_mean_square(laps.effort))
    limited = dataclasses.replace(aim, effort_limit=effort / 1.2)
    outside = objective.total_cost(
        laps._replace(excess=jnp.full(40, 3e-3)), jnp.asarray([0.9, 0.4, 0.1]), limited
    )
    assert outside - inside == pytest.approx(
        objective.STEEPNESS * (0.2**2 + 3e-3), rel=tol.SAME_STEEP
    )
