"""Laws of exact loops: enclosures hold many digits, and loops are those of the sampled robot."""

import math
from fractions import Fraction
from itertools import product

import mpmath
import numpy as np
import pytest
from exact_problem import (
    BOX,
    DT,
    FAST,
    FEEDBACKS,
    GAINS,
    LOOPS,
    OMEGA,
    SLOW,
    WIDTH,
    W,
    floats,
    maximal,
)
from tolerances import EXACT_AGAINST_FLOAT

from sets.exact import exact_invariance_margin, exact_row
from sets.robot.exact_tube import exact_vertex_loops, exact_wheel_loops, schedule_box, tangent_ratio

EXACT_ENCLOSURE = 2.0**-76
"""A few steps of the grid of 2^-80 on which enclosures are rounded."""
EXACT_JACOBIAN = 1e-8
"""Central differences with steps of 1e-5."""
EXACT_WHEEL_TRAVEL = 1e-3
"""In m; what a period's turn, at most 0.13 rad here, adds to the way of a wheel."""


@pytest.mark.parametrize("x", [0.0, 1e-9, 0.0272, -0.3, 0.77, 1.0, -1.0])
def test_the_tangent_ratio_lies_in_its_enclosure_and_fills_it(x):
    low, high = tangent_ratio(Fraction(x))
    with mpmath.workdps(60):
        value = mpmath.tan(x) / mpmath.mpf(x) if x else mpmath.mpf(1)
        assert (
            mpmath.mpf(low.numerator) / low.denominator
            <= value
            <= mpmath.mpf(high.numerator) / high.denominator
        )
    assert 0 <= high - low <= EXACT_ENCLOSURE


def turn_and_advance(right: float, left: float):
    V = (mpmath.mpf(right) + left) / 2
    x = mpmath.mpf(DT) * (mpmath.mpf(right) - left) / (2 * mpmath.mpf(WIDTH))
    return mpmath.tan(x), DT * V * (mpmath.tan(x) / x if x else 1)


@pytest.mark.parametrize(
    ("lower", "upper"),
    [((SLOW, SLOW), (FAST, FAST)), ((0.2, 0.2), (1.5, 1.5)), ((-1.0, 0.3), (0.5, 0.3))],
)
def test_the_schedule_box_is_the_range_over_all_wheel_speeds(lower, upper):
    box = schedule_box(lower, upper, DT, WIDTH)
    schedules = np.vstack([
        np.random.default_rng(0).uniform(lower, upper, size=(300, 2)),
        list(product(*zip(lower, upper, strict=True))),
    ])  # fmt: skip
    with mpmath.workdps(60):
        found = np.array([turn_and_advance(*schedule) for schedule in schedules.tolist()])
        for values, bounds in zip(found.T, (box.turn, box.advance), strict=True):
            low = mpmath.mpf(bounds[0].numerator) / bounds[0].denominator
            high = mpmath.mpf(bounds[1].numerator) / bounds[1].denominator
            assert low <= min(values)
            assert max(values) <= high
            assert max(min(values) - low, high - max(values)) <= EXACT_ENCLOSURE
    rates = (schedules[:, 0] - schedules[:, 1]) / WIDTH
    np.testing.assert_allclose(
        floats(box.yaw_rate), [rates.min(), rates.max()], rtol=EXACT_AGAINST_FLOAT
    )


def test_a_reversed_box_a_long_period_and_what_is_not_a_number_are_refused():
    with pytest.raises(ValueError, match="lower"):
        schedule_box((1.0, 1.2), (1.1, 1.1), DT, WIDTH)
    with pytest.raises(ValueError, match="dt"):
        schedule_box((0.2, 0.2), (1.5, 1.5), 0.4, WIDTH)
    with pytest.raises(ValueError, match="x: half a turn"):
        tangent_ratio(Fraction(101, 100))
    with pytest.raises(ValueError, match="upper"):
        schedule_box((0.2, 0.2), (1.5, math.nan), DT, WIDTH)


def test_loops_are_the_model_under_its_feedback_whatever_the_yaw_rate():
    T = Fraction(DT)
    k = exact_row(GAINS)
    for (h, c), loop in zip(product(BOX.turn, BOX.advance), LOOPS, strict=True):
        for rate in (*BOX.yaw_rate, Fraction(7, 3)):
            A = np.array([[1, T * rate, 0], [-2 * h, 1 - h * T * rate, c], [0, 0, 1]], dtype=object)
            B = np.array([[T, 0], [-h * T, c * T / 2], [0, T]], dtype=object)
            gain = np.array([[-k[0], -rate, 0], [0, -k[1], -k[2]]], dtype=object)
            assert np.all(A + B @ gain == np.array(loop, dtype=object))
    assert {feedback[0][1] for feedback in FEEDBACKS} == {-rate for rate in BOX.yaw_rate}


def travels(loop) -> tuple[Fraction, Fraction]:
    """Read p, q = c +- b h off a loop."""
    h = -loop[1][0] / (2 - Fraction(DT) * Fraction(GAINS[0]))
    c = loop[1][2] / (1 - Fraction(DT) * Fraction(GAINS[2]) / 2)
    return c + Fraction(WIDTH) * h, c - Fraction(WIDTH) * h


@pytest.mark.parametrize(
    ("lower", "upper"),
    [((SLOW, SLOW), (FAST, FAST)), ((-0.5, 0.3), (0.5, 0.3)), ((0.2, 1.0), (0.4, 1.5))],
)
def test_loops_of_the_wheels_cover_every_schedule_of_the_box_closely(lower, upper):
    vertices = [travels(loop) for loop in exact_wheel_loops(GAINS, lower, upper, DT, WIDTH)]
    corners = list(product(*zip(lower, upper, strict=True)))
    schedules = np.vstack([np.random.default_rng(5).uniform(lower, upper, size=(100, 2)), corners])
    found = []
    for schedule in schedules:
        found += [
            travels(loop)
            for loop in exact_vertex_loops(GAINS, schedule_box(schedule, schedule, DT, WIDTH), DT)
        ]
    for inside, bounds in zip(zip(*found, strict=True), zip(*vertices, strict=True), strict=True):
        assert min(bounds) <= min(inside) + Fraction(EXACT_ENCLOSURE)
        assert max(inside) <= max(bounds) + Fraction(EXACT_ENCLOSURE)
        assert min(inside) - min(bounds) <= EXACT_WHEEL_TRAVEL
        assert max(bounds) - max(inside) <= EXACT_WHEEL_TRAVEL
    assert len(set(vertices)) == 4


def test_loops_of_the_wheels_leave_a_larger_invariant_set_than_turn_and_speed_apart():
    loops = exact_wheel_loops(GAINS, (SLOW, SLOW), (FAST, FAST), DT, WIDTH)
    assert exact_invariance_margin(OMEGA.normals, OMEGA.offsets, loops, W) > 0
    assert maximal(floats(loops), 1e-10).volume() > OMEGA.volume()


def sampled_step(error: np.ndarray, right: float, left: float) -> np.ndarray:
    """Move robot and reference along their arcs for a period; the speed makes the first row of the
    model exact."""
    V = (right + left) / 2
    rate = (right - left) / WIDTH
    speed_deficit = -GAINS[0] * error[0] - rate * error[1]
    a = DT * (rate + GAINS[1] * error[1] + GAINS[2] * error[2])
    chord = (
        np.exp(1j * error[2]) * V * (np.exp(1j * DT * rate) - 1) / (1j * rate)
        if rate
        else DT * V * np.exp(1j * error[2])
    )
    planar = (
        complex(error[0], error[1]) + chord
    )  # the reference after the period, in the frame of the robot before
    wanted = error[0] + DT * rate * error[1] + DT * speed_deficit
    advanced = (
        np.exp(-1j * a) * planar
    ).real - wanted  # T v sin(a)/a, what the robot covers in its new frame
    moved = advanced / (np.sin(a) / a) * (np.exp(1j * a) - 1) / (1j * a) if a else advanced
    after = np.exp(-1j * a) * (planar - moved)
    return np.array([after.real, after.imag, error[2] + DT * rate - a])


@pytest.mark.parametrize("wheels", [(FAST, SLOW), (SLOW, FAST), (1.3, 1.29)])
def test_the_loop_is_the_jacobian_of_the_sampled_robot(wheels):
    here = schedule_box(wheels, wheels, DT, WIDTH)
    steps = 1e-5 * np.eye(3)
    columns = [
        (sampled_step(step, *wheels) - sampled_step(-step, *wheels)) / 2e-5 for step in steps
    ]
    np.testing.assert_allclose(
        np.transpose(columns), floats(exact_vertex_loops(GAINS, here, DT))[0], atol=EXACT_JACOBIAN
    )
