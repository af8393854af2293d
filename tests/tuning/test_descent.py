"""Laws of the descents: they step as the equations say, reach optima, keep the best, and tell why
they stop."""

import re
from typing import NamedTuple

import numpy as np
import pytest
from scipy.optimize import rosen, rosen_der

from jaxtube.tuning.descent import adam, cosine, lbfgs
from jaxtube.tuning.watch import CLIFF_STEPS, Stop

ADAM_BY_HAND = 1e-13
"""Points of order one; the same sums in numpy."""
DESCENT_OPTIMUM = 1e-8
"""Distance to the optimum of numbers of order one."""
NOISY_OPTIMUM = 0.06
"""Distance after 400 steps under noise of deviation 0.3 in the gradient."""

NAMES = ("log q_x", "log q_y")
HESSIAN = np.array([[3.0, 1.0], [1.0, 2.0]])
OPTIMUM = np.array([0.7, -1.1])
START = np.array([2.0, 1.0])
ADAM = {"budget": 30, "patience": 1000, "learning_rate": 0.1}
LBFGS = {"budget": 200, "patience": 1000}


class Seen(NamedTuple):
    held_out: float
    certified: bool


def quadratic(point, draws):
    step = point - OPTIMUM
    return 10.0 + step @ HESSIAN @ step / 2, HESSIAN @ step


def rosenbrock(point, draws):
    return rosen(point), rosen_der(point)


def noisy(point, draws, deviation=1.0):
    """Add a random slope, that of the draws."""
    noise = deviation * np.random.default_rng((3, draws)).standard_normal(2)
    value, gradient = quadratic(point, draws)
    return value + noise @ (point - OPTIMUM), gradient + noise


def sloped(value):
    """Return an objective whose values are told by `value(x)`, and whose gradient leads to larger x
    always."""
    return lambda point, draws: (value(point[0]), np.array([-1.0, 0.0]))


def closer(iteration, point):
    return Seen(-float(iteration), True)


def distance(iteration, point):
    return Seen(float(np.linalg.norm(point - OPTIMUM)), True)


def one_line(sentence):
    return "\n" not in sentence and ";" in sentence


# ------------------------------------------------------------------------------
# Adam


def adam_by_hand(objective, start, steps, learning_rate, final_share, largest):
    point = np.array(start)
    m = np.zeros(2)
    v = np.zeros(2)
    points = []
    for k in range(1, steps + 1):
        g = objective(point, k - 1)[1]
        g = g * min(1.0, largest / np.sqrt(np.sum(g**2)))
        m = 0.9 * m + 0.1 * g
        v = 0.999 * v + 0.001 * g**2
        share = np.cos(np.pi * (k - 1) / (2 * steps - 2)) ** 2
        rate = learning_rate * (final_share + (1 - final_share) * share)
        mean = m / (1 - 0.9**k)
        deviation = np.sqrt(v / (1 - 0.999**k))
        point = point - rate * mean / (deviation + 1e-8)
        points.append(point)
    return points


@pytest.mark.parametrize("largest", [None, 1.5])
def test_the_steps_of_adam_are_those_by_hand(largest):
    points = []

    def inspect(iteration, point):
        points.append(point)
        return closer(iteration, point)

    adam(noisy, inspect, START, NAMES, **ADAM, final_share=0.2, largest_gradient=largest)
    by_hand = adam_by_hand(noisy, START, 30, 0.1, 0.2, largest or np.inf)
    np.testing.assert_array_equal(points[0], START)
    np.testing.assert_allclose(points[1:], by_hand, atol=ADAM_BY_HAND)


def test_clipping_changes_the_way():
    free = adam(noisy, closer, START, NAMES, **ADAM)
    clipped = adam(noisy, closer, START, NAMES, **ADAM, largest_gradient=1.5)
    assert np.abs(free.point - clipped.point).max() > 1e-3


def test_under_a_constant_gradient_adam_moves_by_the_learning_rate():
    rates = [cosine(0.1, 0.2, step, 30) for step in range(30)]
    outcome = adam(sloped(lambda x: 1.0), closer, START, NAMES, **ADAM, final_share=0.2)
    np.testing.assert_allclose(outcome.point - START, [sum(rates), 0.0], atol=1e-7)
    assert rates[0] == 0.1 and rates == sorted(rates, reverse=True)
    assert rates[-1] == pytest.approx(0.02)


def test_adam_converges_under_noise():
    settings = ADAM | {"budget": 400, "final_share": 0.01}
    outcome = adam(lambda x, draws: noisy(x, draws, 0.3), distance, START, NAMES, **settings)
    assert np.linalg.norm(outcome.point - OPTIMUM) < NOISY_OPTIMUM
    assert outcome.stop is Stop.BUDGET and outcome.evaluations == outcome.iterations == 400


def test_adam_asks_for_fresh_draws_and_lbfgs_for_frozen_ones():
    for descend, settings, expected in ((adam, ADAM, list(range(30))), (lbfgs, LBFGS, [0])):
        asked = []

        def evaluate(point, draws, asked=asked):
            asked.append(draws)
            return quadratic(point, draws)

        descend(evaluate, closer, START, NAMES, **settings)
        assert asked == expected or set(asked) == {0} == set(expected)


# ------------------------------------------------------------------------------
# L-BFGS


def test_lbfgs_reaches_the_optimum_of_a_quadratic():
    outcome = lbfgs(quadratic, distance, START, NAMES, **LBFGS)
    assert outcome.stop is Stop.CONVERGED and one_line(outcome.sentence.replace(":", ";"))
    np.testing.assert_allclose(outcome.point, OPTIMUM, atol=DESCENT_OPTIMUM)


def test_lbfgs_reaches_the_optimum_of_rosenbrock():
    start = np.array([-1.2, 1.0, -0.5, 0.8])
    outcome = lbfgs(rosenbrock, closer, start, tuple("abcd"), **LBFGS, tolerance=1e-15)
    np.testing.assert_allclose(outcome.point, 1.0, atol=DESCENT_OPTIMUM)


@pytest.mark.parametrize("budget", [1, 2, 7, 20])
def test_lbfgs_stops_at_its_budget_exactly(budget):
    calls = []

    def evaluate(point, draws):
        calls.append(point)
        return rosenbrock(point, draws)

    outcome = lbfgs(evaluate, closer, np.array([-1.2, 1.0]), NAMES, budget=budget, patience=1000)
    assert outcome.stop is Stop.BUDGET and outcome.evaluations == len(calls) == budget
    assert re.search(rf"budget of {budget} .*; raise the budget", outcome.sentence)


def test_lbfgs_inspects_the_start_and_every_accepted_iterate():
    seen = []

    def inspect(iteration, point):
        seen.append((iteration, rosen(point)))
        return closer(iteration, point)

    outcome = lbfgs(rosenbrock, inspect, np.array([-1.2, 1.0]), NAMES, **LBFGS)
    values = [value for _, value in seen]
    assert [iteration for iteration, _ in seen] == list(range(outcome.iterations + 1))
    assert values == sorted(values, reverse=True) and values[-1] == rosen(outcome.point)


def test_a_failed_line_search_is_told():
    def uphill(point, draws):
        value, gradient = quadratic(point, draws)
        return value, -gradient

    outcome = lbfgs(uphill, closer, START, NAMES, **LBFGS)
    assert outcome.stop is Stop.LINE_SEARCH and one_line(outcome.sentence)
    assert "line search found no lower objective from iteration 0" in outcome.sentence
    np.testing.assert_array_equal(outcome.point, START)


# ------------------------------------------------------------------------------
# the best and stops


@pytest.mark.parametrize("descend, settings", [(adam, ADAM), (lbfgs, LBFGS | {"tolerance": 1e-15})])
def test_the_best_certified_iterate_is_kept_though_later_ones_without_certificate_are_better(
    descend, settings
):
    held_out = [9.0, 5.0, 3.0, 4.0, np.nan, 2.0, 1.0, 1.5]
    points = []

    def inspect(iteration, point):
        points.append(point)
        return Seen(held_out[iteration] if iteration < 8 else 8.0, iteration <= 4)

    outcome = descend(rosenbrock, inspect, np.array([-1.2, 1.0]), NAMES, **settings)
    expected = ((outcome.best_certified, 2, 3.0), (outcome.best_uncertified, 6, 1.0))
    for best, iteration, value in expected:
        assert (best.iteration, best.held_out) == (iteration, value)
        np.testing.assert_array_equal(best.point, points[iteration])
    np.testing.assert_array_equal(outcome.point, points[-1])


def test_an_iterate_of_each_kind_may_be_missing():
    outcome = adam(quadratic, lambda iteration, point: Seen(np.inf, True), START, NAMES, **ADAM)
    assert outcome.best_certified is None and outcome.best_uncertified is None
    assert adam(quadratic, closer, START, NAMES, **ADAM).best_uncertified is None


@pytest.mark.parametrize("descend, settings", [(adam, ADAM), (lbfgs, LBFGS)])
def test_patience_with_what_would_be_returned_ends_the_descent(descend, settings):
    held_out = [5.0, 4.0, 6.0, 3.0, 1.0, 7.0, np.nan, 2.0]
    outcome = descend(
        rosenbrock,
        lambda iteration, point: Seen(held_out[iteration], iteration % 2 == 1),
        np.array([-1.2, 1.0]),
        NAMES,
        **settings | {"patience": 3},
    )
    assert outcome.stop is Stop.PATIENCE and outcome.iterations == 6
    assert "not below 3 of iteration 3 after 3 more" in outcome.sentence
    assert "raise the patience" in outcome.sentence and one_line(outcome.sentence)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_adam_ends_where_the_objective_is_not_a_number(bad):
    outcome = adam(sloped(lambda x: 1.0 if x < 2.45 else bad), closer, START, NAMES, **ADAM)
    assert outcome.stop is Stop.NOT_A_NUMBER and one_line(outcome.sentence)
    assert outcome.point[0] >= 2.45 and outcome.evaluations == outcome.iterations + 1 == 6
    assert outcome.sentence == (
        f"objective is not a number at iteration 5 (parameter log q_x = {outcome.point[0]:.4g}); "
        "lower the learning rate or start closer to a stable design"
    )


def test_lbfgs_ends_where_the_objective_is_not_a_number():
    outcome = lbfgs(sloped(lambda x: -x if x < 2.45 else np.nan), closer, START, NAMES, **LBFGS)
    assert outcome.stop is Stop.NOT_A_NUMBER and outcome.iterations == 0
    assert (
        "iteration 0 (parameter log q_x = 3); start closer to a stable design" in outcome.sentence
    )


def test_the_parameter_whose_derivative_is_not_a_number_is_named():
    for descend, settings in ((adam, ADAM), (lbfgs, LBFGS)):
        outcome = descend(
            lambda x, draws: (1.0, np.array([1.0, np.nan])), closer, START, NAMES, **settings
        )
        assert outcome.stop is Stop.NOT_A_NUMBER and outcome.iterations == 0
        assert outcome.sentence == (
            "gradient is not a number at iteration 0 (parameter log q_y = 1); "
            "start closer to a stable design"
        )


def test_adam_ends_beyond_a_cliff():
    outcome = adam(sloped(lambda x: 1.0 if x < 2.45 else 10.5), closer, START, NAMES, **ADAM)
    assert outcome.stop is Stop.CLIFF and outcome.iterations == 5 + CLIFF_STEPS - 1
    assert (
        "over 10 times its least value so far, 1, at 5 iterations in a row up to 9"
        in outcome.sentence
    )
    assert re.search(
        r"log q_x = 2\.\d+\); lower the learning rate or clip gradients", outcome.sentence
    )


def test_adam_goes_on_after_short_leaps_over_a_cliff():
    for value in (lambda x: 10.5 if 2.2 < x < 2.55 else 1.0, lambda x: 9.5 if x > 2.2 else 1.0):
        assert adam(sloped(value), closer, START, NAMES, **ADAM).stop is Stop.BUDGET


@pytest.mark.parametrize(
    "changes, told",
    [
        ({"start": np.array([1.0, np.nan])}, "start = "),
        ({"start": np.array([1, 2])}, "start = "),
        ({"names": ("one",)}, "for each of the 1 names"),
        ({"budget": 0}, "budget = 0"),
        ({"patience": 0}, "patience = 0"),
        ({"learning_rate": -0.1}, "learning_rate = -0.1"),
        ({"final_share": 0.0}, "final_share = 0.0"),
        ({"largest_gradient": 0.0}, "largest_gradient = 0.0"),
    ],
)
def test_settings_out_of_range_are_refused(changes, told):
    settings = {"evaluate": quadratic, "inspect": closer, "start": START, "names": NAMES, **ADAM}
    with pytest.raises(ValueError, match=re.escape(told)):
        adam(**settings | changes)
