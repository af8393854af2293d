"""Laws of the imperfect robot; the oracle integrates robot, reference and wheels in the world
frame."""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tolerances import CLOSED_LOOP, EXACT_ARCS, ROUNDING

from jaxtube.control.laws import TrackingLaw
from jaxtube.control.protocol import WheelMap
from jaxtube.plant.error_dynamics import advance
from jaxtube.plant.imperfect import Imperfections, ImperfectRobot, Motion, shifted_preview
from jaxtube.plant.reference import two_circles
from jaxtube.plant.robot import Robot
from jaxtube.plant.slip_bounds import near_nominal
from jaxtube.plant.slipping import SlippingRobot
from jaxtube.simulation.rollout import realisation_keys, rollout

ARCS_OF_A_PERIOD = 1e-5
"""In m; positions while wheels change speed by 1 m/s, arcs of a sixteenth of a period."""

DT = 0.1
TRACK_WIDTH = 0.5
KNOWN_SLIPS = near_nominal(np.array([0.2, 0.2]), 0.0, "true")
CASES = 6
BATCH = 8
LEVELS = {"lag": 0.05, "delay": 0.35, "sluggishness": 0.4, "sideslip": 0.2, "slip_change": 0.7}


def slipping_robot(**changes):
    """The robot on the eight of two circles of 2.5 m for 13 s: it changes circle once."""
    reference = two_circles(2.5, 1.36, 13.0, DT, 0, TRACK_WIDTH)
    ideal = SlippingRobot(
        robot=Robot(TRACK_WIDTH, -3.0, 3.0),
        dt=DT,
        reference_wheels=jnp.asarray(reference.wheels),
        reference_poses=jnp.asarray(reference.poses),
        slips=near_nominal(np.array([0.2, 0.2]), 0.1, "true"),
        process="vertex",
    )
    return dataclasses.replace(ideal, **changes)


def imperfect(ideal, **levels):
    return ImperfectRobot(ideal, Imperfections()._replace(**levels))


@pytest.fixture(scope="module")
def lap():
    """A function that drives laps of the tracking law on a plant."""
    starts = jnp.tile(jnp.array([-0.1, -0.1, 0.0]), (BATCH, 1))
    return lambda plant: rollout(
        TrackingLaw(WheelMap(TRACK_WIDTH, DT)), plant, realisation_keys(3, 0, BATCH), starts
    )


# -------------------------------------------------------------------------- one period in the world


def integrate(error, reference, motion, level, case):
    """Integrate one period in pieces: at the delay another command, at the instant other slips."""
    wheels = np.asarray(motion.wheels)[case]
    early = np.asarray(motion.early_slips)[case]
    late = np.asarray(motion.slips)[case]
    commands = [np.asarray(each)[case] for each in (motion.late_commands, motion.commands)]
    instant = float(motion.instant[case]) * DT
    sideslip = float(motion.sideslip[case])
    # The robot starts at the origin with heading 0: there its errors are the coordinates of the
    # reference.
    state = np.concatenate([np.zeros(3), error, wheels])
    ends = sorted({0.0, level.delay * DT, instant, DT})
    for start, end in itertools.pairwise(ends):
        command = commands[0 if start < level.delay * DT else 1]
        rates = world_rates(command, early if start < instant else late, sideslip, reference, level)
        state[6:] = command if not level.lag and not level.sluggishness else state[6:]
        state = solve_ivp(
            rates, (start, end), state, "DOP853", rtol=1e-11, atol=1e-13, max_step=DT / 40
        ).y[:, -1]
    away = (state[3] - state[0] + 1j * (state[4] - state[1])) * np.exp(-1j * state[2])
    return np.array([away.real, away.imag, state[5] - state[2]]), state[6:]


def world_rates(command, slips, sideslip, reference, level):
    """Rates of the robot's pose, the reference's pose and the wheels."""

    def rates(_, state):
        gap = command - state[6:]
        wheels = gap / level.lag if level.lag else 1e4 * gap
        limit = 1 / level.sluggishness if level.sluggishness else np.inf
        right, left = state[6:] * (1 - slips)
        moving = (1 + 1j * sideslip) * (right + left) / 2 * np.exp(1j * state[2])
        target = np.mean(reference) * np.exp(1j * state[5])
        turns = ((right - left) / TRACK_WIDTH, (reference[0] - reference[1]) / TRACK_WIDTH)
        return [
            moving.real,
            moving.imag,
            turns[0],
            target.real,
            target.imag,
            turns[1],
            *np.clip(wheels, -limit, limit),
        ]

    return rates


@pytest.fixture(scope="module")
def period():
    """(errors, motion) of some robots that turn, brake and slip differently."""
    generator = np.random.default_rng(7)
    errors = generator.uniform(-0.3, 0.3, (CASES, 3))
    wheels, before, after = jnp.asarray(generator.uniform(0.5, 2.0, (3, CASES, 2)))
    early, late = jnp.asarray(generator.uniform(0.1, 0.3, (2, CASES, 2)))
    instant, drift = jnp.asarray(generator.uniform([[0.0], [-1.0]], 1.0, (2, CASES)))
    return jnp.asarray(errors), Motion(wheels, before, after, early, late, instant, drift)


drive = jax.jit(ImperfectRobot.drive)


@pytest.mark.parametrize(
    "names",
    [*([name] for name in LEVELS), ["lag", "sluggishness"], list(LEVELS)],
    ids=lambda names: "-".join(names),
)
def test_a_period_is_that_of_the_world_frame(names, period):
    errors, motion = period
    plant = imperfect(slipping_robot(), **{name: LEVELS[name] for name in names})
    motion = motion._replace(sideslip=plant.imperfections.sideslip * motion.sideslip)
    driven, wheels = drive(plant, 0, errors, motion)
    reference = np.asarray(plant.reference_wheels[0])
    level = plant.imperfections
    cases = [integrate(errors[i], reference, motion, level, i) for i in range(CASES)]
    expected = np.array([error for error, _ in cases])
    reached = np.array([wheels for _, wheels in cases])
    held = not {"lag", "sluggishness"} & set(names)
    np.testing.assert_allclose(
        driven, expected, atol=EXACT_ARCS if held else ARCS_OF_A_PERIOD, rtol=0
    )
    if names != ["sluggishness"]:  # of which the oracle knows a limit with a very short lag
        np.testing.assert_allclose(driven[:, 2], expected[:, 2], atol=EXACT_ARCS)
        np.testing.assert_allclose(wheels, reached, atol=EXACT_ARCS)


@pytest.mark.slow
def test_positions_are_of_second_order_in_the_arcs_while_wheels_change_speed(period):
    plant = imperfect(slipping_robot(), lag=0.08)

    def drive_in(arcs):
        return drive(dataclasses.replace(plant, arcs=arcs), 0, *period)[0]

    exact = drive_in(256)
    coarse = np.abs(drive_in(4) - exact).max()
    fine = np.abs(drive_in(8) - exact).max()
    assert 3.5 < coarse / fine < 4.5


def test_wheels_that_lag_or_are_limited_follow_a_period_as_its_two_halves(period):
    """Also at the ends of the range, where the quotients of lag and limit are not defined."""
    _, motion = period
    for lag in (0.0, 1e-300, 1e-6, 0.03, 10.0):
        for sluggishness in (0.0, 1e-300, 0.1, 5.0):
            whole = imperfect(slipping_robot(), lag=lag, sluggishness=sluggishness)
            half = dataclasses.replace(whole, ideal=slipping_robot(dt=DT / 2))
            start = jnp.zeros((CASES, 3))
            steady = motion._replace(late_commands=motion.commands)
            _, middle = drive(half, 0, start, steady)
            _, end = drive(half, 0, start, steady._replace(wheels=middle))
            np.testing.assert_allclose(drive(whole, 0, start, steady)[1], end, atol=ROUNDING)


# ---------------------------------------------------------------------------------- the closed loop


def test_without_imperfections_the_robot_is_the_ideal_one(lap):
    ideal = slipping_robot(
        process="adversarial",
        slips=near_nominal(np.array([0.2, 0.2]), 0.1, "both"),
        noise=jnp.array([0.001, 0.001, 0.0005]),
    )
    found = lap(imperfect(ideal))
    expected = lap(ideal)
    np.testing.assert_allclose(found.errors[1], expected.errors[1], atol=ROUNDING)
    for name in ("errors", "measured", "inputs", "wheels", "demanded"):
        np.testing.assert_allclose(
            getattr(found, name), getattr(expected, name), atol=CLOSED_LOOP, err_msg=name
        )


@pytest.mark.slow
def test_with_a_delay_of_a_period_the_robot_drives_what_was_commanded_before(lap):
    ideal = slipping_robot(slips=KNOWN_SLIPS)
    found = lap(imperfect(ideal, delay=1.0))
    steps = np.arange(1, 130)
    reference = ideal.reference_wheels[steps][:, None]
    following = advance(
        found.errors[steps], found.wheels[steps - 1], 0.2, reference, TRACK_WIDTH, DT
    )
    np.testing.assert_allclose(found.errors[steps + 1], following, atol=ROUNDING)


def test_the_robot_starts_as_the_reference_drives(lap):
    """With wheels that hardly change speed it goes on along the first circle, beside the
    reference."""
    errors = lap(imperfect(slipping_robot(slips=KNOWN_SLIPS), lag=1e15)).errors[100]
    np.testing.assert_allclose(errors[:, 2], 0.0, atol=CLOSED_LOOP)
    np.testing.assert_allclose(
        jnp.hypot(errors[:, 0], errors[:, 1]), np.hypot(0.1, 0.1), atol=CLOSED_LOOP
    )


def turned(ideal, trajectory, step):
    """By how much the robots turned in a period, and by how much they would under each pair of
    extreme slips."""
    pairs = jnp.array(list(itertools.product((-1.0, 1.0), repeat=2)))
    slips = ideal.slips.true_slip(pairs)
    ground = trajectory.wheels[step, :, None] * (1 - slips)
    reference = ideal.reference_wheels[step]
    lost = trajectory.errors[step + 1, :, 2] - trajectory.errors[step, :, 2]
    right = ground[..., 0]
    left = ground[..., 1]
    return DT * (reference[0] - reference[1]) / TRACK_WIDTH - lost, DT * (
        right - left
    ) / TRACK_WIDTH


def test_the_slip_of_a_period_is_the_last_one_first_then_its_own(lap):
    """Under extreme slips: what a robot turns is a mixture, unless neither slip changes."""
    ideal = slipping_robot()
    own = turned(ideal, lap(imperfect(ideal)), 50)
    mixed = turned(ideal, lap(imperfect(ideal, slip_change=1.0)), 50)
    np.testing.assert_allclose(np.min(np.abs(own[1] - own[0][:, None]), axis=1), 0.0, atol=ROUNDING)
    assert np.all(mixed[1].min(axis=1) - ROUNDING <= mixed[0]) and np.all(
        mixed[0] <= mixed[1].max(axis=1) + ROUNDING
    )
    assert np.mean(np.min(np.abs(mixed[1] - mixed[0][:, None]), axis=1) > 1e-5) > 0.4


def test_sideslip_pushes_the_lateral_error_where_the_slips_push_the_heading_error(lap):
    ideal = slipping_robot()
    drifting = lap(imperfect(ideal, sideslip=0.1))
    slipping = lap(imperfect(ideal))
    rolling = lap(imperfect(dataclasses.replace(ideal, slips=KNOWN_SLIPS)))
    pushed = drifting.errors[1] - slipping.errors[1]
    turned = slipping.errors[1, :, 2] - rolling.errors[1, :, 2]
    turning = np.abs(turned) > 5e-3  # slips that differ; equal ones change the turn by 1.4 mrad
    assert 0 < turning.sum() < BATCH
    moved = DT * drifting.wheels[0, turning].mean(axis=1) * (1 - 0.2)
    np.testing.assert_allclose(
        pushed[turning, 1], 0.1 * moved * np.sign(turned[turning]), rtol=0.02
    )
    np.testing.assert_allclose(pushed[~turning], 0, atol=ROUNDING)


# ------------------------------------------------------------------------------------------ preview


def test_a_shifted_preview_is_that_of_a_step_nearby_with_the_same_present():
    wheels = np.repeat([[1.0, 2.0], [2.0, 1.0], [1.0, 2.0]], [5, 6, 4], axis=0)
    index = jnp.arange(15)
    for shift in range(-7, 8):
        believed = np.asarray(shifted_preview(index, jnp.asarray(wheels), shift))
        np.testing.assert_array_equal(wheels[believed], wheels)
        assert np.all(np.abs(believed - np.arange(15)) <= abs(shift))
    early = shifted_preview(index, jnp.asarray(wheels), 2)
    late = shifted_preview(index, jnp.asarray(wheels), -2)
    np.testing.assert_array_equal(early, [2, 3, 4, 4, 4, 7, 8, 9, 10, 10, 10, 13, 14, 14, 14])
    np.testing.assert_array_equal(late, [0, 0, 0, 1, 2, 5, 5, 5, 6, 7, 8, 11, 11, 11, 12])


def test_a_reference_that_changes_at_every_step_has_no_wrong_preview():
    wheels = jnp.linspace(1.0, 2.0, 9)[:, None] * jnp.ones(2)
    np.testing.assert_array_equal(shifted_preview(jnp.arange(9), wheels, 3), np.arange(9))
