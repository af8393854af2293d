"""Laws of the fit of track and lever arm: exact without slips, unbiased with them, robust."""

import dataclasses

import numpy as np
import pytest
from simulated_robots import draw_windows

from jaxtube.identification.geometry import find_sideslip, find_slips, fit_geometry
from jaxtube.identification.simulated.drive import Truth

EXACT = 1e-6
UNBIASED = 0.007
"""Of the track, relative: three standard errors for 3,000 commands whose slips spread by 6 %."""

TRUTH = Truth(effective_track=0.8, lever_arm=-0.15, sideslip=0.05, slip=((-0.05, 0.15), (0.1, 0.3)))


def fit(windows, rows=slice(None)):
    spread = np.zeros_like(windows.velocity[rows])
    return fit_geometry(windows.wheels[rows], windows.velocity[rows], spread, windows.command[rows])


def test_without_spread_of_slips_track_and_lever_arm_are_exact():
    truth = dataclasses.replace(
        TRUTH, slip=((0.1, 0.1), (-0.03, -0.03)), slip_wander=0.0, sideslip=0.0
    )
    geometry = fit(draw_windows(truth, 12, 0))
    assert geometry.track == pytest.approx(0.8, rel=EXACT)
    assert geometry.lever_arm == pytest.approx(-0.15, abs=EXACT)
    assert geometry.mean_slip == pytest.approx((0.1, -0.03), abs=EXACT)
    assert geometry.explained > 1 - EXACT


def test_the_track_is_unbiased_where_a_fit_of_wheels_by_yaw_rate_shrinks_it():
    windows = draw_windows(TRUTH, 3000, 1)
    geometry = fit(windows)
    assert geometry.track == pytest.approx(TRUTH.effective_track, rel=UNBIASED)
    ground = windows.wheels * (1.0 - np.mean(TRUTH.slip, axis=1))
    difference = ground[:, 0] - ground[:, 1]
    yaw_rate = windows.velocity[:, 1]
    by_yaw_rate = difference @ yaw_rate / (yaw_rate @ yaw_rate)
    assert by_yaw_rate < TRUTH.effective_track * (1 - 2 * UNBIASED)


@pytest.mark.slow
def test_errors_are_as_large_as_the_standard_error_says():
    geometries = [fit(draw_windows(TRUTH, 40, 100 + k)) for k in range(12)]
    tracks = np.array([geometry.track for geometry in geometries])
    said = np.mean([geometry.track_error for geometry in geometries])
    seen = np.sqrt(np.mean((tracks - TRUTH.effective_track) ** 2))
    assert 0.5 < seen / said < 2.0


def test_a_few_wild_windows_do_not_move_the_track():
    windows = draw_windows(TRUTH, 60, 2)
    wild = windows.velocity.copy()
    wild[::15] += [0.5, 2.0, 0.3]
    clean = fit(windows)
    moved = fit(dataclasses.replace(windows, velocity=wild))
    assert moved.track == pytest.approx(clean.track, rel=0.05)
    assert moved.lever_arm == pytest.approx(clean.lever_arm, abs=0.03)


def test_slips_and_sideslip_are_those_that_move_the_body():
    windows = draw_windows(dataclasses.replace(TRUTH, slip_wander=0.0), 50, 3)
    slips = find_slips(windows.wheels, windows.velocity, TRUTH.effective_track)
    assert np.all(slips >= np.array(TRUTH.slip)[:, 0] - 1e-12)
    assert np.all(slips <= np.array(TRUTH.slip)[:, 1] + 1e-12)
    assert np.allclose(slips[::2], slips[1::2])
    side = find_sideslip(windows.velocity, TRUTH.lever_arm)
    assert np.abs(side).max() <= TRUTH.sideslip + 1e-12
