"""Laws of the checker's arithmetic and motion: against mpmath, and the plant in the world frame."""

import random
from fractions import Fraction

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxtube.synthesis.proof_search import load_checker

intervals = load_checker("check_intervals.py")
motion = load_checker("check_motion.py")
plans = load_checker("check_plans.py")
sets_of_errors = load_checker("check_sets.py")
ONE = intervals.ONE

FUNCTIONS = {
    "SINE": mpmath.sin,
    "COSINE": mpmath.cos,
    "EXCESS": lambda x: mpmath.sin(x) - x,
    "C": lambda x: mpmath.sin(x) / x if x else mpmath.mpf(1),
    "D": lambda x: (1 - mpmath.cos(x)) / x if x else mpmath.mpf(0),
}
WIDEST_ENCLOSURE = 64
"""Units, of 2^-56, that an enclosure at a point may be wide."""
DIFFERENCE = 1e-13
"""Motions of the world frame, in floats."""

angles = st.integers(-ONE, ONE)


@pytest.mark.parametrize("name", FUNCTIONS)
@given(at=angles)
def test_series_enclose_functions_and_are_tight(name, at):
    with mpmath.workdps(40):
        value = FUNCTIONS[name](mpmath.mpf(at) / ONE) * ONE
        low, high = getattr(intervals, name).value((at, at))
        assert low <= value <= high
        assert high - low <= WIDEST_ENCLOSURE


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("order", [1, 2])
@given(at=st.integers(-ONE + ONE // 100, ONE - ONE // 100))
def test_series_enclose_derivatives(name, order, at):
    with mpmath.workdps(60):
        if abs(at) < ONE // 1000:
            return  # where differences of a quotient lose digits
        value = mpmath.diff(FUNCTIONS[name], mpmath.mpf(at) / ONE, order) * ONE
        low, high = intervals.add_up(getattr(intervals, name).tables[order], (at, at))
        assert low - 1 <= value <= high + 1


@given(ends=st.tuples(angles, angles).map(sorted), share=st.fractions(0, 1))
def test_series_of_intervals_hold_those_of_their_points(ends, share):
    at = ends[0] + int((ends[1] - ends[0]) * share)
    for name in FUNCTIONS:
        for table in getattr(intervals, name).tables:
            low, high = intervals.add_up(table, tuple(ends))
            least, most = intervals.add_up(table, (at, at))
            assert low <= most and least <= high


def test_angles_beyond_the_series_are_refused():
    with pytest.raises(intervals.Refused, match="1 rad"):
        intervals.SINE.value((0, ONE + 1))


@given(
    left=st.tuples(angles, angles).map(sorted),
    right=st.tuples(angles, angles).map(sorted),
    shares=st.tuples(st.fractions(0, 1), st.fractions(0, 1)),
)
def test_products_of_intervals_hold_products_and_are_tight(left, right, shares):
    low, high = intervals.multiply(left, right)
    ends = [Fraction(a * b, ONE) for a in left for b in right]
    assert low <= min(ends) < low + 1 and high - 1 < max(ends) <= high
    a = left[0] + (left[1] - left[0]) * shares[0]
    b = right[0] + (right[1] - right[0]) * shares[1]
    assert low <= a * b / ONE <= high


ROBOT = (Fraction(1, 10), Fraction(1, 2), Fraction(-3, 100), Fraction(7, 100), Fraction(2, 5))
"""Period, track, lever arm, lean, share of what is not predicted."""
PIECE = (Fraction(1), Fraction(0), None, None)
CENTRE = (0.0, 0.0, 0.0, 0.05, 0.0, 1.3, 1.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
WIDTHS = (0.15, 0.2, 0.3, 0.4, 1.0, 0.2, 0.2, 0.03, 0.03, 0.05, 0.01, 0.01, 0.01)


def draw_variables(seed):
    source = random.Random(seed)
    return [c + w * source.uniform(-1, 1) for c, w in zip(CENTRE, WIDTHS, strict=True)]


def place(values):
    """Return the cell of a point."""
    return [intervals.scale(Fraction(value)) for value in values]


def find_world_motion(values):
    """Return motions by name from the poses of robot and reference in the world frame."""
    x, y, th, u1, u2, right, left, d_r, d_l, zeta, n_x, n_y, n_th = values
    T, b, lever, lean, taken = map(float, ROBOT)

    def drive(speed, rate, sideways):
        half = T * rate / 2
        return T * (speed + 1j * sideways) * np.sinc(half / np.pi) * np.exp(1j * half)

    reference = drive((right + left) / 2, (right - left) / b, 0.0)
    rate = (right - left) / b - u2

    def find_error(start, heading, turned, way):
        """Return the error, in the robot's frame, of a robot that starts at -start."""
        place = -start * np.exp(-1j * heading) + way * np.exp(-1j * heading)
        turn = -heading + turned
        return (reference - place) * np.exp(-1j * turn)

    def lead(speed):
        return find_error(x + 1j * y, th, T * rate, drive(speed, rate, 0.0))

    def miss(speed):
        return lead(speed).real - (x + T * (right - left) / b * y + T * u1)

    speed = -miss(0.0) / (miss(1.0) - miss(0.0))
    ground_right = (speed + b * rate / 2) * (1 - d_r)
    ground_left = (speed - b * rate / 2) * (1 - d_l)
    true_speed = (ground_right + ground_left) / 2
    true_rate = (ground_right - ground_left) / b
    way = drive(true_speed, true_rate, zeta * true_speed - lever * true_rate)
    expected = lead(speed)
    after = find_error(x - n_x + 1j * (y - n_y), th - n_th, T * true_rate, way)
    stage = plans.make_stage(
        {"period": ROBOT[0], "track": ROBOT[1]},
        {"gains": (0, 0, 0)},
        Fraction(right),
        Fraction(left),
    )
    M, B = (
        np.array([[low / ONE for low, _ in row] for row in matrix], float) for matrix in stage[:2]
    )
    predicted = M @ [x, y, th] + B @ [u1, u2]
    of_model = y - T * (right - left) / b * x + T * (right + left) / 2 * th
    kick = T * (rate - true_rate)
    estimated = expected.imag + taken * (after.imag - expected.imag)
    return {
        "x": after.real - predicted[0],
        "unpredicted y": after.imag - expected.imag,
        "y": estimated - predicted[1] - lean * kick,
        "y of the model": estimated - of_model - lean * kick,
        "kick": kick,
        "right": T * (speed + b * rate / 2),
        "left": T * (speed - b * rate / 2),
    }


WIDE = [(-ONE, ONE)] * len(WIDTHS)
"""A cell of variables none of which is known to be zero."""


def note(output):
    return motion.note_motion(output, WIDE, ROBOT, PIECE)


@pytest.mark.parametrize("seed", range(20))
def test_motions_are_those_of_poses_in_the_world_frame(seed):
    values = draw_variables(seed)
    for output, expected in find_world_motion(values).items():
        low, high = note(output).follow(place(values))[-1]
        assert abs(low / ONE - expected) < DIFFERENCE
        assert 0 <= high - low < 10_000


@pytest.mark.parametrize("output", ["x", "y", "unpredicted y", "kick", "right", "left"])
def test_formulas_without_the_variables_that_are_zero_are_the_same(output):
    values = draw_variables(0)
    values[-4:] = [0.0] * 4
    cell = place(values)
    straight = (*ROBOT[:2], Fraction(0), *ROBOT[3:])
    whole = motion.note_motion(output, WIDE, straight, PIECE)
    short = motion.note_motion(output, cell, straight, PIECE)
    assert len(short.steps) <= len(whole.steps)
    ends = (*whole.follow(cell)[-1], *short.follow(cell)[-1])
    assert max(ends) - min(ends) < 10_000


@pytest.mark.parametrize(
    "output", ["x", "y", "y of the model", "unpredicted y", "kick", "right", "left"]
)
def test_slopes_hold_differences_of_a_motion(output):
    formula = note(output)
    for seed in range(10):
        values = draw_variables(seed)
        ends = [(value, value + width / 50) for value, width in zip(values, WIDTHS, strict=True)]
        cell = [(intervals.scale(Fraction(a))[0], intervals.scale(Fraction(b))[1]) for a, b in ends]
        slopes = formula.find_slopes(cell, 1)
        start = formula.follow([(low, low) for low, _ in cell])[-1]
        for index, (least, most) in enumerate(slopes):
            moved = [(high if i == index else low,) * 2 for i, (low, high) in enumerate(cell)]
            end = formula.follow(moved)[-1]
            step = Fraction(cell[index][1] - cell[index][0], ONE)
            assert least * step <= end[1] - start[0]
            assert end[0] - start[1] <= most * step


@pytest.mark.parametrize("output", ["x", "y", "y of the model", "unpredicted y", "kick"])
@pytest.mark.parametrize("sign", [1, -1])
def test_bounds_of_cells_hold_all_their_motions(output, sign):
    formula = note(output)
    source = random.Random(0)
    for seed in range(5):
        values = draw_variables(seed)
        pairs = zip(values, WIDTHS, strict=True)
        cell = [
            (intervals.scale(Fraction(v))[0], intervals.scale(Fraction(v + w / 5))[1])
            for v, w in pairs
        ]
        slopes = formula.find_slopes(cell, sign)
        shrunk = motion.shrink(cell, slopes)
        highest = motion.bound(formula, sign, shrunk, slopes)
        for _ in range(40):
            point = [
                (source.choice((low, high, source.randint(low, high))),) * 2 for low, high in cell
            ]
            ends = formula.follow(point)[-1]
            assert min(sign * end for end in ends) <= highest


ZEROS = [[Fraction(0)] * 3 for _ in range(3)]
IDENTITY = [[Fraction(int(i == j)) for j in range(3)] for i in range(3)]
SMALL_INPUTS = [[Fraction(1, 100), Fraction(0)], [Fraction(0), Fraction(1, 100)]]


def fraction_matrix(factor, matrix):
    return [[Fraction(factor) * entry for entry in row] for row in matrix]


@pytest.mark.parametrize(
    "cost",
    [
        {"P": ZEROS, "Q": ZEROS, "R": fraction_matrix(0, SMALL_INPUTS)},
        {"P": ZEROS, "Q": fraction_matrix(-1, IDENTITY), "R": SMALL_INPUTS},
        {"P": IDENTITY, "Q": ZEROS, "R": fraction_matrix(-1, SMALL_INPUTS)},
    ],
)
def test_a_cost_that_is_none_is_refused(cost):
    """An unstable loop may decrease it as much as it likes."""
    loop = fraction_matrix(2, IDENTITY)
    gain = [[Fraction(0)] * 3] * 2
    with pytest.raises(intervals.Refused, match="cost"):
        sets_of_errors.check_cost({"cost": cost}, [(loop, gain)])


def test_a_cost_that_decreases_passes_and_one_that_does_not_is_refused():
    """0.5 e under P = 2 I, Q = I: 2 - 0.5 - 1 = 0.5 is left; under 0.9 e 2 - 1.62 - 1 < 0."""
    gain = [[Fraction(0)] * 3] * 2
    cost = {"P": fraction_matrix(2, IDENTITY), "Q": IDENTITY, "R": SMALL_INPUTS}
    sets_of_errors.check_cost({"cost": cost}, [(fraction_matrix(Fraction(1, 2), IDENTITY), gain)])
    with pytest.raises(intervals.Refused, match="decrease"):
        loop = fraction_matrix(Fraction(9, 10), IDENTITY)
        sets_of_errors.check_cost({"cost": cost}, [(loop, gain)])
