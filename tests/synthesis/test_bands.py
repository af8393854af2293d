"""Gains, caps and W by speed: one terminal set for all bands, tubes and rows by the band of each
period."""

import dataclasses

import msgspec
import numpy as np
import pytest
from tolerances import ROUNDING

from jaxtube.plant.reference import jumps
from jaxtube.scenario import ScenarioError, load
from jaxtube.synthesis.banded_estimate import BandedEstimate
from jaxtube.synthesis.certificate.bands import find_band_gap
from jaxtube.synthesis.certificate.certify import certify
from jaxtube.synthesis.certificate.exact import recheck
from jaxtube.synthesis.certificate.exact_regimes import make_exact_regimes
from jaxtube.synthesis.certificate.fill import cap_shares, widest_tube
from jaxtube.synthesis.certificate.robot import check_robot
from jaxtube.synthesis.design import finish, prepare
from jaxtube.synthesis.disturbance import complete_problem, kinematics, operation
from jaxtube.synthesis.live import LiveWindows
from jaxtube.synthesis.starts import caps_and_gains
from jaxtube.synthesis.tightening import find_back_off
from sets.exact import exact_row
from sets.robot.disturbance import evaluate_disturbance

SLOWEST = 0.85  # the two fastest bands of the scenario: W of each other one takes as long again


@pytest.fixture(scope="module")
def problem():
    scenario = load("certified_wide")
    change = msgspec.structs.replace
    reference = change(scenario.reference, wheel_speed_min_mps=SLOWEST, shape="jumps", duration_s=4)
    operating = change(scenario.operating, bands=scenario.operating.bands[4:])
    return complete_problem(change(scenario, reference=reference, operating=operating))


@pytest.fixture(scope="module")
def design(problem):
    return finish(prepare(problem))


def test_the_mpc_is_certified_for_the_robot_and_confirmed_in_rationals(design):
    assert design.certificate.failing == []
    assert recheck(design).holds
    assert any("known 8 periods" in words for words in design.certificate.assumptions)


def test_every_schedule_has_its_bands_gain(problem, design):
    schedules = np.random.default_rng(0).uniform(SLOWEST, 1.5, (50, 2))
    for schedule, gain in zip(schedules, design.tube_gain.along(schedules), strict=True):
        settings = next(
            b for b in problem.scenario.operating.bands if schedule.mean() <= b.below_mps
        )
        k1, k2, k3 = settings.tracking_gains
        yaw_rate = (schedule[0] - schedule[1]) / 0.5
        np.testing.assert_allclose(gain, [[-k1, -yaw_rate, 0], [0, -k2, -k3]], atol=ROUNDING)


def test_every_stage_keeps_the_caps_of_its_own_band(problem, design):
    """Of U, what the tube takes off comes from the rows of the band that the period is in."""
    for window, schedules in enumerate(design.windows.schedules):
        for stage, schedule in enumerate(schedules):
            band = int(schedule.mean() > problem.scenario.operating.bands[0].below_mps)
            rows = problem.regimes[band].input_rows
            on_errors = rows.on_errors(design.windows.gains[window, stage])
            taken = design.tube.support(stage, on_errors)[window]
            left = rows.offsets - taken - design.bounds.inputs[window, stage]
            backed_off = (stage + 1) * find_back_off(problem) * rows.offsets
            np.testing.assert_allclose(left, backed_off, rtol=1e-5, atol=ROUNDING)


def test_no_order_of_schedules_and_disturbances_leaves_the_terminal_set(problem, design):
    random = np.random.default_rng(1)
    omega = design.terminal.invariant
    corners = np.concatenate([band.corners for band in design.tube_gain.bands])
    errors = omega.vertices()[random.integers(len(omega.vertices()), size=4000)]
    for _ in range(40):
        at_corner = corners[random.integers(len(corners))]
        schedule = at_corner if random.random() < 0.5 else random.uniform(SLOWEST, 1.5, 2)
        W = problem.disturbances[int(problem.rule.number(schedule[None])[0])].vertices()
        loop = design.tube_gain.loops_along(schedule)
        errors = errors @ loop.T + W[random.integers(len(W), size=len(errors))]
        assert np.max(errors @ omega.normals.T / omega.offsets) <= 1 + ROUNDING


def test_one_tube_holds_all_bands_in_any_order_and_its_shares_are_told(problem, design):
    """An opponent that picks band, loop and w anew in every period, those that promise most by the
    tube itself, takes the lateral error nearly to the share that is told, and no further."""
    shares = cap_shares(problem, design.tube_gain)
    told = design.certificate.conditions["widest_tube_fits"]
    assert told.holds and told.margin == pytest.approx(1 - max(shares.values()), abs=ROUNDING)
    tube = widest_tube(problem, design.tube_gain)
    assert tube is not None
    lateral = np.array([0.0, 1.0, 0.0])
    reached = 0.0
    best = lateral.copy()
    for _ in range(60):
        steps = []  # backwards in time
        for number, gain in enumerate(design.tube_gain.bands):
            W = problem.disturbances[number]
            steps += [(W.support(best[None])[0], loop) for loop in gain.loops]
        promised = [pushed + tube.support((best @ loop)[None])[0] for pushed, loop in steps]
        pushed, loop = steps[int(np.argmax(promised))]
        reached += pushed
        best = best @ loop
    used = reached / problem.operating_set.support(lateral[None])[0]
    assert 0.95 * shares["lateral error"] <= used <= shares["lateral error"] + ROUNDING


def test_the_estimate_of_a_search_is_close_to_the_rigorous_shares(problem, design):
    rigorous = cap_shares(problem, design.tube_gain)
    values = caps_and_gains(problem.scenario)
    assert values is not None
    estimate = BandedEstimate(problem)
    point = estimate.to_point(values)
    estimated = estimate.shaped_like(point).shares(point)
    assert estimated is not None
    assert estimated.caps.max() == pytest.approx(max(rigorous.values()), rel=0.03)
    of_errors = [rigorous[f"{name} error"] for name in ("longitudinal", "lateral", "heading")]
    np.testing.assert_allclose(estimated.caps[0, :3], of_errors, rtol=0.03)


def test_disturbances_of_a_band_lie_in_its_w(problem, design):
    random = np.random.default_rng(2)
    count = 50_000
    for band, gain in zip(problem.regimes, design.tube_gain.bands, strict=True):
        where = operation(band)
        low, high = where.box
        points = random.uniform(low, high, (count, 13))
        at_ends = np.where(points > (low + high) / 2, high, low)
        points = np.where(random.random((count, 13)) < 0.5, at_ends, points)
        points[:, 5:7] = random.dirichlet(np.ones(len(gain.corners)), count) @ gain.corners
        a, b = where.coupling
        room = a * np.maximum(1 - np.abs(points[:, 4]) / b, 0)
        points[:, 0] = np.clip(points[:, 0], -room, room)
        noise = random.choice([-1, 1], (count, 3)) * where.noise
        w, _, _ = evaluate_disturbance(where, kinematics(band), points, noise)
        assert band.disturbance_set.margin(w).min() >= -ROUNDING


def test_boxes_and_corner_loops_cover_their_band(design):
    gain = design.tube_gain
    none = np.zeros((0, 1, 2))
    assert find_band_gap(gain, none, np.zeros((0, 1), int)) <= ROUNDING
    half = tuple(regions[: len(regions) // 2] for regions in gain.band_regions)
    few = dataclasses.replace(gain, band_regions=half)
    assert find_band_gap(few, none, np.zeros((0, 1), int)) == np.inf


def test_exact_corners_of_a_band_are_those_of_its_polygon(problem, design):
    for regime, gain in zip(make_exact_regimes(problem), design.tube_gain.bands, strict=True):
        assert all(regime.room_of(exact_row(corner)) >= -1e-15 for corner in gain.corners)
        outside = gain.corners.mean(axis=0) + np.array([0.4, 0.4])
        assert regime.room_of(exact_row(outside)) < 0
        exact = np.array(regime.every_loop, float)
        for loop in gain.loops_along(gain.corners):
            assert np.all(loop >= exact.min(axis=0) - ROUNDING)
            assert np.all(loop <= exact.max(axis=0) + ROUNDING)


@pytest.mark.parametrize("number", [0, -1])
def test_a_wider_w_in_one_band_breaks_the_certificate(design, problem, number):
    wide = problem.regimes[number].disturbance_set.scale(1.5)
    failing = set(certify(with_band(design, number, disturbance_set=wide)).failing)
    assert failing >= {"terminal_set_invariant", "tightening_covers_reach"}


@pytest.mark.parametrize("number", [0, -1])
def test_the_w_of_every_band_must_be_proved(design, problem, number):
    narrow = problem.regimes[number].disturbance_set.scale(0.98)
    conditions = check_robot(with_band(design, number, disturbance_set=narrow).problem)
    assert [each.name for each in conditions if not each.holds] == ["disturbance_bound_proved"]


def test_the_wheels_of_every_band_are_checked(design, problem):
    """Inputs of the fastest band that are half as wide again ask for more than the wheels have."""
    band = problem.regimes[-1]
    rows = dataclasses.replace(band.input_rows, offsets=1.5 * band.input_rows.offsets)
    wider = {"input_rows": rows, "input_set": band.input_set.scale(1.5)}
    faster = with_band(design, -1, **wider, regions=band.regions[-1:])
    conditions = {each.name: each for each in check_robot(faster.problem)}
    assert not conditions["wheel_limits"].holds


def test_stages_in_another_band_than_their_wheel_speeds_say_are_found_out(design):
    windows = dataclasses.replace(design.windows, regimes=1 - design.windows.regimes)
    failing = certify(dataclasses.replace(design, windows=windows)).failing
    assert "plans_keep_these_sets" in failing


def with_band(design, number: int, **parts):
    """Return the design with parts of one band's problem replaced."""
    regimes = list(design.problem.regimes)
    regimes[number] = dataclasses.replace(regimes[number], **parts)
    problem = dataclasses.replace(design.problem, regimes=tuple(regimes))
    return dataclasses.replace(design, problem=problem)


def test_wheel_speeds_that_jump_stay_in_their_box_and_reach_its_corners():
    reference = jumps(0.2, 1.5, 30.0, 0.1, 6, 0.5, seed=1)
    assert reference.steps == 300 and len(reference.wheels) == 306
    assert reference.wheels.min() >= 0.2 - ROUNDING and reference.wheels.max() <= 1.5 + ROUNDING
    assert len(np.unique(reference.wheels.round(9), axis=0)) > 20
    at_end = np.abs(reference.wheels - 0.85) > 0.65 - ROUNDING
    assert np.mean(np.all(at_end, axis=1)) > 0.2
    other = jumps(0.2, 1.5, 30.0, 0.1, 6, 0.5, seed=2)
    assert not np.array_equal(other.wheels, reference.wheels)
    longer = jumps(0.2, 1.5, 40.0, 0.1, 10, 0.5, seed=1)
    np.testing.assert_array_equal(longer.wheels[: len(reference.wheels)], reference.wheels)


@pytest.mark.parametrize(
    "override, words",
    [
        ("reference.wheel_speed_max_mps=1.6", "let below_mps grow"),
        ("disturbance.bound=assumed", "need a computed bound"),
        ("controller.tracking_gains=[1.0, 1.0, 1.0]", "bring their own"),
        ("controller.tube=summed", "by speed"),
        ("controller.restart=false", "restart = true"),
    ],
)
def test_bands_that_do_not_fit_are_refused(override, words):
    with pytest.raises(ScenarioError, match=words) as refused:
        load("certified_wide", [override])
    assert "\n" not in str(refused.value)


def test_a_governor_may_revise_speeds_over_all_bands(problem, design):
    np.testing.assert_array_equal(LiveWindows(design).box, np.array(problem.model.box))
