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
from sets.robot.driving import commit_operation, find_driving
from sets.robot.exact_committed import (
    find_commitment_rooms,
    find_driving_rooms,
    find_lateness_rooms,
)

KNOWN_LAG = dataclasses.replace(LATE, actuation=Actuation((0.05, 0.05)), command_steps=None)
LONG_DELAY = dataclasses.replace(LATE, actuation=Actuation((0.0, 0.0), (0.12, 0.14)))
MEASURED_SLIP = dataclasses.replace(
    LATE, stale_errors=np.array([[-0.04, -0.06], [0.07, 0.05]]), command_steps=None
)
BOTH_WAYS = dataclasses.replace(
    MEASURED_SLIP,
    schedules=np.array([[[-0.2, -0.2], [0.3, 0.3]]]),
    inputs=np.array([[-0.9, -0.3], [0.8, 0.3]]),
    actuation=Actuation((0.0, 0.0), (0.05, 0.05)),
)
"""Where wheels turn both ways, what is lost under an older command has a worst case of its own."""
PLACES = [LATE, KNOWN_LAG, LONG_DELAY, MEASURED_SLIP, BOTH_WAYS]
IDS = ["unknown lag", "known lag", "long delay", "measured slip", "both ways"]
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


@pytest.mark.parametrize("number", [0.0, 1e-6, 0.3, 1.0, 2.5, 40.0])
def test_decay_is_enclosed(number):
    value = decay(enclose_numbers([Fraction(number)]))
    with mpmath.workdps(60):
        exact = mpmath.exp(-mpmath.mpf(number)) * GRID
        assert int(value.lower[0]) <= exact <= int(value.upper[0])
        assert int(value.upper[0]) - int(value.lower[0]) < 2**20
