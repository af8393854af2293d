"""Smooth curves through rows of a path: splines of degree 5 that spend little change of curvature.

    minimise over c:  integral |p - c|^2 ds  +  l^6 integral |c'''|^2 ds

with p the rows over their arc lengths. The curve keeps what is longer than l and loses what is
shorter: a wave of wave number k is scaled by 1 / (1 + (l k)^6). Straight lines, and on the scale of
l circles, cost nothing. Over a length L it has about L / (3 l) degrees of freedom, the integral of
that gain.

Source: P-splines by Eilers, Marx 1996, Flexible smoothing with B-splines and penalties, for degree
5 and third differences; the rest is Fourier analysis.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.interpolate import BSpline
from scipy.sparse import csc_array, csr_array, diags_array, eye_array
from scipy.sparse.linalg import spsolve

DEGREE = 5
ORDER = 3
"""Of the derivative that costs."""

KNOTS_PER_LENGTH = 2.0
"""Knots within a smoothing length l."""

FEWEST_SPANS = 6
"""Spans between knots, of any curve."""

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
    """

    spline: BSpline
    closed: bool
    parameter: Float[np.ndarray, " n"]
    lengths: Float[np.ndarray, " n"]
    headings: Float[np.ndarray, " n"]

    @property
    def length(self) -> float:
        """Arc length of the curve, m; of one lap of a closed one."""
        return float(self.lengths[-1])

    def at(self, lengths: Float[np.ndarray, " k"]) -> Samples:
        """Return the points at arc lengths; those of a closed curve may lie beyond its end."""
        laps = np.floor(lengths / self.length) if self.closed else np.zeros_like(lengths)
        within = np.clip(lengths - laps * self.length, 0.0, self.length)
        parameter = np.interp(within, self.lengths, self.parameter)
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


def fit_curve(
    positions: Float[np.ndarray, "n 2"],
    lengths: Float[np.ndarray, " n"],
    smoothing: float,
    closed: float | None = None,
) -> Curve:
    """Fit the curve of the module docstring.

    Args:
        positions: rows, m.
        lengths: arc length of each, m; the curve's parameter.
        smoothing: the length l, m.
        closed: the parameter at which a closed curve is at its start again, m; None for an open
            one, which ends with the greatest of the lengths.
    """
    end = float(lengths.max()) if closed is None else closed
    spans = max(FEWEST_SPANS, int(np.ceil(end * KNOTS_PER_LENGTH / smoothing)))
    spacing = end / spans
    beyond = spacing * np.arange(1, DEGREE + 1)
    knots = np.concatenate([-beyond[::-1], np.linspace(0.0, end, spans + 1), end + beyond])
    design = csc_array(BSpline.design_matrix(lengths, knots, DEGREE))
    count = spans + DEGREE
    wrap = _wrapping(count, spans) if closed is not None else None
    roughness = _differences(count) * spacing ** (0.5 - ORDER)
    if wrap is not None:
        design = design @ wrap
        # Each period counts once, however many of its differences are the same.
        roughness = roughness[:spans] @ wrap
    weights = diags_array(row_weights(lengths, end))
    normal = design.T @ weights @ design + smoothing ** (2 * ORDER) * (roughness.T @ roughness)
    solved = spsolve(csc_array(normal), design.T @ (weights @ positions))
    coefficients = solved if wrap is None else wrap @ solved
    return make_curve(BSpline(knots, coefficients, DEGREE), end, spans, closed is not None)


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
    return Curve(spline, closed, parameter, lengths, headings)


def degrees_of_freedom(length: float, smoothing: float) -> float:
    """Return about how many numbers a curve of a length is free in (module docstring), of each
    coordinate."""
    return ORDER / 2.0 + length / (3.0 * smoothing)


def row_weights(lengths: Float[np.ndarray, " n"], end: float) -> Float[np.ndarray, " n"]:
    """Return how much of the path each row stands for, m."""
    order = np.argsort(lengths, kind="stable")
    inner = lengths[order]
    edges = np.concatenate([[0.0], (inner[1:] + inner[:-1]) / 2.0, [end]])
    share = np.empty_like(lengths)
    share[order] = np.diff(edges)
    # Rows at one place would weigh nothing, and leave the curve there to others.
    return np.maximum(share, 1e-3 * end / len(lengths))


def _differences(count: int) -> csc_array:
    """Return the matrix of third differences of a number of coefficients."""
    matrix = csr_array(eye_array(count))
    for _ in range(ORDER):
        matrix = csr_array(matrix[1:] - matrix[:-1])
    return csc_array(matrix)


def _wrapping(count: int, spans: int) -> csc_array:
    """Return the matrix that repeats the coefficients of one period."""
    rows = np.arange(count)
    return csc_array((np.ones(count), (rows, rows % spans)), shape=(count, spans))


def _cross(a: Float[np.ndarray, "n 2"], b: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
