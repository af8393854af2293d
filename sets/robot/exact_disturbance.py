"""That motions of the slipping robot stay within W, and the error of an estimate within S, proved
once more on integers.

`sets.robot.disturbance` and `sets.robot.observer` find W and S by intervals of floats. Here they
are given, every float is the rational that it is, and `sets.exact_supremum` proves, up and down,

    l_th kappa                                                  <=  yaw
    m_x + l_x (s_x + nu_x)                                      <=  box_x
    m_y + l_y (s_y + nu_y) + (l_y g_y - l_th g) kappa           <=  box_y
    l_th (S_th + nu_th)                                         <=  box_th
    (1 - l) r + l nu                                            <=  S

in the notation there, with W leaning by g, m what the model misses (bilinear, sine, sampling) and s
what the ground and noise do (slip, sideslip, noise). The parts of a motion are those of
`sets.robot.plant`. Given are the operation, by its pieces: caps and their coupling, the ranges of
slip errors, sideslip and noise; and what lag and delay add (`sets.robot.committed`), which
`sets.robot.exact_committed` derives anew.

Source: new.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from sets.exact import Row, exact_row
from sets.exact_supremum import Room, find_least, find_room
from sets.interval import Dual
from sets.robot.disturbance import DisturbanceBound
from sets.robot.driving import commit_operation
from sets.robot.operation import Operation
from sets.robot.plant import Kinematics, Parts, split_disturbance

Piece = Float[np.ndarray, "2 variables"]
"""Lower and upper ends of a piece of an operation."""
Read = Callable[[Parts], Dual]
"""Reads a signal off the parts of a motion."""


class _Motions(NamedTuple):
    """The motions of an operation whose wheels obey at once, and what lag and delay add to them:
    half widths (m, m, rad), and the greatest yaw kick, rad, where they bound it."""

    operation: Operation
    kinematics: Kinematics
    lower: Float[np.ndarray, "variables pieces"]
    upper: Float[np.ndarray, "variables pieces"]
    added: Row
    kick: Fraction | None

    def bound(self, read: Read, level: Fraction) -> Room:
        """Return the room that a signal leaves below a level."""
        # What a kick does sideways is all in the parts; nothing is left to the lean of W.
        period = self.operation.period._replace(lateral_per_yaw=0.0)

        def follow(piece):
            variables = self.operation.variables(piece)
            return read(split_disturbance(self.kinematics, period, variables))

        return find_room(follow, self.lower, self.upper, level)

    def bound_both(self, read: Read, level: Fraction) -> Room:
        """Return the room that a signal leaves up and down."""
        return find_least([self.bound(read, level), self.bound(lambda parts: -read(parts), level)])

    def bound_kick(self, level: Fraction) -> Room:
        """Return the room that yaw kicks leave."""
        if self.kick is not None and self.kick <= level:
            return Room(level - self.kick, level - self.kick)
        return self.bound_both(lambda parts: parts.yaw, level)


def find_disturbance_rooms(
    operation: Operation, kinematics: Kinematics, bound: DisturbanceBound
) -> dict[str, Room]:
    """Return how much room motions leave within W and its ground speeds.

    Args:
        operation, kinematics: of the robot.
        bound: W.

    Returns:
        Rooms by what is bounded, m, rad or m/s.

    Raises:
        ValueError: an angle may leave a quarter turn, or lag and delay do too much.
    """
    assert operation.estimate_error is not None
    motions = _find_motions(operation, kinematics)
    gain = exact_row(operation.gain)
    size = exact_row(operation.estimate_error)
    measured = _multiply(gain, exact_row(operation.noise))
    box = exact_row(bound.box)
    left = [width - noise for width, noise in zip(box, measured, strict=True)]
    added = _multiply(gain, motions.added)
    lean = gain[2] * Fraction(bound.lateral_per_yaw)
    shares = operation.gain[:2]

    def read_across(parts: Parts) -> Dual:
        return parts.rest_under(shares).y - parts.yaw * lean

    along = motions.bound_both(lambda parts: parts.rest_under(shares).x, left[0] - added[0])
    across = motions.bound_both(read_across, left[1] - added[1])
    turned = left[2] - gain[2] * size[2]
    kick = motions.bound_kick(Fraction(bound.yaw) / gain[2])
    rooms = {"x": along, "y": across, "heading": Room(turned, turned), "yaw kick": kick}
    return rooms | _find_speed_rooms(operation, kinematics, bound)


def _multiply(left: Row, right: Row) -> Row:
    return tuple(a * b for a, b in zip(left, right, strict=True))


def _find_speed_rooms(
    operation: Operation, kinematics: Kinematics, bound: DisturbanceBound
) -> dict[str, Room]:
    """Return how much room commands leave within the ground speeds of a bound."""
    commands = _list_motions(operation.without_disturbances(), kinematics, are_even=False)
    least_right, least_left = exact_row(bound.ground_speeds[0])
    most_right, most_left = exact_row(bound.ground_speeds[1])
    return {
        "fastest right": commands.bound(lambda parts: parts.right, most_right),
        "slowest right": commands.bound(lambda parts: -parts.right, -least_right),
        "fastest left": commands.bound(lambda parts: parts.left, most_left),
        "slowest left": commands.bound(lambda parts: -parts.left, -least_left),
    }


def find_estimate_rooms(operation: Operation, kinematics: Kinematics) -> dict[str, Room]:
    """Return how much room the next error of the estimate leaves within S, and the first one.

    Args:
        operation: of the robot, whose `estimate_error` is S.
        kinematics: input map; the model does not count.

    Returns:
        Rooms by coordinate, m or rad.

    Raises:
        ValueError: as `find_disturbance_rooms`.
    """
    assert operation.estimate_error is not None
    motions = _find_motions(operation, kinematics)
    gain = exact_row(operation.gain)
    noise = exact_row(operation.noise)
    size = exact_row(operation.estimate_error)
    rooms = {}
    for index, name in enumerate(("x", "y", "heading")):
        first = size[index] - noise[index]
        later = size[index] - gain[index] * noise[index]
        rooms[name] = Room(min(first, later), min(first, later))
        left = 1 - gain[index]
        if left > 0:
            unpredicted = _find_unpredicted_room(motions, index, later / left, size[2])
            rooms[name] = find_least([Room(first, first), unpredicted.scaled(left)])
    return rooms


def _find_unpredicted_room(
    motions: _Motions, index: int, level: Fraction, turned: Fraction
) -> Room:
    """Return how much room is left by what the estimate does not predict of a coordinate, where its
    heading is wrong by so much, rad."""
    if index == 2:
        return motions.bound_kick(level - turned)
    added = motions.added[index]
    return motions.bound_both(lambda parts: parts.unpredicted[index], level - added)


def _find_motions(operation: Operation, kinematics: Kinematics) -> _Motions:
    """Return the motions of an operation, those of committed poses where wheels lag."""
    if operation.actuation.is_ideal:
        return _list_motions(operation, kinematics)
    committed, commitment = commit_operation(operation, kinematics)
    motions = _list_motions(committed, kinematics)
    boxes = zip(exact_row(commitment.box), exact_row(commitment.slide), strict=True)
    added = tuple(box + slide for box, slide in boxes)
    return motions._replace(added=(*added, Fraction(0)), kick=Fraction(commitment.kick))


def _list_motions(operation: Operation, kinematics: Kinematics, are_even: bool = True) -> _Motions:
    """Return the motions of an operation whose wheels obey at once; without those that mirror
    others where all that is bounded is bounded alike on both sides."""
    pieces = list(np.moveaxis(operation.pieces(), 2, 0))
    if are_even and len(set(kinematics.slip_factors)) == 1:
        pieces = _drop_mirrored(pieces)
    lower, upper = np.stack(pieces, axis=2)
    return _Motions(operation, kinematics, lower, upper, (Fraction(0),) * 3, None)


def _drop_mirrored(pieces: list[Piece]) -> list[Piece]:
    """Return pieces without those whose mirror image lies in another one that is left."""
    left = pieces
    for piece in pieces:
        image = _mirror(piece)
        others = [other for other in left if other is not piece]
        if any(_holds(other, image) for other in others):
            left = others
    return left


def _mirror(piece: Piece) -> Piece:
    """Return the mirror image of a piece: lateral and heading error, turning input and the slope of
    the coupling change their signs, and right is left; other signs are free."""
    image = piece.copy()
    image[:, 5:9] = piece[:, [6, 5, 8, 7]]
    turned = [1, 2, 4, -1]
    image[:, turned] = -image[::-1, turned]
    return image


def _holds(piece: Piece, image: Piece) -> bool:
    return bool(np.all(piece[0] <= image[0]) and np.all(image[1] <= piece[1]))
