"""Laws of the bounds on learnt slips: no drive within the certified errors and speeds leaves a
wider interval, and they are as they must be at the ends of what they depend on."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import slip_drives as drives

from jaxtube.plant.slip_observer import SlipObserver
from sets.robot.slip_learning import Learning, bound_learnt_slips

PERIODS = 4
LEARNING = Learning(
    slips=np.stack([drives.LEAST, drives.GREATEST]),
    change=drives.CHANGE,
    periods=PERIODS,
    errors=np.array([0.15, 0.2, 0.3]),
    noise=drives.NOISE,
    speeds=np.array([[0.6, 0.6], [2.1, 2.1]]),
    yaw_rate=1.4,
    reference_speed=1.5,
    dt=drives.DT,
    track_width=drives.TRACK,
)
update = jax.jit(SlipObserver.update)


def drive_closed_loop(random, robots):
    """Return (radii, wheel errors, whether still within the caps) by the periods since the first
    measurement: ground speeds at extremes or anywhere between are asked for under the slips that
    are learnt."""
    observer = SlipObserver(
        jnp.asarray(drives.LEAST),
        jnp.asarray(drives.GREATEST),
        drives.CHANGE,
        jnp.asarray(drives.NOISE),
        drives.TRACK,
        drives.DT,
        PERIODS,
    )
    periods = PERIODS + 3
    slips = drives.draw_slips(random, periods, robots)
    noise = drives.draw_noise(random, periods + 1, robots)
    errors = random.uniform(-0.6, 0.6, (robots, 3)) * LEARNING.errors
    known = observer.initial(jnp.asarray(errors))
    place = -(errors[:, 0] + 1j * errors[:, 1]) * np.exp(-1j * errors[:, 2])
    heading = -errors[:, 2]
    target = 0.0
    target_heading = 0.0
    wheels = np.zeros((robots, 2))
    reference = np.zeros(2)
    stays = np.ones(robots, bool)
    found = []
    for k in range(periods):
        off = (target - place) * np.exp(-1j * heading)
        measured = np.stack([off.real, off.imag, target_heading - heading], axis=1) + noise[k]
        stays &= np.all(np.abs(measured) <= LEARNING.errors, axis=1)
        known = update(observer, known, *map(jnp.asarray, (measured, wheels, reference)))
        centre = np.asarray(known.centre)
        d = (slips[k] - centre) / (1 - centre)
        found.append((np.asarray(known.radius), np.abs(d), stays.copy()))
        reference = random.uniform(1.0, 1.5, 2)
        speed = np.where(random.random(robots) < 0.7, 0.7, random.uniform(0.7, 1.9, robots))
        turn = random.uniform(-1, 1, robots) * np.minimum(1.4, 4 * (speed - 0.6))
        turn = np.clip(turn, -4 * (2.1 - speed), 4 * (2.1 - speed))
        ground = np.stack([speed + turn / 4, speed - turn / 4], axis=1)
        wheels = ground / (1 - centre)
        place, heading = drives.step(place, heading, wheels * (1 - slips[k]))
        target, target_heading = drives.step(target, target_heading, reference)
    return found


def test_no_drive_within_the_caps_passes_the_bounds_and_some_come_near():
    bound = bound_learnt_slips(LEARNING)
    worst = 0.0
    for seed in range(4):
        found = drive_closed_loop(np.random.default_rng(seed), 5000)
        for age, (radius, errors, stays) in enumerate(found):
            which = min(age, PERIODS)
            assert np.all(radius[stays] <= bound.radius[which])
            assert np.all(errors[stays] <= bound.wheel_errors[which])
            if age == 2:
                worst = max(worst, np.max(radius[stays] / bound.radius[2]))
    assert worst > 0.6


@pytest.mark.parametrize(
    "name, factor", [("noise", 2.0), ("change", 3.0), ("errors", 1.5), ("reference_speed", 1.5)]
)
def test_more_of_what_is_unknown_never_narrows_the_bounds(name, factor):
    less = bound_learnt_slips(LEARNING)
    more = bound_learnt_slips(LEARNING._replace(**{name: factor * getattr(LEARNING, name)}))
    assert np.all(more.radius >= less.radius)
    assert np.all(more.wheel_errors >= less.wheel_errors)


def test_bounds_shrink_with_every_period_and_speed_and_with_narrower_intervals():
    bound = bound_learnt_slips(LEARNING)
    assert np.all(np.diff(bound.radius, axis=0) <= 1e-12)
    np.testing.assert_allclose(bound.radius[0], (drives.GREATEST - drives.LEAST) / 2)
    faster = LEARNING._replace(speeds=np.array([[0.9, 0.9], [2.1, 2.1]]))
    assert np.all(bound_learnt_slips(faster).radius[1:] < bound.radius[1:])
    narrow = LEARNING._replace(slips=np.stack([drives.LEAST + 0.05, drives.GREATEST - 0.05]))
    assert np.all(bound_learnt_slips(narrow).wheel_errors <= bound.wheel_errors)


@pytest.mark.parametrize(
    "change",
    [
        {"speeds": np.array([[0.0, 0.6], [2.1, 2.1]])},
        {"yaw_rate": 12.0},
        {"errors": np.array([0.15, 0.2, 2.0])},
    ],
)
def test_wheels_that_may_stand_and_turns_too_sharp_teach_nothing(change):
    bound = bound_learnt_slips(LEARNING._replace(**change))
    nothing = np.tile((drives.GREATEST - drives.LEAST) / 2, (PERIODS + 1, 1))
    np.testing.assert_allclose(bound.radius, nothing)


def test_without_noise_a_slip_is_known_but_for_its_next_change():
    quiet = bound_learnt_slips(LEARNING._replace(noise=np.zeros(3)))
    np.testing.assert_allclose(quiet.radius[1:], drives.CHANGE, atol=2e-9)


def test_a_wheel_error_holds_every_pair_of_slips_of_its_radius():
    bound = bound_learnt_slips(LEARNING)
    random = np.random.default_rng(0)
    for radius, size in zip(bound.radius, bound.wheel_errors, strict=True):
        half = random.uniform(0, 1, (2000, 2)) * radius
        centre = random.uniform(drives.LEAST + half, drives.GREATEST - half)
        slip = centre + random.uniform(-1, 1, (2000, 2)) * half
        d = np.abs(slip - centre) / (1 - centre)
        # Radii near the bound occur at low wheel speeds alone, which the smaller one counts on.
        assert np.all(d <= radius / (1 - drives.GREATEST + radius) + 1e-12)
        assert np.all(size <= radius / (1 - drives.GREATEST + radius) + 1e-8)
