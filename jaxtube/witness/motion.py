"""What the motion of a slipping robot over a span adds to that of its model, and everything it may
add under a scenario.

A reference starts at the measured pose and drives as the nominal plant does on the logged wheels:
compensated slips i_m, effective track b, no sideslip. The controller at that pose would have e_m =
0 and u = 0, so that the error measured at the end is the disturbance of the period,

    w = e_m+ - A(th) e_m - B(th) u = e_m+,        e+ = Rot(-phi) (p_ref - p),  e_th+ = phi_ref - phi

and of its parts (`sets.robot.plant`) those remain that come from slip, sideslip and noise: the
bilinear, the sine and the sampling part vanish with e_m and u. Wheels that lag behind their
commands add nothing, because the wheels are the ones that were measured.

    way of a wheel      s (1 - i)            i in its interval, constant over a piece of the span
    sideways            zeta v - r w         |zeta| <= s, constant over a piece
    start of the robot  -n, in whichever frame the noise is bounded; at its end e_m+ has n+

The frame of e_m+ is known: the heading at the end was measured, so that only noise, not slip, turns
the gap between reference and robot into it.

With normalised deviations t, |t| <= 1, and G the derivatives at t = 0,

    w(t) - w(0) = int_0^1 dw/dt(s t) t ds in G t + [-rho, rho]
    rho = sum_j mean over s = 1/K .. 1 of max |dw/dt_j - G_j| over the box |t| <= s

by intervals, rounded outwards: a sum from above, because the maximum grows with s. Within a step
the wheels are constant; what they change within a step is not seen.

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (1)-(4); Moore, Kearfott, Cloud 2009,
Introduction to Interval Analysis, chapter 6. The reference at the measured pose is new.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxtube.plant.slip_bounds import slip_bounds
from jaxtube.scenario.error_box import error_vector
from jaxtube.scenario.tree import Scenario
from jaxtube.witness.spans import Spans
from sets.interval import Dual, Interval, sinc
from sets.robot.plant import Vector, polar

NOISES = 6
"""Numbers of the noise of two poses."""

OF_PIECE = 3
"""Slips (right, left) and sideslip."""

SHARES = (0.25, 0.5, 0.75, 1.0)
"""Of the box, over which derivatives are enclosed."""


@dataclass(frozen=True, eq=False)
class Allowance:
    """What a scenario allows a robot to do.

    Attributes:
        track: effective, m.
        lever_arm: m.
        nominal: slips that are compensated (right, left).
        slip: middle and half width of the true slips (right, left).
        sideslip: greatest lateral speed, by forward speed.
        noise: half widths of the pose noise (m, m, rad).
        frame: of the noise.
    """

    track: float
    lever_arm: float
    nominal: Float[np.ndarray, "2"]
    slip: tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]
    sideslip: float
    noise: Float[np.ndarray, "3"]
    frame: Literal["robot", "world"]

    def count(self, pieces: int) -> int:
        """Return how many numbers are free in a span."""
        return OF_PIECE * pieces + NOISES

    def box(self, pieces: int) -> tuple[Float[np.ndarray, " v"], Float[np.ndarray, " v"]]:
        """Return centre and half widths of all that is free: slips and sideslip of each piece, then
        the noise of both poses."""
        middle, half = self.slip
        centre = [*np.tile([*middle, 0.0], pieces), *np.zeros(NOISES)]
        widths = [*np.tile([*half, self.sideslip], pieces), *np.tile(self.noise, 2)]
        return np.array(centre), np.array(widths)


def find_allowance(scenario: Scenario) -> Allowance:
    """Return what a scenario allows a robot to do."""
    bounds = slip_bounds(scenario.slip)
    return Allowance(
        track=scenario.robot.turning_track_m,
        lever_arm=scenario.robot.lever_arm_m,
        nominal=np.array(scenario.slip.nominal),
        slip=(np.asarray(bounds.middle), np.asarray(bounds.half_width)),
        sideslip=scenario.slip.sideslip,
        noise=error_vector(scenario.noise),
        frame=scenario.noise.frame,
    )


class Reach(NamedTuple):
    """Everything that w may be: w(C) + G t + [-rho, rho] for deviations |t| <= 1."""

    centre: Float[np.ndarray, "k 3"]
    generators: Float[np.ndarray, "k 3 v"]
    remainder: Float[np.ndarray, "k 3"]

    @property
    def half_widths(self) -> Float[np.ndarray, "k 3"]:
        """How far w may be from the centre in each coordinate, the remainder left out."""
        return np.abs(self.generators).sum(axis=2)

    def take(self, rows: np.ndarray) -> Reach:
        """Return the reach of some of the spans."""
        return Reach(self.centre[rows], self.generators[rows], self.remainder[rows])


def measure_disturbance(spans: Spans, allowed: Allowance) -> Float[np.ndarray, "k 3"]:
    """Return w of every span as the log has it, (m, m, rad)."""
    moved = spans.last - spans.first
    seen = Vector(moved[:, 0], moved[:, 1]).turned(-spans.first[:, 2])
    place, heading = _drive_reference(spans, allowed)
    gap = Vector(place.x - seen.x, place.y - seen.y)
    return np.stack([*gap.turned(-moved[:, 2]), heading - moved[:, 2]], axis=1)


def find_reach(spans: Spans, allowed: Allowance) -> Reach:
    """Enclose what w of every span may be under what is allowed."""
    middle, half = allowed.box(spans.pieces)
    count = len(spans.start)
    size = len(middle)
    seeds = np.broadcast_to((np.eye(size) * half)[:, :, None], (size, size, count))

    def evaluate(share: float) -> list[Dual]:
        low = middle - share * half
        high = middle + share * half
        variables = [
            Dual(Interval(np.full(count, least), np.full(count, most)), Interval(seed, seed))
            for least, most, seed in zip(low, high, seeds, strict=True)
        ]
        return add_disturbance(spans, allowed, variables)

    at_centre = evaluate(0.0)
    centre = np.stack([_find_middle(output.value) for output in at_centre], axis=1)
    generators = np.stack([_find_middle(output.gradient).T for output in at_centre], axis=1)
    remainder = np.zeros_like(centre)
    for share in SHARES:
        for axis, output in enumerate(evaluate(share)):
            own = generators[:, axis]
            off = np.maximum(output.gradient.upper.T - own, own - output.gradient.lower.T)
            remainder[:, axis] += off.sum(axis=1) / len(SHARES)
    return Reach(centre, generators, remainder)


def _find_middle(interval: Interval) -> np.ndarray:
    return (interval.lower + interval.upper) / 2.0


def add_disturbance(spans: Spans, allowed: Allowance, variables: Sequence) -> list[Any]:
    """Return w of every span as a function of all that is free.

    Args:
        spans: k of them.
        allowed: the robot.
        variables: slips (right, left) and sideslip of each piece, then the noise (m, m, rad) of the
            first and of the last pose: floats, intervals or duals, each over the spans.
    """
    before = variables[-NOISES : -NOISES // 2]
    after = variables[-NOISES // 2 :]
    facing = spans.first[:, 2]
    if allowed.frame == "robot":
        turned = before[2]
        gap = Vector(before[0], before[1]).turned(turned).scaled(-1.0)
    else:
        turned = -before[2]
        gap = Vector(before[0], before[1]).turned(-facing)
    steps = spans.ways.shape[1]
    ahead = np.zeros(len(facing))
    for step in range(steps):
        piece = step * spans.pieces // steps
        own = variables[OF_PIECE * piece : OF_PIECE * (piece + 1)]
        way = spans.ways[:, step]
        reference = way * (1.0 - allowed.nominal)
        arc = (reference[:, 0] - reference[:, 1]) / allowed.track
        length = reference.mean(axis=1) * sinc(arc * 0.5)
        turn, driven = _drive(way, own, allowed, turned, arc)
        missed = Vector(driven.x * -1.0 + length, driven.y * -1.0)
        gap = gap.plus(missed.turned(ahead + arc * 0.5))
        turned = turned + (turn - arc)
        ahead = ahead + arc
    facing_end = spans.last[:, 2]
    if allowed.frame == "robot":
        seen = gap.turned(facing - facing_end).turned(-after[2])
        return [seen.x + after[0], seen.y + after[1], -turned + after[2]]
    seen = gap.turned(facing - facing_end)
    shift = Vector(after[0], after[1]).turned(-facing_end)
    return [seen.x - shift.x, seen.y - shift.y, -turned - after[2]]


def _drive(
    way: Float[np.ndarray, "k 2"], own: Sequence, allowed: Allowance, turned, arc
) -> tuple[Any, Vector]:
    """Return by how much a step turns the robot, and its motion in the frame that the reference has
    in the middle of the step."""
    slip_right, slip_left, sideslip = own
    right = (slip_right * -1.0 + 1.0) * way[:, 0]
    left = (slip_left * -1.0 + 1.0) * way[:, 1]
    turn = (right - left) * (1.0 / allowed.track)
    forwards = (right + left) * 0.5
    sideways = sideslip * forwards - turn * allowed.lever_arm
    towards = turned + (turn - arc) * 0.5
    shrunk = sinc(turn * 0.5)
    driven = polar(forwards * shrunk, towards)
    return turn, driven.plus(polar(sideways * shrunk, towards).crosswise())


def _drive_reference(spans: Spans, allowed: Allowance) -> tuple[Vector, Float[np.ndarray, "k"]]:
    """Return where the reference ends, seen from where it starts, and how far it turned."""
    ways = spans.ways * (1.0 - allowed.nominal)
    arcs = (ways[:, :, 0] - ways[:, :, 1]) / allowed.track
    turned = np.cumsum(arcs, axis=1)
    towards = turned - arcs / 2.0
    lengths = ways.mean(axis=2) * np.sinc(arcs / (2.0 * np.pi))
    x = (lengths * np.cos(towards)).sum(axis=1)
    y = (lengths * np.sin(towards)).sum(axis=1)
    return Vector(x, y), turned[:, -1]
