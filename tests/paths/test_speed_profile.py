"""Laws of speed profiles: wheels within limits, as fast as a linear program finds, laps that
close."""

import numpy as np
import pytest
from scipy.optimize import linprog

from jaxtube.paths.profile import NoSpeedError, WheelLimits, make_profile

WIDTH = 0.5


def bends(length=20.0, points=401, sharpness=0.6):
    lengths = np.linspace(0.0, length, points)
    curvature = sharpness * np.sin(lengths) ** 3
    change = 3.0 * sharpness * np.sin(lengths) ** 2 * np.cos(lengths)
    return lengths, curvature, change


def fastest_squares(lengths, curvature, change, limits):
    """Maximise the sum of x over all (x, u) at once: where each x is as large as can be."""
    points = len(lengths)
    steps = np.diff(lengths)
    shares = 1.0 + WIDTH / 2.0 * np.outer([1.0, -1.0], curvature)
    growths = WIDTH / 2.0 * np.outer([1.0, -1.0], change)
    follow = np.zeros((points - 1, 2 * points))
    rows = np.arange(points - 1)
    follow[rows, rows] = 1.0
    follow[rows, rows + 1] = -1.0
    follow[rows, points + rows] = 2.0 * steps
    blocks = [np.hstack([np.diag(g), np.diag(q)]) for q, g in zip(shares, growths, strict=True)]
    bound = np.vstack([*blocks, *[-block for block in blocks]])
    low = (limits.least / shares.min(axis=0)) ** 2
    high = (limits.greatest / shares.max(axis=0)) ** 2
    solution = linprog(
        np.append(-np.ones(points), np.zeros(points)),
        A_ub=bound,
        b_ub=np.full(len(bound), limits.acceleration),
        A_eq=follow,
        b_eq=np.zeros(points - 1),
        bounds=[*zip(low, high, strict=True), *[(None, None)] * points],
    )
    return solution.x[:points] if solution.success else None


@pytest.mark.parametrize("acceleration", [0.15, 0.3, 1.0])
def test_profiles_are_as_fast_as_a_linear_program_finds(acceleration):
    limits = WheelLimits(0.2, 1.5, acceleration, WIDTH)
    lengths, curvature, change = bends(points=201)
    wanted = np.full(len(lengths), 9.0)
    profile = make_profile(lengths, curvature, change, wanted, limits, closed=False)
    fastest = fastest_squares(lengths, curvature, change, limits)
    assert fastest is not None
    # The program's last x is bounded by its own point alone, as the profile's is.
    np.testing.assert_allclose(profile.speeds, np.sqrt(fastest), rtol=1e-6)


def test_there_is_no_profile_where_the_linear_program_finds_none():
    lengths, curvature, change = bends(points=201)
    for acceleration in (0.02, 0.05, 0.08, 0.12):
        limits = WheelLimits(0.8, 1.5, acceleration, WIDTH)
        wanted = np.full(len(lengths), 9.0)
        fastest = fastest_squares(lengths, curvature, change, limits)
        if fastest is None:
            with pytest.raises(NoSpeedError):
                make_profile(lengths, curvature, change, wanted, limits, closed=False)
        else:
            make_profile(lengths, curvature, change, wanted, limits, closed=False)


@pytest.mark.parametrize("closed", [False, True])
@pytest.mark.parametrize("acceleration", [None, 0.3])
def test_wheels_keep_their_limits_between_the_points_of_the_grid(acceleration, closed):
    limits = WheelLimits(0.2, 1.5, acceleration, WIDTH)
    lengths, curvature, change = bends(2.0 * np.pi, 2001)
    wanted = np.full(len(lengths), 1.4)
    profile = make_profile(lengths, curvature, change, wanted, limits, closed)
    times = np.linspace(0.0, profile.duration * (1.0 - 1e-9), 20_001)
    ways = profile.lengths_at(times)
    speeds = np.gradient(ways, times)
    wheels = speeds[:, None] * (1.0 + WIDTH / 2.0 * np.outer(0.6 * np.sin(ways) ** 3, [1.0, -1.0]))
    assert wheels.min() > limits.least - 1e-3 and wheels.max() < limits.greatest + 1e-3
    if acceleration is not None:
        rates = np.gradient(wheels, times, axis=0)[5:-5]
        assert np.abs(rates).max() < acceleration * 1.02
    if closed:
        assert profile.speeds[0] == pytest.approx(profile.speeds[-1], abs=1e-9)
    ahead = profile.lengths_at(times + profile.duration)
    np.testing.assert_allclose(ahead, ways + lengths[-1], atol=1e-9)


def test_the_wanted_speed_is_driven_where_it_can_be():
    limits = WheelLimits(0.2, 1.5, 0.5, WIDTH)
    lengths, curvature, change = bends(sharpness=0.3)
    wanted = np.where(lengths < 10.0, 0.5, 0.9)
    profile = make_profile(lengths, curvature, change, wanted, limits, closed=False)
    is_settled = np.abs(lengths - 10.0) > 1.5
    np.testing.assert_allclose(profile.speeds[is_settled], wanted[is_settled], rtol=1e-9)


def test_a_turn_too_sharp_for_the_box_is_refused_where_it_is():
    limits = WheelLimits(0.9, 1.5, 1.0, WIDTH)
    assert limits.sharpest_curvature == pytest.approx(2.0 * (0.6 / 2.4) / WIDTH)
    lengths, curvature, change = bends(sharpness=1.8)
    with pytest.raises(NoSpeedError) as caught:
        make_profile(lengths, curvature, change, np.ones_like(lengths), limits, closed=False)
    assert abs(np.sin(caught.value.at)) > 0.98


def test_a_box_just_as_wide_as_a_circle_asks_for_is_driven():
    lengths = np.linspace(0.0, 10.0, 101)
    curvature = np.full(101, 0.4)
    limits = WheelLimits(1.224, 1.496, 0.1, WIDTH)
    profile = make_profile(lengths, curvature, 0.0 * lengths, 9.0 + 0.0 * lengths, limits, False)
    np.testing.assert_allclose(profile.speeds, 1.36, rtol=1e-9)


def test_the_least_radius_of_a_box_that_holds_zero_is_nothing():
    assert WheelLimits(0.0, 1.0, None, WIDTH).sharpest_curvature == np.inf
