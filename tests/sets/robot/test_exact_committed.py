"""The bounds of lag and delay derived anew on integers: they confirm those in floats, refuse any
that is smaller, and enclose what they are made of."""

import dataclasses
from fractions import Fraction

import mpmath
import numpy as np
import pytest
from test_exact_disturbance import LATE, MODEL, SLIDING

from sets.exact_interval import GRID, decay, enclose_numbers
from sets.robot.actuation import Actuation
from sets.robot.committed import bound_commitment
from sets.robot.driving import commit_operation, find_driving
from sets.robot.exact_committed import (
    find_commitment_rooms,
    find_driving_rooms,
    find_lateness_rooms,
)
from sets.robot.late_ways import Driving, Ground

KNOWN_LAG = dataclasses.replace(LATE, actuation=Actuation((0.05, 0.05)), command_steps=None)
LONG_DELAY = dataclasses.replace(LATE, actuation=Actuation((0.0, 0.0), (0.12, 0.14)))
MEASURED_SLIP = dataclasses.replace(
    LATE, stale_errors=np.array([[-0.04, -0.06], [0.07, 0.05]]), command_steps=None
)
PLACES = [LATE, KNOWN_LAG, LONG_DELAY, MEASURED_SLIP]
IDS = ["unknown lag", "known lag", "long delay", "measured slip"]
LESS = 1 - 1e-9
"""What a bound that equals its derivation must not be lowered by."""
LOOSE = 0.5
"""By which bounds that the derivation betters are too small."""


def commitment_of(where):
    return commit_operation(where, MODEL).commitment


@pytest.mark.parametrize("where", PLACES, ids=IDS)
def test_bounds_in_floats_are_confirmed(where):
    rooms = find_lateness_rooms(where, MODEL)
    assert len(rooms) == 19
    for name, room in rooms.items():
        assert 0 <= room.proved <= room.met, name


def test_wheels_that_obey_at_once_have_nothing_to_confirm():
    assert find_lateness_rooms(SLIDING, MODEL) == {}


def refused(commitment) -> set[str]:
    rooms = find_commitment_rooms(LATE, find_driving(LATE, MODEL), commitment)
    return {name for name, room in rooms.items() if room.met < 0}


@pytest.mark.parametrize(
    ("field", "factor", "names"),
    [
        ("loss", [[LESS], [1.0]], {"what the right wheel gains", "what the left wheel gains"}),
        ("loss", [[1.0], [LESS]], {"what the right wheel loses", "what the left wheel loses"}),
        ("unknown", [LESS, 1.0], {"speed by unknown lag"}),
        ("unknown", [1.0, LESS], {"yaw rate by unknown lag"}),
        ("kick", LESS, {"yaw kick of lag"}),
        ("box", [LOOSE, 1.0], {"lag in x"}),
        ("box", [1.0, LOOSE], {"lag in y"}),
        ("slide", [LOOSE, 1.0], {"slide in x"}),
        ("slide", [1.0, LOOSE], {"slide in y"}),
    ],
)
def test_a_smaller_bound_is_refused_by_its_name(field, factor, names):
    commitment = commitment_of(LATE)
    smaller = commitment._replace(**{field: getattr(commitment, field) * np.array(factor)})
    assert refused(commitment) == set()
    assert refused(smaller) == names


def test_commands_beyond_what_they_are_said_to_be_are_met():
    driving = find_driving(LATE, MODEL)
    slower = driving._replace(speed=driving.speed * [1.0, 0.97], yaw_rate=driving.yaw_rate * LESS)
    rooms = find_driving_rooms(LATE, MODEL, slower)
    met = {name for name, room in rooms.items() if room.met < 0}
    assert met == {
        "greatest speed commanded",
        "least yaw rate commanded",
        "greatest yaw rate commanded",
    }


def test_losses_under_older_commands_have_a_worst_case_of_their_own():
    """Half a period each: forwards at 1.2 m/s losing 4 %, backwards at 1 m/s gaining 10 %; and
    backwards losing 4 %, forwards gaining 10 %."""
    driving = Driving(
        wheels=np.array([[-1.0, -1.0], [1.2, 1.2]]),
        speed=np.array([-1.0, 1.2]),
        yaw_rate=np.array([-0.5, 0.5]),
        change=np.full(2, np.inf),
        wheel_change=np.full(2, np.inf),
    )
    ground = Ground(
        np.array([[-0.02, -0.02], [0.04, 0.04]]), np.array([[-0.1, -0.1], [0.04, 0.04]])
    )
    half = Actuation(delay=(0.05, 0.05))
    gained, lost = bound_commitment(half, 0.1, 0.5, driving, ground, 0.1).loss
    np.testing.assert_allclose(lost, 0.5 * 0.04 * 1.2 + 0.5 * 0.1 * 1.0, rtol=1e-9)
    np.testing.assert_allclose(gained, -(0.5 * 0.04 * 1.0 + 0.5 * 0.1 * 1.2), rtol=1e-9)


@pytest.mark.parametrize("number", [0.0, 1e-6, 0.3, 1.0, 2.5, 40.0])
def test_decay_is_enclosed(number):
    value = decay(enclose_numbers([Fraction(number)]))
    with mpmath.workdps(60):
        exact = mpmath.exp(-mpmath.mpf(number)) * GRID
        assert int(value.lower[0]) <= exact <= int(value.upper[0])
        assert int(value.upper[0]) - int(value.lower[0]) < 2**20
