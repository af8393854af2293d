"""Laws of smooth curves: what fits keep and lose, closed ones, nearest points, widened turns."""

import numpy as np
import pytest
from made_paths import add_noise, circle, drive
from test_cleaning import raw_of

from jaxtube.paths.closing import close
from jaxtube.paths.fitting import degrees_of_freedom, limit_curvature, make_fitting
from jaxtube.paths.pieces import cut_path
from jaxtube.paths.smoothing import smooth

RADIUS = 2.5
LAP = 2.0 * np.pi * RADIUS


def points_on_circle(count=300):
    angle = 2.0 * np.pi * np.arange(count) / count
    return RADIUS * np.column_stack([np.sin(angle), 1.0 - np.cos(angle)]), RADIUS * angle


def test_a_closed_fit_of_a_circle_is_that_circle_up_to_its_gain():
    positions, lengths = points_on_circle()
    for smoothing in (0.1, 0.5, 1.0):
        curve = make_fitting(positions, lengths, smoothing, LAP).solve()
        gain = 1.0 / (1.0 + (smoothing / RADIUS) ** 6)
        samples = curve.at(np.linspace(-3.0, curve.length + 3.0, 500))
        np.testing.assert_allclose(samples.curvature, 1.0 / (gain * RADIUS), rtol=2e-4)
        np.testing.assert_allclose(samples.curvature_change, 0.0, atol=1e-4)
        assert curve.length == pytest.approx(gain * LAP, rel=1e-4)


def test_headings_and_curvatures_are_derivatives_of_positions():
    positions, lengths = points_on_circle()
    positions = positions * [1.0, 0.6]
    curve = make_fitting(positions, lengths, 0.3, LAP).solve()
    step = 1e-4
    at = np.linspace(0.5, curve.length - 0.5, 50)
    before, here, after = (curve.at(at + offset) for offset in (-step, 0.0, step))
    tangents = (after.positions - before.positions) / (2.0 * step)
    np.testing.assert_allclose(np.linalg.norm(tangents, axis=1), 1.0, atol=1e-5)
    np.testing.assert_allclose(np.cos(here.headings), tangents[:, 0], atol=1e-5)
    np.testing.assert_allclose(np.sin(here.headings), tangents[:, 1], atol=1e-5)
    turning = (after.headings - before.headings) / (2.0 * step)
    np.testing.assert_allclose(here.curvature, turning, atol=1e-4)
    change = (after.curvature - before.curvature) / (2.0 * step)
    np.testing.assert_allclose(here.curvature_change, change, atol=1e-3)


def test_a_closed_curve_goes_on_smoothly_over_its_start():
    positions, lengths = points_on_circle()
    curve = make_fitting(positions * [1.0, 0.5], lengths, 0.3, LAP).solve()
    end, start = (curve.at(np.array([length])) for length in (curve.length, 0.0))
    np.testing.assert_allclose(end.positions, start.positions, atol=1e-9)
    np.testing.assert_allclose(end.headings, start.headings + 2.0 * np.pi, atol=1e-9)
    np.testing.assert_allclose(end.curvature, start.curvature, atol=1e-8)
    np.testing.assert_allclose(end.curvature_change, start.curvature_change, atol=1e-7)


def test_white_noise_leaves_as_much_as_there_are_degrees_of_freedom():
    """The trace of a smoother is the mean of n . smoothed n over unit noise (Hutchinson 1990)."""
    lengths = np.linspace(0.0, 40.0, 801)
    random = np.random.default_rng(0)
    for smoothing in (0.2, 1.0):
        traces = []
        for _ in range(40):
            noise = random.choice([-1.0, 1.0], size=(801, 2))
            curve = make_fitting(noise, lengths, smoothing).solve()
            traces.append(np.sum(curve.spline(lengths) * noise) / 2.0)
        expected = degrees_of_freedom(40.0, smoothing)
        assert np.mean(traces) == pytest.approx(expected, rel=0.06)


def test_nearest_points_are_nearest():
    positions, lengths = points_on_circle()
    curve = make_fitting(positions, lengths, 0.2, LAP).solve()
    random = np.random.default_rng(3)
    angle = random.uniform(0.0, 2.0 * np.pi, 100)
    ring = RADIUS * random.uniform(0.8, 1.3, 100)
    points = np.column_stack([ring * np.sin(angle), RADIUS - ring * np.cos(angle)])
    found = curve.project(points, (RADIUS * angle + random.normal(0.0, 0.2, 100)) % LAP)
    distances = np.linalg.norm(points - curve.spline(found), axis=1)
    np.testing.assert_allclose(distances, np.abs(ring - RADIUS), atol=3e-4)


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_smoothing_takes_the_noise_and_leaves_the_drive(noise):
    made = drive(rate=20.0)
    piece = cut_path(raw_of(add_noise(made, noise)), 0.5, through_stops=False).pieces[0]
    fit = next(smooth(piece, None, 0.1, np.inf))
    true = made[1]
    parameters = fit.curve.project(true, fit.rows)
    off = np.linalg.norm(true - fit.curve.spline(parameters), axis=1)
    # A third of the noise at the most, where 0.02 m of noise leave 0.06 m between rows.
    assert np.sqrt(np.mean(off**2)) < 0.35 * noise + 1e-4
    assert fit.curve.length == pytest.approx(24.0, abs=0.15)


def test_curves_grow_smoother_and_closed_ones_stay_closed():
    piece = cut_path(raw_of(add_noise(circle(), 0.01)), 0.5, through_stops=False).pieces[0]
    closed = close(piece, 0.5)
    assert closed is not None
    fits = list(smooth(closed.piece, closed.gap, 0.1, np.inf))
    assert len(fits) > 2 and all(fit.curve.closed for fit in fits)
    assert (np.diff([fit.smoothing for fit in fits]) > 0.0).all()


def test_a_sharp_turn_is_widened_to_the_radius_asked_for_and_no_further():
    made = drive(((4, 0, 0), (1, 0, 0.44), (2, 0.44, 0.44), (1, 0.44, 0), (4, 0, 0)))
    lengths = 0.1 * np.arange(len(made[1]))
    fitting = make_fitting(made[1], lengths, 0.5)
    curve = fitting.solve()
    assert curve.sharpest > 0.43
    widened = limit_curvature(fitting, curve, 0.4, 0.5)
    assert 0.39 < widened.sharpest <= 0.4
    off = made[1] - widened.spline(widened.project(made[1], lengths))
    assert np.linalg.norm(off, axis=1).max() < 0.05
    assert limit_curvature(fitting, curve, 0.5, 0.5) is curve
