"""Laws of the adversary: no other extreme slips push the robot further, and laps under it use more
of E."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import chisquare, kstest
from tolerances import LEAST_P_VALUE, ROUNDING

from jaxtube.control.protocol import WheelMap
from jaxtube.plant import adversary, slip
from jaxtube.plant.adversary import ALWAYS, FOREVER, LONGEST_HALF_PERIOD, Scheme, pushed_direction
from jaxtube.plant.protocol import Measurement
from jaxtube.plant.robot import Robot, saturate
from jaxtube.plant.slip_bounds import near_nominal
from jaxtube.plant.slip_processes import PROCESSES
from jaxtube.plant.slipping import SlipMemory, SlippingRobot
from jaxtube.simulation import batches, components
from jaxtube.simulation.rollout import realisation_keys

STATES = 1000
TRACK_WIDTH = 0.5
WHEEL_MAP = WheelMap(TRACK_WIDTH, 0.1)


def corners(count):
    """All of {-1, 1}^count."""
    return np.array(list(itertools.product((-1.0, 1.0), repeat=count)))


def robot_at_some_state(uncertain_slip, dt):
    """A plant of one period under the adversary."""
    return SlippingRobot(
        robot=Robot(track_width=TRACK_WIDTH, wheel_speed_min=-3.0, wheel_speed_max=3.0),
        dt=dt,
        reference_wheels=jnp.array([[1.5, 1.2]]),
        reference_poses=jnp.array([[4.0, -3.0, 2.0], [4.1, -3.0, 2.0]]),
        slips=near_nominal(np.array([0.2, 0.15]), 0.1, uncertain_slip),
        process="adversarial",
    )


@jax.jit
def one_period(plant, keys, errors, inputs):
    """Directions the adversary pushes along; how far the error moves along them, chosen and for
    each pair of xi."""
    memory = plant.initial(keys, errors)
    direction = jax.vmap(lambda scheme, error: pushed_direction(scheme, 0, error))(
        memory.process[0], errors
    )
    measurement, memory = plant.sense(keys, 0, memory, errors)
    command = WHEEL_MAP.command(inputs, measurement, plant.reference_wheels[0])
    chosen, _, wheels = plant.advance(keys, 0, memory, errors, command)

    def gain(following):
        return jnp.sum(direction * (following - errors), axis=1)

    def gain_of(pair):
        true, measured = jnp.broadcast_to(pair[:, None], (2, *inputs.shape))
        sensed = Measurement(errors, plant.slips.measured_slip(true, measured))
        demanded = WHEEL_MAP.command(inputs, sensed, plant.reference_wheels[0]).wheels
        moved = plant.move(
            0, errors, saturate(demanded, plant.robot), SlipMemory((), true, measured)
        )
        return gain(moved)

    return (
        direction,
        wheels,
        gain(chosen),
        jax.vmap(gain_of)(jnp.asarray(pairs_of_slips(plant.slips.uncertain_slip))),
    )


def pairs_of_slips(uncertain_slip):
    """All extreme deviations (true, measured) of what is uncertain."""
    if uncertain_slip == "both":
        return corners(4).reshape(-1, 2, 2)
    others = np.zeros((4, 2))
    return np.stack(
        [corners(2), others] if uncertain_slip == "true" else [others, corners(2)], axis=1
    )


@pytest.mark.parametrize("uncertain_slip", ["true", "measured", "both"])
def test_no_other_extreme_slips_push_the_error_further_over_one_exact_period(uncertain_slip):
    """At 1000 random states, whichever slip varies: a measured one acts the other way round.

    The choice is by the rate of the error: best over short periods everywhere, over 0.1 s where no
    two tie in it.
    """
    generator = np.random.default_rng(1)
    keys = realisation_keys(2, 0, STATES)
    inputs = jnp.asarray(generator.uniform(-1, 1, (STATES, 2)) * [0.3, 0.5])
    for dt, width in ((1e-5, 0.3), (0.1, 0.15)):
        errors = jnp.asarray(generator.uniform(-1, 1, (STATES, 3)) * [width, width, 0.35])
        results = one_period(robot_at_some_state(uncertain_slip, dt), keys, errors, inputs)
        direction, wheels, chosen, possible = map(np.asarray, results)
        assert np.all(wheels > 0)
        assert set(np.sign(direction[:, 0])) == set(np.sign(direction[:, 1])) == {-1, 0, 1}
        np.testing.assert_allclose(chosen, possible.max(axis=0), rtol=0, atol=ROUNDING)
        # The best is no tie that rounding decides.
        assert np.all(chosen > np.sort(possible, axis=0)[-2] + ROUNDING)


@pytest.fixture(scope="module")
def schemes():
    """3000 schemes."""
    return jax.tree.map(
        np.asarray, jax.jit(jax.vmap(adversary.draw_scheme))(realisation_keys(0, 0, 3000))
    )


def test_schemes_are_drawn_evenly(schemes):
    def is_even(counts):
        return chisquare(counts).pvalue > LEAST_P_VALUE

    drawn = (schemes.speed_weight != 0) & (schemes.speed_weight != ALWAYS)
    held = schemes.half_period == FOREVER
    assert is_even(
        [np.sum(schemes.speed_weight == 0), np.sum(schemes.speed_weight == ALWAYS), np.sum(drawn)]
    )
    timings = [
        np.sum(schemes.outward),
        np.sum(held & ~schemes.outward),
        np.sum(~held & ~schemes.outward),
    ]
    assert is_even(timings) and not np.any(held & schemes.outward)
    assert is_even(np.unique(schemes.sign, return_counts=True)[1]) and set(schemes.sign) == {-1, 1}
    for values in (schemes.half_period[~held], schemes.offset):
        found, counts = np.unique(values, return_counts=True)
        np.testing.assert_array_equal(found, np.arange(1, LONGEST_HALF_PERIOD + 1))
        assert is_even(counts)
    for values in (schemes.lead, schemes.speed_weight[drawn]):
        assert kstest(np.log(values) / np.log(4.0), "uniform", (-1, 2)).pvalue > LEAST_P_VALUE


OUTWARD = Scheme(
    lead=jnp.asarray(2.0),
    speed_weight=jnp.asarray(0.5),
    outward=jnp.asarray(True),
    sign=jnp.asarray(1.0),
    half_period=jnp.asarray(3),
    offset=jnp.asarray(1),
)


@pytest.mark.parametrize(
    "errors, expected",
    [
        ([0.1, 0.2, 0.05], [0, 1, 2]),
        ([0.1, 0.2, -0.2], [0, -1, -2]),
        ([0.1, 0.2, -0.1], [1, 0, 0]),
        ([-0.1, 0.0, 0.02], [-1, 0, 0]),
        ([0.1, 0.0, 0.03], [0, 1, 2]),
        ([0.0, 0.0, 0.0], [0, 1, 2]),
    ],
)
def test_feedback_pushes_the_larger_error_away_from_zero(errors, expected):
    direction = pushed_direction(OUTWARD, 5, jnp.array(errors))
    np.testing.assert_array_equal(direction, np.array(expected))


@pytest.mark.parametrize(
    "half_period, offset, starts",
    [(3, 1, [2, 5, 8, 11]), (1, 1, list(range(1, 12))), (5, 7, [3, 8])],
)
def test_waves_turn_every_half_period_whatever_the_error(half_period, offset, starts):
    wave = OUTWARD._replace(
        outward=jnp.asarray(False), half_period=jnp.asarray(half_period), offset=jnp.asarray(offset)
    )
    signs = [
        np.asarray(pushed_direction(wave, k, jnp.array([0.0, (-1) ** (k // 2), 0.0])))[1]
        for k in range(12)
    ]
    assert (np.flatnonzero(np.diff(signs)) + 1).tolist() == starts
    opposite = wave._replace(sign=-wave.sign)
    assert pushed_direction(opposite, 0, jnp.array([0.0, 1.0, 0.0]))[1] == -signs[0]


def test_laps_under_the_adversary_use_more_of_the_error_set_than_drawn_extremes(paper_design):
    controller = components.controllers(paper_design)["compensated"]
    starts = np.zeros((64, 3))
    reach = {}
    for process in ("iid", "vertex", "adversarial"):
        trajectory = batches.run_realisations(
            controller, components.slipping_robot(paper_design, process), starts, 0
        )
        reach[process] = np.abs(trajectory.errors).max(axis=(0, 1))
    assert np.all(reach["adversarial"] > 1.2 * reach["vertex"]) and np.all(
        reach["vertex"] > 1.2 * reach["iid"]
    )


def test_a_lap_of_a_robot_that_begins_without_error_is_pushed_all_the_same():
    """The sign of zero: on a straight line nothing else would ever move it."""
    scheme = OUTWARD._replace(speed_weight=jnp.asarray(0.0))
    situation = slip.Situation(jnp.array([[0.0, -0.25], [0.0, 0.25]]), jnp.zeros(3))
    xi, _ = PROCESSES["adversarial"].draw(jax.random.key(0), 0, scheme, situation)
    np.testing.assert_array_equal(xi, [1.0, -1.0])
