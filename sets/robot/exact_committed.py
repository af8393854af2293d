"""That what lag and delay add to the disturbance is no less than bounds derived anew, on integers.

`sets.robot.driving` finds the speeds that are commanded, and `sets.robot.committed` from these a
`Commitment`, in floats. Here both are given. That commands stay within the speeds is proved as W is
(`sets.exact_supremum`); every number of the commitment is compared with its bound by
`sets.robot.exact_ways`. The operation is given here, too: ranges of slip errors, the nominal lag
and delay, and bounded steps of commands where there are any.

Source: new.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from fractions import Fraction

import numpy as np

from sets.exact import exact_row
from sets.exact_interval import GRID, ExactInterval
from sets.exact_supremum import Room, find_room
from sets.interval import Dual
from sets.robot.committed import Commitment
from sets.robot.driving import commit_operation, find_driving
from sets.robot.exact_travel import enclose_one, take
from sets.robot.exact_ways import enclose_box, enclose_lost, enclose_slide, read_late
from sets.robot.late_ways import Driving
from sets.robot.operation import Operation
from sets.robot.plant import Kinematics, Parts, split_disturbance

SIDES = ("right", "left")
BODY = ("speed", "yaw rate")
PLACES = ("x", "y")


def find_lateness_rooms(operation: Operation, kinematics: Kinematics) -> dict[str, Room]:
    """Return how much room is left by what W and S take from lag and delay: none of it for wheels
    that obey at once.

    Raises:
        ValueError: where an angle may leave a quarter turn, or the wheels lose too much.
    """
    if operation.actuation.is_ideal:
        return {}
    driving = find_driving(operation, kinematics)
    commitment = commit_operation(operation, kinematics).commitment
    rooms = find_driving_rooms(operation, kinematics, driving)
    return rooms | find_commitment_rooms(operation, driving, commitment)


def find_driving_rooms(
    operation: Operation, kinematics: Kinematics, driving: Driving
) -> dict[str, Room]:
    """Return how much room commands leave within the speeds that they are said to have, m/s and
    rad/s.

    Raises:
        ValueError: where an angle may leave a quarter turn.
    """
    still = operation.without_disturbances()
    lower, upper = still.pieces()

    def bound(read: Callable[[Parts], Dual], level: float) -> Room:
        def follow(piece):
            return read(split_disturbance(kinematics, still.period, still.variables(piece)))

        return find_room(follow, lower, upper, Fraction(level))

    def read_speed(parts: Parts) -> Dual:
        return (parts.right + parts.left) * 0.5

    least_right, least_left = driving.wheels[0]
    most_right, most_left = driving.wheels[1]
    slowest, fastest = driving.speed
    rooms = {
        "least right command": bound(lambda parts: -parts.right, -least_right),
        "greatest right command": bound(lambda parts: parts.right, most_right),
        "least left command": bound(lambda parts: -parts.left, -least_left),
        "greatest left command": bound(lambda parts: parts.left, most_left),
        "least speed commanded": bound(lambda parts: -read_speed(parts), -slowest),
        "greatest speed commanded": bound(read_speed, fastest),
    }
    return rooms | _find_turning_rooms(operation, driving)


def _find_turning_rooms(operation: Operation, driving: Driving) -> dict[str, Room]:
    """Return the rooms within the yaw rates: those of the reference less a deficit."""
    lower = [exact_row(ends) for ends in operation.schedules[:, 0]]
    upper = [exact_row(ends) for ends in operation.schedules[:, 1]]
    track = Fraction(operation.track_width)
    slowest = min(low[0] - high[1] for low, high in zip(lower, upper, strict=True)) / track
    fastest = max(high[0] - low[1] for low, high in zip(lower, upper, strict=True)) / track
    least_deficit, most_deficit = exact_row(operation.inputs[:, 1])
    least, most = exact_row(driving.yaw_rate)
    down = slowest - most_deficit - least
    up = most - (fastest - least_deficit)
    return {
        "least yaw rate commanded": Room(down, down),
        "greatest yaw rate commanded": Room(up, up),
    }


def find_commitment_rooms(
    operation: Operation, driving: Driving, commitment: Commitment
) -> dict[str, Room]:
    """Return by how much the numbers of a commitment exceed the bounds that are derived anew.

    Args:
        operation: of the robot, whose wheels lag.
        driving: what the wheels are asked for.
        commitment: what is to be confirmed, in its units; any lever will do.

    Raises:
        ValueError: where the robot may turn, or the wheels lose, too much.
    """
    return {
        name: _compare(claim, bound)
        for name, claim, bound in _pair_claims(operation, driving, commitment)
    }


def _pair_claims(
    operation: Operation, driving: Driving, commitment: Commitment
) -> Iterator[tuple[str, float, ExactInterval]]:
    """Yield what is claimed, by name, and its bound."""
    late = read_late(operation, driving)
    lost = enclose_lost(late)
    unknown = lost.unknown * (1 / late.dt)
    box = enclose_box(late, lost, Fraction(commitment.lever))
    slide = enclose_slide(late, lost)
    for index, side in enumerate(SIDES):
        one = np.s_[index : index + 1]
        yield f"what the {side} wheel gains", -commitment.loss[0, index], -take(lost.least, one)
        yield f"what the {side} wheel loses", commitment.loss[1, index], take(lost.most, one)
    for index, name in enumerate(BODY):
        one = np.s_[index : index + 1]
        yield f"{name} by unknown lag", commitment.unknown[index], take(unknown, one)
    for index, name in enumerate(PLACES):
        yield f"lag in {name}", commitment.box[index], box[index]
        yield f"slide in {name}", commitment.slide[index], slide[index]
    yield "yaw kick of lag", commitment.kick, take(lost.total, np.s_[1:])


def _compare(claim: float, bound: ExactInterval) -> Room:
    room = enclose_one(claim) - bound
    return Room(Fraction(room.lower[0], GRID), Fraction(room.upper[0], GRID))
