"""Gains, caps and disturbance sets by speed: one invariant set for all bands, in any order."""

import dataclasses

import msgspec
import numpy as np
import pytest
from tolerances import ROUNDING

from jaxtube.scenario import ScenarioError, load
from jaxtube.synthesis.bands import make_law
from jaxtube.synthesis.certificate import law as law_certificate
from jaxtube.synthesis.certificate.law import LawBand
from jaxtube.synthesis.design import design
from jaxtube.synthesis.disturbance import kinematics, operation
from sets.robot.disturbance import evaluate_disturbance

SLOWEST = 0.85  # the two fastest bands of the scenario: W of each other one takes as long again


@pytest.fixture(scope="module")
def law():
    scenario = load("certified_wide")
    operating = msgspec.structs.replace(scenario.operating, bands=scenario.operating.bands[4:])
    reference = msgspec.structs.replace(scenario.reference, wheel_speed_min_mps=SLOWEST)
    return make_law(msgspec.structs.replace(scenario, operating=operating, reference=reference))


def test_the_law_is_certified(law):
    assert law.certificate.failing == []
    assert max(law.shares.values()) < 0.85
    assert len(law.certificate.assumptions) == 6


def test_every_schedule_has_its_bands_gain(law):
    schedules = np.random.default_rng(0).uniform(SLOWEST, 1.5, (50, 2))
    for schedule, gain in zip(schedules, law.gains(schedules), strict=True):
        settings = next(
            b for b in law.problem.scenario.operating.bands if schedule.mean() <= b.below_mps
        )
        k1, k2, k3 = settings.tracking_gains
        yaw_rate = (schedule[0] - schedule[1]) / 0.5
        np.testing.assert_allclose(gain, [[-k1, -yaw_rate, 0], [0, -k2, -k3]], atol=ROUNDING)


def test_no_order_of_schedules_and_disturbances_leaves_the_invariant_set(law):
    random = np.random.default_rng(1)
    omega = law.invariant.polytope
    corners = np.concatenate([band.corners for band in law.bands])
    errors = omega.vertices()[random.integers(len(omega.vertices()), size=4000)]
    for _ in range(40):
        schedule = (
            corners[random.integers(len(corners))]
            if random.random() < 0.5
            else random.uniform(SLOWEST, 1.5, 2)
        )[None]
        A, B = law.problem.model.matrices(schedule[0])
        band = law.bands[law.band_of(schedule)[0]]
        W = band.problem.disturbance_set.vertices()
        errors = (
            errors @ (A + B @ law.gains(schedule)[0]).T
            + W[random.integers(len(W), size=len(errors))]
        )
        assert np.max(errors @ omega.normals.T / omega.offsets) <= 1 + ROUNDING


def test_disturbances_of_a_band_lie_in_its_w(law):
    random = np.random.default_rng(2)
    count = 50_000
    for band in law.bands:
        where = operation(band.problem)
        low, high = where.box
        points = random.uniform(low, high, (count, 13))
        points = np.where(
            random.random((count, 13)) < 0.5, np.where(points > (low + high) / 2, high, low), points
        )
        points[:, 5:7] = random.dirichlet(np.ones(len(band.corners)), count) @ band.corners
        a, b = where.coupling
        room = a * np.maximum(1 - np.abs(points[:, 4]) / b, 0)
        points[:, 0] = np.clip(points[:, 0], -room, room)
        noise = random.choice([-1, 1], (count, 3)) * where.noise
        w, _, _ = evaluate_disturbance(where, kinematics(band.problem), points, noise)
        assert band.problem.disturbance_set.margin(w).min() >= -ROUNDING


def test_boxes_and_corner_loops_cover_their_band(law):
    for band in law.bands:
        assert law_certificate.coverage_gap(band) <= ROUNDING
        few = dataclasses.replace(
            band.problem, regions=band.problem.regions[: len(band.problem.regions) // 2]
        )
        assert (
            law_certificate.coverage_gap(LawBand(band.corners, few, band.gain, band.loops))
            == np.inf
        )


def test_a_wider_w_in_one_band_breaks_the_certificate(law):
    first = law.bands[0]
    wide = dataclasses.replace(
        first.problem, disturbance_set=first.problem.disturbance_set.scale(1.5)
    )
    changed = (dataclasses.replace(first, problem=wide), *law.bands[1:])
    assert law_certificate.certify_law(
        law.problem, changed, law.invariant.polytope, law.shares
    ).failing == ["invariant_set"]


@pytest.mark.parametrize("number", [0, -1])
def test_the_w_of_every_band_must_be_proved(law, number):
    band = law.bands[number]
    smaller = dataclasses.replace(
        band.problem, disturbance_set=band.problem.disturbance_set.scale(0.98)
    )
    certificate = certify_with(law, number, dataclasses.replace(band, problem=smaller))
    assert certificate.failing == ["disturbance_bound_proved"]


def test_the_wheels_of_every_band_are_checked(law):
    """Inputs of the fastest band that are half as wide again ask for more than the wheels have."""
    band = law.bands[-1]
    rows = band.problem.input_rows
    rows = dataclasses.replace(rows, offsets=1.5 * rows.offsets)
    faster = dataclasses.replace(
        band.problem, input_rows=rows, input_set=band.problem.input_set.scale(1.5)
    )
    certificate = certify_with(law, -1, dataclasses.replace(band, problem=faster))
    assert "wheel_limits" in certificate.failing


def certify_with(law, number: int, band: LawBand):
    """Certify the law again with one band replaced."""
    bands = list(law.bands)
    bands[number] = band
    return law_certificate.certify_law(
        law.problem, tuple(bands), law.invariant.polytope, law.shares
    )


def test_other_commands_refuse_bands_in_one_line():
    with pytest.raises(ScenarioError, match=r"operating\.bands") as refused:
        design(load("certified_wide"))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "override, words",
    [
        ("reference.wheel_speed_max_mps=1.6", "let below_mps grow"),
        ("disturbance.bound=assumed", "need a computed bound"),
        ("controller.tracking_gains=[1.0, 1.0, 1.0]", "bring their own"),
    ],
)
def test_bands_that_do_not_fit_are_refused(override, words):
    with pytest.raises(ScenarioError, match=words):
        load("certified_wide", [override])
