"""Smooth plane curves over their arc lengths: positions, headings, curvatures, nearest points.

With the parameter u and derivatives by it,

    heading = arctan2(y', x')        curvature = (x' y" - y' x") / |c'|^3

Source: differential geometry of plane curves, as in any textbook.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.interpolate import BSpline, CubicHermiteSpline

POINTS_PER_SPAN = 10
"""Of the table from a spline's parameter to arc length and heading."""

PROJECTIONS = 3
"""Newton steps towards the nearest point of a curve; the first already is close."""


class Samples(NamedTuple):
    """Points of a curve: positions m, headings rad (unwrapped), curvature 1/m and its change with
    arc length 1/m^2, positive to the left."""

    positions: Float[np.ndarray, "k 2"]
    headings: Float[np.ndarray, " k"]
    curvature: Float[np.ndarray, " k"]
    curvature_change: Float[np.ndarray, " k"]


@dataclass(frozen=True, eq=False)
class Curve:
    """A smooth plane curve; a closed one repeats itself.

    Attributes:
        spline: positions over the parameter.
        closed: whether the end is the start again, smoothly.
        parameter: of the table, increasing from 0.
        lengths: arc lengths of the table, m.
        headings: of the table, rad, unwrapped.
        by_length: parameter over arc length.
    """

    spline: BSpline
    closed: bool
    parameter: Float[np.ndarray, " n"]
    lengths: Float[np.ndarray, " n"]
    headings: Float[np.ndarray, " n"]
    by_length: CubicHermiteSpline

    @property
    def length(self) -> float:
        """Arc length of the curve, m; of one lap of a closed one."""
        return float(self.lengths[-1])

    @cached_property
    def sharpest(self) -> float:
        """Greatest curvature, 1/m, as of the points of its table."""
        return float(np.abs(self.at(self.lengths).curvature).max())

    def at(self, lengths: Float[np.ndarray, " k"]) -> Samples:
        """Return the points at arc lengths; those of a closed curve may lie beyond its end."""
        laps = np.floor(lengths / self.length) if self.closed else np.zeros_like(lengths)
        within = np.clip(lengths - laps * self.length, 0.0, self.length)
        parameter = self.by_length(within)
        velocity = self.spline(parameter, 1)
        acceleration = self.spline(parameter, 2)
        jerk = self.spline(parameter, 3)
        speed = np.linalg.norm(velocity, axis=1)
        bend = _cross(velocity, acceleration)
        growth = np.sum(velocity * acceleration, axis=1)
        change = _cross(velocity, jerk) / speed**3 - 3.0 * bend * growth / speed**5
        turn = self.headings[-1] - self.headings[0]
        # The table says which of the many headings is meant, the spline which exactly.
        rough = np.interp(within, self.lengths, self.headings)
        exact = np.arctan2(velocity[:, 1], velocity[:, 0])
        off = (exact - rough + np.pi) % (2.0 * np.pi) - np.pi
        return Samples(
            positions=self.spline(parameter),
            headings=rough + off + laps * turn,
            curvature=bend / speed**3,
            curvature_change=change / speed,
        )

    def project(
        self, positions: Float[np.ndarray, "n 2"], guess: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, " n"]:
        """Return the parameters of the points of the curve nearest to positions, from a guess."""
        end = self.parameter[-1]
        step_limit = end / 4.0
        found = guess
        for _ in range(PROJECTIONS):
            velocity = self.spline(found, 1)
            ahead = np.sum((positions - self.spline(found)) * velocity, axis=1)
            step = ahead / np.sum(velocity**2, axis=1)
            found = found + np.clip(step, -step_limit, step_limit)
            found = found % end if self.closed else np.clip(found, 0.0, end)
        return found


def make_curve(spline: BSpline, end: float, spans: int, closed: bool) -> Curve:
    """Return the curve of a spline over [0, end], with its table of arc lengths."""
    steps = POINTS_PER_SPAN * spans
    parameter = np.linspace(0.0, end, steps + 1)
    nodes, weights = np.polynomial.legendre.leggauss(3)
    half = end / steps / 2.0
    between = (parameter[:-1] + half)[:, None] + half * nodes
    speed = np.linalg.norm(spline(between.ravel(), 1), axis=1).reshape(between.shape)
    lengths = np.append(0.0, np.cumsum(half * speed @ weights))
    velocity = spline(parameter, 1)
    headings = np.unwrap(np.arctan2(velocity[:, 1], velocity[:, 0]))
    by_length = CubicHermiteSpline(lengths, parameter, 1.0 / np.linalg.norm(velocity, axis=1))
    return Curve(spline, closed, parameter, lengths, headings, by_length)


def _cross(a: Float[np.ndarray, "n 2"], b: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
