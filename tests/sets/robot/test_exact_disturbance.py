"""The second proof of W and S on integers: it confirms what intervals of floats prove, refutes what
is smaller than what motions reach, and its motions are those of the robot itself."""

import dataclasses
from fractions import Fraction

import numpy as np
import pytest
from test_disturbance import PAIRS, operation

from sets.exact_interval import GRID, ExactInterval, scale_down
from sets.interval import cos, sin, sinc
from sets.robot.actuation import Actuation
from sets.robot.disturbance import DisturbanceBound, disturbance_bound
from sets.robot.exact_disturbance import (
    _drop_mirrored,
    find_disturbance_rooms,
    find_estimate_rooms,
)
from sets.robot.observer import find_estimate_error
from sets.robot.plant import INPUT_MAPS, Kinematics, plane_rows, split_disturbance
from sets.supremum import suprema

MODEL = Kinematics()
TIGHT = 0.02
"""Relative gap of the bounds that are tried: loose ones are proved in fewer cells."""
PLACES = Fraction(1, 2**60)
"""Up to which the parts of a motion add up to it."""

SMALL = operation(errors=(0.05, 0.08, 0.1), inputs=((-0.1, -0.3), (0.1, 0.3)), speeds=(0.8, 1.0))
SLIDING = dataclasses.replace(
    SMALL,
    wheel_errors=np.array([[-0.02, -0.05], [0.06, 0.03]]),
    sideslip=0.05,
    lever_arm=-0.04,
    coupling=(0.08, 0.5),
)
OBSERVED = dataclasses.replace(SLIDING, gain=(0.7, 0.4, 0.5), estimate_error=None)
LATE = dataclasses.replace(
    SLIDING,
    actuation=Actuation((0.02, 0.03), (0.0, 0.01)),
    command_steps=np.array([0.2, 0.2]),
)
WHERE = {
    "plain": SMALL,
    "sliding": SLIDING,
    "observed": dataclasses.replace(OBSERVED, estimate_error=find_estimate_error(OBSERVED, MODEL)),
    "late": LATE,
}
each_place = pytest.mark.parametrize(
    "name", [pytest.param("plain", marks=pytest.mark.slow), "sliding", "observed", "late"]
)
each_signal = pytest.mark.parametrize(
    "signal",
    [
        "y",
        "yaw kick",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("x", "heading", "fastest left")),
    ],
)


def bound_of(name: str) -> DisturbanceBound:
    return disturbance_bound(WHERE[name], MODEL, TIGHT)


@each_place
def test_what_floats_prove_is_proved_on_integers(name):
    rooms = find_disturbance_rooms(WHERE[name], MODEL, bound_of(name))
    assert len(rooms) == 8
    for room in rooms.values():
        assert 0 <= room.proved <= room.met
    for room in find_estimate_rooms(WHERE[name], MODEL).values():
        assert 0 <= room.proved <= room.met


@each_signal
@pytest.mark.parametrize("name", ["sliding", "observed"])
def test_a_bound_that_is_too_narrow_is_refuted_where_it_is(name, signal):
    bound = bound_of(name)
    narrow = 1 - 2 * TIGHT
    if signal == "yaw kick":
        smaller = dataclasses.replace(bound, yaw=bound.yaw * narrow)
    elif signal == "fastest left":
        smaller = dataclasses.replace(bound, ground_speeds=bound.ground_speeds * narrow)
    else:
        shrunk = bound.box.copy()
        shrunk[["x", "y", "heading"].index(signal)] *= narrow
        smaller = dataclasses.replace(bound, box=shrunk)
    rooms = find_disturbance_rooms(WHERE[name], MODEL, smaller)
    refuted = {each for each, room in rooms.items() if room.met < 0}
    expected = {"fastest left", "fastest right"} if signal == "fastest left" else {signal}
    assert refuted == expected


@pytest.mark.parametrize(
    ("change", "signal"),
    [
        ({"sideslip": 0.055}, "y"),
        ({"lever_arm": -0.06}, "y"),
        ({"noise": np.array([1.2e-3, 1e-3, 4e-4])}, "x"),
        ({"wheel_errors": np.array([[-0.02, -0.06], [0.07, 0.03]])}, "yaw kick"),
    ],
)
def test_a_robot_that_does_more_than_w_was_made_for_is_refuted(change, signal):
    more = dataclasses.replace(SLIDING, **change)
    rooms = find_disturbance_rooms(more, MODEL, bound_of("sliding"))
    assert rooms[signal].met < 0


def test_an_estimate_with_more_noise_than_its_set_was_made_for_is_refuted():
    observed = WHERE["observed"]
    noisier = dataclasses.replace(observed, noise=observed.noise * 1.05)
    rooms = find_estimate_rooms(noisier, MODEL)
    assert min(rooms.values(), key=lambda room: room.proved).proved < 0


def test_half_of_a_symmetric_operation_has_the_suprema_of_all_of_it():
    where = dataclasses.replace(SMALL, coupling=(0.08, 0.5))
    pieces = list(np.moveaxis(where.pieces(), 2, 0))
    left = _drop_mirrored(pieces)
    assert len(left) == len(pieces) / 2

    def outputs(piece):
        parts = split_disturbance(MODEL, where.period, where.variables(piece))
        return parts.yaw, *parts.rest

    objectives = [(output, sign, output) for output in range(3) for sign in (1, -1)]
    found = []
    for some in (pieces, left):
        lower, upper = np.stack(some, axis=2)
        proved, met = suprema(outputs, lower, upper, objectives, TIGHT)
        found.append((met, proved))
    np.testing.assert_array_less(found[0][0], found[1][1] * (1 + 1e-9))
    np.testing.assert_array_less(found[1][0], found[0][1] * (1 + 1e-9))


def test_wheels_that_differ_leave_no_piece_out():
    pieces = list(np.moveaxis(SLIDING.pieces(), 2, 0))
    assert len(_drop_mirrored(pieces)) == len(pieces)


def play(input_map: str, where, variables):
    """Return position error and speeds after a period, by the definitions of the motion."""
    x, y, heading, u1, u2, V_r, V_l, d_r, d_l, zeta, n_x, n_y, n_th = variables
    T = where.dt
    b = where.track_width
    A = (V_r - V_l) * T / b
    way = (V_r + V_l) * 0.5 * T
    a = A - u2 * T
    chord = way * sinc(A * 0.5)
    ahead = cos(a) * x + sin(a) * y + chord * cos(heading + A * 0.5 - a)
    commanded = {
        "paper": lambda: way - u1 * T,
        "cosine_free": lambda: way * cos(heading) - u1 * T,
        "x_exact": lambda: (ahead - x - A * y - u1 * T) / sinc(a),
    }[input_map]()
    right = (commanded + a * (0.5 * b)) * (1.0 - d_r)
    left = (commanded - a * (0.5 * b)) * (1.0 - d_l)
    forward = (right + left) * 0.5
    turn = (right - left) / b
    sideways = zeta * forward - turn * where.lever_arm
    X = x - n_x
    Y = y - n_y
    angle = heading - n_th + A * 0.5 - turn
    along = sinc(turn)
    across = sin(turn * 0.5) * sinc(turn * 0.5)
    new_x = cos(turn) * X + sin(turn) * Y + chord * cos(angle) - forward * along - sideways * across
    new_y = cos(turn) * Y - sin(turn) * X + chord * sin(angle) + forward * across - sideways * along
    return new_x, new_y


@pytest.mark.parametrize("kinematics", PAIRS, ids=lambda k: f"{k.input_map}-{k.model}")
def test_parts_add_up_to_the_motion_itself(kinematics):
    assert set(INPUT_MAPS) == {pair.input_map for pair in PAIRS}
    rng = np.random.default_rng(5)
    low, high = SLIDING.box
    points = low[:, None] + (high - low)[:, None] * rng.random((len(low), 25))
    variables = [ExactInterval(row, row) for row in scale_down(points)]
    period = SLIDING.period._replace(lateral_per_yaw=0.0)
    rest = split_disturbance(kinematics, period, variables).rest
    motion = play(kinematics.input_map, SLIDING, variables)
    x, y, heading, u1, u2, V_r, V_l = variables[:7]
    way = (V_r + V_l) * 0.5 * period.dt
    columns = (x, y, heading * way, u1, u2 * way)
    rows = plane_rows(kinematics, period, V_r, V_l)
    for part, moved, row in zip(rest, motion, rows, strict=True):
        model = sum(column * entry for column, entry in zip(columns, row, strict=True))
        difference = part - (moved - model)
        most = np.maximum(abs(difference.lower), abs(difference.upper)).max()
        assert Fraction(int(most), GRID) < PLACES
