"""Turns of a chain of cells: how sharp they are, where, and what the robot does there.

A robot that drives along a curve turns little from a cell of the chain to the next. Positions alone
cannot tell a robot that reverses from one that turns on the spot by 180 degrees; headings, where
the file has them, can.

Source: new.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from jaxtube.paths.cells import Chain
from jaxtube.recordings.path import RawPath

TURNED_BACK = np.deg2rad(135.0)
"""Turn above which the robot may as well have reversed."""

LEVER = 3
"""Cells over which the direction before and after a break is taken."""


def find_sharpness(chain: Chain, track_width: float) -> Float[np.ndarray, " cells"]:
    """Return the greatest turn at each cell, or over it and the next one, rad; 0 where the turn
    takes a radius of more than a track width."""
    steps = np.diff(chain.means, axis=0)
    ways = np.linalg.norm(steps, axis=1)
    directions = find_direction(steps)
    sharp = np.zeros(len(chain.means))
    for apart in (1, 2):
        if len(ways) <= apart:
            break
        turns = np.abs(wrap_angles(directions[apart:] - directions[:-apart]))
        way = np.lib.stride_tricks.sliding_window_view(ways, apart + 1).mean(axis=1) * apart
        turns[way > turns * track_width] = 0.0
        inner = slice(1, len(sharp) - apart)
        sharp[inner] = np.maximum(sharp[inner], turns)
    return sharp


def find_turn(chain: Chain, cell: int, by_way_of_it: bool = False) -> float:
    """Return the angle between the motion before and after a cell, rad; 0 at an end of the path.

    The directions are those of the cells before and after, or `by_way_of_it` to and from its mean,
    which is known well where the robot stands.
    """
    before = chain.means[max(cell - LEVER, 0) : cell]
    after = chain.means[cell + 1 : cell + 1 + LEVER]
    if not len(before) or not len(after):
        return 0.0
    here = chain.means[cell]
    arrival = (before[-1] if len(before) > 1 and not by_way_of_it else here) - before[0]
    departure = after[-1] - (after[0] if len(after) > 1 and not by_way_of_it else here)
    return float(np.abs(wrap_angles(find_direction(departure) - find_direction(arrival))))


def find_corner_row(raw: RawPath, chain: Chain, cell: int) -> int:
    """Return the row of a corner: of the cell and its neighbours the one that lies furthest out."""
    before = max(cell - LEVER, 0)
    after = min(cell + LEVER, len(chain.means) - 1)
    inwards = chain.means[before] + chain.means[after] - 2.0 * chain.means[cell]
    first = int(chain.first[max(cell - 1, 0)])
    last = int(chain.last[min(cell + 2, len(chain.means) - 1)])
    return first + int(np.argmin(raw.positions[first : last + 1] @ inwards))


def describe_turn(raw: RawPath, chain: Chain, cell: int, turn: float) -> str:
    """Say what the robot does where its motion turns."""
    degrees = f"{np.degrees(turn):.0f} deg"
    if turn < TURNED_BACK:
        return f"turns on the spot by {degrees}"
    if raw.headings is None:
        return f"turns back by {degrees} (reverses or turns on the spot: no headings)"
    before = raw.headings[chain.first[max(cell - 1, 0)]]
    after = raw.headings[chain.last[min(cell + 1, len(chain.means) - 1)]]
    is_spot_turn = np.abs(wrap_angles(after - before)) > np.pi / 2.0
    return f"turns on the spot by {degrees}" if is_spot_turn else "changes between forth and back"


def find_direction(steps: Float[np.ndarray, "... 2"]) -> Float[np.ndarray, "..."]:
    """Return the directions of steps, rad."""
    return np.arctan2(steps[..., 1], steps[..., 0])


def wrap_angles(angles: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Return angles in [-pi, pi)."""
    return (angles + np.pi) % (2.0 * np.pi) - np.pi
