"""Laws of interval arithmetic: it encloses exact arithmetic, derivatives included, and suprema lie
within bounds."""

from fractions import Fraction

import mpmath
import numpy as np
import pytest

from sets.interval import (
    QUARTER_TURN,
    Dual,
    Interval,
    cos,
    lag,
    lag_slope,
    reciprocal,
    sin,
    sinc,
    sinc_change,
    sinc_curvature,
    sinc_slope,
    sine_excess,
    square,
)
from sets.supremum import suprema

INTERVAL_WIDTH = 1e-13
"""Of an enclosure at a point, numbers of order one."""

# each function of an angle with its textbook form, which cancels near 0: hence the many digits
FUNCTIONS = {
    sin: mpmath.sin,
    cos: mpmath.cos,
    sinc: lambda x: mpmath.sin(x) / x if x else mpmath.mpf(1),
    sinc_slope: lambda x: (x * mpmath.cos(x) - mpmath.sin(x)) / x**2 if x else mpmath.mpf(0),
    sinc_curvature: lambda x: (
        -mpmath.sin(x) / x - 2 * (x * mpmath.cos(x) - mpmath.sin(x)) / x**3
        if x
        else -mpmath.mpf(1) / 3
    ),
    sine_excess: lambda x: mpmath.sin(x) - x,
    lag: lambda x: (x - mpmath.sin(x)) / x**2 if x else mpmath.mpf(0),
    lag_slope: lambda x: (
        (1 - mpmath.cos(x)) / x**2 - 2 * (x - mpmath.sin(x)) / x**3 if x else mpmath.mpf(1) / 6
    ),
}
DERIVATIVES = {sin: cos, sinc: sinc_slope, sinc_slope: sinc_curvature, lag: lag_slope}
NAMES = ["sin", "cos", "sinc", "sinc_slope", "sinc_curvature", "sine_excess", "lag", "lag_slope"]
each_function = pytest.mark.parametrize("function", FUNCTIONS, ids=NAMES)


@pytest.fixture(autouse=True)
def many_digits():
    with mpmath.workdps(80):
        yield


def intervals(ends: np.ndarray) -> Interval:
    return Interval(*np.sort(ends, axis=0))


def members(interval: Interval, rng: np.random.Generator) -> np.ndarray:
    """Draw numbers of each interval, many of them ends."""
    drawn = interval.lower + rng.random(interval.lower.shape) * (interval.upper - interval.lower)
    drawn = np.clip(drawn, interval.lower, interval.upper)
    choice = rng.integers(3, size=drawn.shape)
    return np.choose(choice, [interval.lower, interval.upper, drawn])


def numbers(rng: np.random.Generator, count: int = 600) -> np.ndarray:
    """Draw numbers of all sizes, with zeros, equal ends and numbers whose products underflow."""
    sizes = 10.0 ** rng.choice([0.0, -8.0, -160.0, 8.0], size=(2, count)) * rng.normal(
        size=(2, count)
    )
    sizes[0, : count // 10] = 0.0
    sizes[1, count // 10 : count // 5] = sizes[0, count // 10 : count // 5]
    return sizes


def angles(rng: np.random.Generator, count: int = 300) -> np.ndarray:
    drawn = rng.uniform(-QUARTER_TURN, QUARTER_TURN, size=(2, count)) * 10.0 ** rng.choice(
        [0, -1, -3, -9], size=count
    )
    drawn[:, :4] = [[0.0, 0.0, -QUARTER_TURN, QUARTER_TURN], [0.0, 0.1, QUARTER_TURN, QUARTER_TURN]]
    drawn[1, 4:40] = drawn[0, 4:40]
    return drawn


def assert_encloses(interval: Interval, exact) -> None:
    exactly = type(exact[0])  # ends go to the exact numbers, for these would be rounded to floats
    for low, value, high in zip(
        interval.lower.tolist(), exact, interval.upper.tolist(), strict=True
    ):
        assert exactly(low) <= value <= exactly(high)


@pytest.mark.parametrize(
    "operation", ["+", "-", "*", "/", "scalar +", "scalar -", "scalar *", "scalar /"]
)
def test_arithmetic_encloses_exact_arithmetic(operation):
    rng = np.random.default_rng(0)
    left = intervals(numbers(rng))
    right = intervals(numbers(rng))
    if operation == "/":
        right = Interval(
            np.abs(right.lower) + 1e-5, np.abs(right.lower) + np.abs(right.upper) + 1e-5
        )
    a = [Fraction(value) for value in members(left, rng)]
    b = [Fraction(value) for value in members(right, rng)]
    results = {
        "+": (lambda: left + right, lambda p, q: p + q),
        "-": (lambda: left - right, lambda p, q: p - q),
        "*": (lambda: left * right, lambda p, q: p * q),
        "/": (lambda: left / right, lambda p, q: p / q),
        "scalar +": (lambda: 0.3 + left, lambda p, _: Fraction(0.3) + p),
        "scalar -": (lambda: 0.3 - left, lambda p, _: Fraction(0.3) - p),
        "scalar *": (lambda: left * -0.3, lambda p, _: p * Fraction(-0.3)),
        "scalar /": (lambda: left / -0.3, lambda p, _: p / Fraction(-0.3)),
    }
    enclosure, exact = results[operation]
    assert_encloses(enclosure(), [exact(p, q) for p, q in zip(a, b, strict=True)])


def test_squares_and_reciprocals_enclose_exact_arithmetic():
    rng = np.random.default_rng(1)
    x = intervals(numbers(rng))
    chosen = [Fraction(value) for value in members(x, rng)]
    assert_encloses(square(x), [value**2 for value in chosen])
    assert (square(x).lower >= 0).all()
    away = Interval(
        *(np.abs(end) + np.array([[1e-5]]) for end in np.sort(np.abs(numbers(rng)), axis=0))
    )
    away = Interval(away.lower.ravel(), away.upper.ravel())
    chosen = [Fraction(value) for value in members(away, rng)]
    assert_encloses(reciprocal(away), [1 / value for value in chosen])
    assert_encloses(-2.0 / -away, [2 / value for value in chosen])


@each_function
def test_functions_of_an_angle_enclose_their_values_and_are_thin_at_points(function):
    rng = np.random.default_rng(2)
    x = intervals(angles(rng))
    enclosure = function(x)
    for _ in range(4):
        assert_encloses(
            enclosure, [FUNCTIONS[function](mpmath.mpf(value)) for value in members(x, rng)]
        )
    point = function(Interval(x.lower, x.lower))
    assert np.max(point.upper - point.lower) < INTERVAL_WIDTH
    values = function(x.lower)
    assert ((point.lower <= values) & (values <= point.upper)).all()


@each_function
def test_enclosures_are_no_wider_than_the_range(function):
    rng = np.random.default_rng(3)
    x = intervals(angles(rng))
    grid = function(x.lower + np.linspace(0, 1, 2001)[:, None] * (x.upper - x.lower))
    if function in (cos, sinc, sinc_curvature, lag_slope):
        ends = np.where((x.lower <= 0) & (x.upper >= 0), function(np.zeros(1)), function(x.upper))
        grid = np.vstack([grid, ends])
    enclosure = function(x)
    assert (enclosure.upper <= grid.max(axis=0) + INTERVAL_WIDTH).all()
    assert (enclosure.lower >= grid.min(axis=0) - INTERVAL_WIDTH).all()


@pytest.mark.parametrize("function", DERIVATIVES, ids=["sin", "sinc", "sinc_slope", "lag"])
def test_derivatives_are_those_of_the_textbook_forms(function):
    x = np.random.default_rng(4).uniform(-1.5, 1.5, 40)
    slope = function(Dual(x, np.ones((1, 40)))).gradient[0]
    for at, value in zip(x, slope, strict=True):
        exact = mpmath.diff(FUNCTIONS[function], mpmath.mpf(at), h=mpmath.mpf(10) ** -25)
        assert value == pytest.approx(float(exact), abs=INTERVAL_WIDTH)


def test_changes_of_sinc_enclose_their_values_and_vanish_with_the_step():
    rng = np.random.default_rng(5)
    x = intervals(angles(rng) * 0.49)
    step = intervals(angles(rng) * 0.49)
    chosen = members(x, rng)
    steps = members(step, rng)
    difference = FUNCTIONS[sinc]
    pairs = [(mpmath.mpf(a), mpmath.mpf(s)) for a, s in zip(chosen, steps, strict=True)]
    exact = [difference(a + s) - difference(a) for a, s in pairs]
    assert_encloses(sinc_change(x, step), exact)
    zeros = np.zeros(len(chosen))
    ones = np.ones((1, len(chosen)))
    still = Dual(Interval(zeros, zeros), Interval(ones * 0, ones * 0))
    change = sinc_change(Dual(x, Interval(ones, ones)), still)
    for part in (change.value, change.gradient):
        assert np.max(np.abs([part.lower, part.upper])) < INTERVAL_WIDTH


def composite(x, y, z):
    """Everything a dual number can do, once."""
    first = sin(x * y) / (2.0 + cos(y)) - square(z - x) * sinc(x) + sine_excess(y) * lag(z)
    return (
        first + sinc_change(x, y * 0.1) - 0.5 * reciprocal(3.0 + z) + (1.0 - x) / 3.0 + (-y) * 2.0
    )


def test_gradients_over_floats_are_differences():
    point = np.random.default_rng(6).uniform(-0.7, 0.7, size=(3, 50))
    step = 1e-6
    seeds = np.broadcast_to(np.eye(3)[:, :, None], (3, 3, 50))
    gradient = composite(
        *[Dual(value, seed) for value, seed in zip(point, seeds, strict=True)]
    ).gradient
    for i, shift in enumerate(np.eye(3)[:, :, None] * step):
        slope = (composite(*(point + shift)) - composite(*(point - shift))) / (2 * step)
        np.testing.assert_allclose(gradient[i], slope, rtol=0, atol=1e-8)


def test_gradients_over_intervals_enclose_those_of_their_members():
    rng = np.random.default_rng(7)
    centre = rng.uniform(-0.6, 0.6, size=(3, 200))
    radius = 10.0 ** rng.uniform(-12, -1, size=200)
    x = Interval(centre - radius, centre + radius)
    seeds = np.broadcast_to(np.eye(3)[:, :, None], (3, 3, 200))
    boxes = zip(x.lower, x.upper, seeds, strict=True)
    enclosure = composite(
        *[Dual(Interval(low, high), Interval(seed, seed)) for low, high, seed in boxes]
    )
    for _ in range(20):
        inside = composite(
            *[Dual(value, seed) for value, seed in zip(members(x, rng), seeds, strict=True)]
        )
        for part, value in ((enclosure.value, inside.value), (enclosure.gradient, inside.gradient)):
            assert (part.lower - INTERVAL_WIDTH <= value).all()
            assert (value <= part.upper + INTERVAL_WIDTH).all()
    thin = radius < 1e-9
    assert np.max(enclosure.gradient.upper[:, thin] - enclosure.gradient.lower[:, thin]) < 1e-7


def test_angles_beyond_a_quarter_turn_and_divisors_through_zero_are_refused():
    for function in FUNCTIONS:
        with pytest.raises(ValueError, match="angle"):
            function(Interval(np.array([0.0]), np.array([1.6])))
        with pytest.raises(ValueError, match="angle"):
            function(Interval(np.array([-1.6]), np.array([0.0])))
    with pytest.raises(ValueError, match="divisor"):
        reciprocal(Interval(np.array([-1.0]), np.array([1.0])))


CASES = {
    "corner": (lambda x, y: x * y - 2.0 * x, [-1.0, -1.0], [1.0, 2.0], 3.0),
    "inside": (lambda x, y: cos(x - 0.3) * cos(y + 0.1), [-0.5, -0.5], [0.6, 0.6], 1.0),
    "edge": (lambda x, y: sin(x) - square(y - 0.123), [-1.0, -1.0], [0.5, 1.0], np.sin(0.5)),
    "saddle": (lambda x, y: x * y, [-1.0, -3.0], [2.0, 1.0], 3.0),
    "twice the same": (lambda x, y: (x - x) + (y - y) + 1.0, [0.0, 0.0], [1.0, 1.0], 1.0),
    "a point": (lambda x, y: x * x * y, [0.5, 2.0], [0.5, 2.0], 0.5),
    "nowhere positive": (lambda x, y: -square(x) - square(y) - 0.25, [-1.0, 0.5], [1.0, 2.0], -0.5),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("tolerance", [0.1, 0.001])
def test_suprema_lie_between_values_found_and_bounds(case, tolerance):
    function, lower, upper, supremum = CASES[case]
    ends = (np.array([lower]).T, np.array([upper]).T)
    objectives = [(0, 1, 0), (1, 1, 1)]
    bound, found = suprema(
        lambda variables: [function(*variables), 0.0], *ends, objectives, tolerance
    )
    assert found[0] - 1e-14 <= supremum <= bound[0]
    assert bound[0] <= found[0] + tolerance * abs(found[0]) + 2e-9
    assert bound[1] == found[1] == 0.0


def test_a_group_has_the_largest_of_its_objectives():
    lower = np.array([[-1.0, 0.5]])
    upper = np.array([[1.0, 2.0]])
    objectives = [(0, 1, 0), (0, -1, 0), (1, 1, 1), (1, -1, 2)]
    bound, _ = suprema(lambda x: [x[0] - 3.0, square(x[0])], lower, upper, objectives, 0.01)
    assert bound[0] == pytest.approx(4.0, rel=0.01)
    assert bound[1] == pytest.approx(4.0, rel=0.01)
    assert bound[2] == pytest.approx(0.0, abs=1e-8)


def test_a_search_cut_short_bounds_all_the_same():
    function, lower, upper, supremum = CASES["inside"]
    bound, found = suprema(
        lambda x: [function(*x)],
        np.array([lower]).T,
        np.array([upper]).T,
        [(0, 1, 0)],
        1e-6,
        most_cells=5,
    )
    assert found[0] <= supremum <= bound[0]


def test_the_last_bits_do_not_choose_the_variable_that_is_cut():
    def bound_of(factor):
        function = lambda x: [sin(x[0]) * sin(x[1]) * factor - square(x[0] - x[1])]  # noqa: E731
        lower = np.full((2, 1), -1.0)
        bound, _ = suprema(function, lower, -lower, [(0, 1, 0)], 0.1)
        return bound[0]

    expected = bound_of(1.0)
    for bits in np.random.default_rng(0).uniform(-1e-15, 1e-15, 20):
        assert bound_of(1.0 + bits) == pytest.approx(expected, rel=1e-12)


def test_a_tolerance_that_is_not_positive_is_refused():
    with pytest.raises(ValueError, match="tolerance"):
        suprema(lambda x: [x[0]], np.zeros((1, 1)), np.ones((1, 1)), [(0, 1, 0)], 0.0)
