"""Fits of smooth curves to rows of a path: splines of degree 5 that spend little change of
curvature.

    minimise over c:  integral |p - c|^2 ds  +  l^6 integral |c'''|^2 ds

with p the rows over their arc lengths. The curve keeps what is longer than l and loses what is
shorter: a wave of wave number k is scaled by 1 / (1 + (l k)^6). Straight lines, and on the scale of
l circles, cost nothing. Over a length L it has about L / (3 l) degrees of freedom, the integral of
that gain.

Where a curvature is too sharp, the fit is repeated with a growing cost of the excess,

    m integral (n . c" - kappa)^2 ds

with n the normal of the last fit, kappa its curvature there cut to what is allowed, and m growing
where it was cut: a penalty method for a greatest curvature.

Source: P-splines by Eilers, Marx 1996, Flexible smoothing with B-splines and penalties, for degree
5 and third differences; quadratic penalties as in Nocedal, Wright 2006, Numerical Optimization,
section 17.1; the rest is Fourier analysis.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.interpolate import BSpline
from scipy.sparse import block_diag, csc_array, csr_array, diags_array, eye_array, hstack
from scipy.sparse.linalg import spsolve

from jaxtube.paths.curve import Curve, make_curve

DEGREE = 5
ORDER = 3
"""Of the derivative that costs."""

KNOTS_PER_LENGTH = 2.0
"""Knots within a smoothing length l."""

FEWEST_SPANS = 6
"""Spans between knots, of any curve."""

BENDS_PER_SPAN = 4
"""Points of a span at which the curvature is limited."""

GROWTH = 4.0
"""Of the cost of excess curvature, from fit to fit."""

BENDINGS = 8
"""Fits at most in which excess curvature is taken away."""

ROOM = 0.01
"""Share of a limit of curvature that is aimed below it."""


@dataclass(frozen=True, eq=False)
class Fitting:
    """The quadratic program of a fit; both coordinates share its matrices.

    Attributes:
        knots: of the spline.
        end: greatest parameter, m; of a closed curve where it is at its start again.
        spans: between knots.
        closed: whether the curve is closed.
        normal: matrix of the program.
        right: its right side, for either coordinate.
        wrap: from free coefficients to those of the spline, which a closed curve repeats.
    """

    knots: Float[np.ndarray, " k"]
    end: float
    spans: int
    closed: bool
    normal: csc_array
    right: Float[np.ndarray, "free 2"]
    wrap: csc_array

    def solve(self) -> Curve:
        """Return the curve of least cost."""
        return self._make_curve(np.asarray(spsolve(self.normal, self.right)))

    def bend(self, curve: Curve, sharpest: float, stiffness: Float[np.ndarray, " points"]) -> Curve:
        """Return the curve of least cost with that of its excess curvature.

        Args:
            curve: the last fit, which may be too sharp.
            sharpest: greatest curvature, 1/m.
            stiffness: cost m of the excess at each of the points (`bend_points`), m^4.
        """
        bends = find_bends(curve, self.bend_points)
        wanted = np.clip(bends.curvature, -sharpest, sharpest)
        second = self._second_derivatives(self.bend_points)
        across = csr_array(hstack([second.multiply(bends.normals[:, [axis]]) for axis in (0, 1)]))
        cost = stiffness * self.end / len(self.bend_points)
        normal = block_diag([self.normal, self.normal]) + across.T @ diags_array(cost) @ across
        right = self.right.T.ravel() + across.T @ (cost * wanted * bends.speed**2)
        free = np.asarray(spsolve(csc_array(normal), right))
        return self._make_curve(free.reshape(2, -1).T)

    @cached_property
    def bend_points(self) -> Float[np.ndarray, " points"]:
        """Parameters of the points at which the curvature is limited."""
        points = BENDS_PER_SPAN * self.spans
        return (np.arange(points) + 0.5) * self.end / points

    def _second_derivatives(self, parameter: Float[np.ndarray, " n"]) -> csc_array:
        """Return the matrix from free coefficients to second derivatives."""
        basis = BSpline.design_matrix(parameter, self.knots[2:-2], DEGREE - 2)
        spacing = self.end / self.spans
        return csc_array(basis @ difference(self.spans + DEGREE, 2) @ self.wrap / spacing**2)

    def _make_curve(self, free: Float[np.ndarray, "free 2"]) -> Curve:
        spline = BSpline(self.knots, self.wrap @ free, DEGREE)
        return make_curve(spline, self.end, self.spans, self.closed)


def make_fitting(
    positions: Float[np.ndarray, "n 2"],
    lengths: Float[np.ndarray, " n"],
    smoothing: float,
    closed: float | None = None,
) -> Fitting:
    """Set up the fit of a curve (module docstring).

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
    count = spans + DEGREE
    wrap = csc_array(eye_array(count))
    roughness = difference(count, ORDER) * spacing ** (0.5 - ORDER)
    if closed is not None:
        wrap = _repeat(count, spans)
        # Each period counts once, however many of its differences are the same.
        roughness = csc_array(csr_array(roughness)[:spans] @ wrap)
    design = csc_array(BSpline.design_matrix(lengths, knots, DEGREE)) @ wrap
    weighted = design.T @ diags_array(row_weights(lengths, end))
    normal = weighted @ design + smoothing ** (2 * ORDER) * (roughness.T @ roughness)
    right = weighted @ positions
    return Fitting(knots, end, spans, closed is not None, csc_array(normal), right, wrap)


def limit_curvature(fitting: Fitting, curve: Curve, sharpest: float, smoothing: float) -> Curve:
    """Return the curve nearest to the rows among those with a greatest curvature (1/m); `curve`
    itself where it is one of them, and the least sharp of `BENDINGS` fits where none is."""
    aim = sharpest * (1.0 - ROOM)
    stiffness = np.zeros(len(fitting.bend_points))
    best = curve
    for _ in range(BENDINGS):
        if best.sharpest <= sharpest:
            return best
        is_sharp = np.abs(find_bends(curve, fitting.bend_points).curvature) > aim
        # Where a turn has been widened it keeps its cost, or it would spring back.
        stiffness[is_sharp] = np.maximum(GROWTH * stiffness[is_sharp], smoothing**4)
        curve = fitting.bend(curve, aim, stiffness)
        best = min(best, curve, key=lambda tried: tried.sharpest)
    return best


class Bends(NamedTuple):
    """Points of a curve: curvature 1/m, normals to the left, and speed of the parameter."""

    curvature: Float[np.ndarray, " n"]
    normals: Float[np.ndarray, "n 2"]
    speed: Float[np.ndarray, " n"]


def find_bends(curve: Curve, parameter: Float[np.ndarray, " n"]) -> Bends:
    """Return how a curve bends at parameters."""
    velocity = curve.spline(parameter, 1)
    speed = np.linalg.norm(velocity, axis=1)
    normals = velocity[:, ::-1] * [-1.0, 1.0] / speed[:, None]
    across = np.sum(normals * curve.spline(parameter, 2), axis=1)
    return Bends(across / speed**2, normals, speed)


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


def difference(count: int, order: int) -> csc_array:
    """Return the matrix of differences of an order of a number of coefficients."""
    matrix = csr_array(eye_array(count))
    for _ in range(order):
        matrix = csr_array(matrix[1:] - matrix[:-1])
    return csc_array(matrix)


def _repeat(count: int, spans: int) -> csc_array:
    """Return the matrix that repeats the coefficients of one period."""
    rows = np.arange(count)
    return csc_array((np.ones(count), (rows, rows % spans)), shape=(count, spans))
