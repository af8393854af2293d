"""Slip bounds hold every slip of a scenario, and their extremes reach every relative error of the
ground speeds."""

from fractions import Fraction

import jax.numpy as jnp
import numpy as np
import pytest
from tolerances import ROUNDING

from jaxtube.plant.slip_bounds import compensated_slips, near_nominal, slip_bounds
from jaxtube.scenario.tree import Slip
from sets.robot.disturbance import wheel_error_bound, wheel_error_range

INTERVALS = (((0.1, 0.3), (-0.05, 0.12)), ((-0.3, -0.1), (-0.02, 0.4)), ((0.0, 0.0), (0.2, 0.2)))
ERRORS = ({}, {"measurement_error": 0.03}, {"measurement_error_relative": 0.1})
BOTH_ERRORS = {"measurement_error": 0.02, "measurement_error_relative": 0.2}


def draw(slip, count=20_000):
    random = np.random.default_rng(3)
    true, measured = random.uniform(-1, 1, (2, count, 2))
    bounds = slip_bounds(slip)
    return np.asarray(bounds.true_slip(true)), np.asarray(bounds.measured_slip(true, measured))


@pytest.mark.parametrize("ends", INTERVALS)
@pytest.mark.parametrize("errors", [*ERRORS, BOTH_ERRORS])
def test_relative_errors_of_ground_speeds_are_extreme_at_the_extremes_of_slips(ends, errors):
    slip = Slip(right=ends[0], left=ends[1], **errors)
    true, measured = draw(slip)
    drawn = (true - measured) / (1 - measured)
    low, high = wheel_error_range(slip_bounds(slip).extremes())
    assert np.all(drawn >= low) and np.all(drawn <= high)
    span = np.maximum(high - low, ROUNDING)
    np.testing.assert_allclose(drawn.min(axis=0), low, atol=0.03 * span.max())
    np.testing.assert_allclose(drawn.max(axis=0), high, atol=0.03 * span.max())
    least, greatest = compensated_slips(slip)
    assert np.all(measured >= least - ROUNDING) and np.all(measured <= greatest + ROUNDING)


@pytest.mark.parametrize("ends", INTERVALS)
def test_true_slips_fill_their_intervals_and_measured_ones_stay_within_their_error(ends):
    slip = Slip(right=ends[0], left=ends[1], **BOTH_ERRORS)
    true, measured = draw(slip)
    intervals = np.array(ends)
    assert np.all(true >= intervals[:, 0] - ROUNDING)
    assert np.all(true <= intervals[:, 1] + ROUNDING)
    room = 0.02 + 0.2 * np.abs(true) - np.abs(measured - true)
    assert room.min() >= -ROUNDING
    assert room.min() < 1e-4


@pytest.mark.parametrize("uncertain_slip", ["true", "measured", "both"])
def test_slips_near_nominal_ones_deviate_by_the_relative_error(uncertain_slip):
    nominal = np.array([0.2, 0.1])
    bounds = near_nominal(nominal, 0.1, uncertain_slip)
    deviations = jnp.array([[1.0, -1.0], [0.0, 0.5]])
    expected = nominal * (1 + 0.1 * np.asarray(deviations))
    still = np.broadcast_to(nominal, (2, 2))
    true = bounds.true_slip(deviations)
    measured = bounds.measured_slip(deviations, deviations)
    varies = uncertain_slip in ("true", "both")
    np.testing.assert_allclose(true, expected if varies else still, atol=ROUNDING)
    varies = uncertain_slip in ("measured", "both")
    np.testing.assert_allclose(measured, expected if varies else still, atol=ROUNDING)
    greatest = np.abs(wheel_error_range(bounds.extremes())).max(axis=0)
    np.testing.assert_allclose(
        greatest, wheel_error_bound(nominal, 0.1, uncertain_slip), rtol=1e-12
    )


def test_an_interval_is_compensated_by_its_middle_unless_a_nominal_slip_is_given():
    intervals = {"right": (0.1, 0.3), "left": (-0.1, 0.0)}
    assert Slip(**intervals).nominal == pytest.approx((0.2, -0.05))
    assert Slip(**intervals, nominal_right=0.15).nominal == pytest.approx((0.15, -0.05))


@pytest.mark.parametrize("reading", ["true", "measured", "both"])
def test_no_rounding_makes_the_bound_of_wheel_errors_too_small(reading):
    """Compared with fractions, for small errors of slips that are no round numbers."""
    random = np.random.default_rng(8)
    for slip, share in random.uniform([0.02, 1e-4], [0.5, 1e-2], (200, 2)):
        nominal = Fraction(slip)
        ends = [nominal * (1 - Fraction(share)), nominal * (1 + Fraction(share))]
        true = [nominal] if reading == "measured" else ends
        measured = [nominal] if reading == "true" else ends
        largest = max(abs(i - j) / (1 - j) for i in true for j in measured)
        bound = Fraction(wheel_error_bound(np.array([slip, slip]), share, reading)[0])
        assert largest <= bound <= largest * (1 + Fraction(1, 10**14))


def test_no_rounding_makes_an_interval_of_slip_too_small():
    random = np.random.default_rng(9)
    for low, width in random.uniform([-0.3, 1e-5], [0.3, 1e-3], (200, 2)):
        high = low + width
        slip = Slip(right=(low, high), left=(low, high), nominal_right=low, nominal_left=low)
        least, greatest = wheel_error_range(slip_bounds(slip).extremes())
        exact = (Fraction(high) - Fraction(low)) / (1 - Fraction(low))
        assert Fraction(least[0]) <= 0
        assert exact <= Fraction(greatest[0]) <= exact + Fraction(1, 10**14)
