"""What the exact re-check of a design takes from each of its regimes, in rational numbers: the
tracking gains, every loop and gain that may act, W, and where the regime holds.

A regime holds in boxes of wheel speeds or, with gains by speed, in a band: the part of one box in
which the mean wheel speed is between two ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise, product

import numpy as np

from jaxtube.synthesis.bands import list_ends
from jaxtube.synthesis.disturbance import prove_bound
from jaxtube.synthesis.problem import Problem
from sets.exact import Matrix, Numbers, Row, exact_row
from sets.robot.exact_bands import (
    band_corners,
    exact_polygon_feedbacks,
    exact_polygon_loops,
    room_in_band,
)
from sets.robot.exact_tube import exact_vertex_feedbacks, exact_wheel_loops, schedule_box


@dataclass(frozen=True, eq=False)
class ExactRegime:
    """A regime in rational numbers.

    Attributes:
        gains: k1, k2, k3.
        loops: of each part of the wheel speeds, those whose hull holds every Phi(th) there.
        feedbacks: of each part, those whose hull holds every K(th) there.
        points: whose hull is W.
    """

    problem: Problem
    gains: Numbers
    loops: list[list[Matrix]]
    feedbacks: list[list[Matrix]]
    points: list[Row]
    ends: tuple[float, float] | None

    @property
    def every_loop(self) -> list[Matrix]:
        """The loops of all parts."""
        return [loop for part in self.loops for loop in part]

    @property
    def every_feedback(self) -> list[Matrix]:
        """The distinct gains of all parts."""
        return list(dict.fromkeys(gain for part in self.feedbacks for gain in part))

    def room_of(self, wheels: Row) -> Fraction:
        """Return by how much wheel speeds lie inside where the regime holds, m/s."""
        if self.ends is not None:
            return room_in_band(wheels, *_find_box(self.problem), self.ends)
        return max(
            _room_in_region(wheels, *map(exact_row, region)) for region in self.problem.regions
        )


def make_exact_regimes(problem: Problem) -> list[ExactRegime]:
    """Return the regimes of a problem in their order."""
    if not problem.scenario.operating.bands:
        return [_of_regions(regime) for regime in problem.every_regime]
    of_bands = pairwise(list_ends(problem.scenario))
    return [_of_band(regime, ends) for regime, ends in zip(problem.regimes, of_bands, strict=True)]


def _of_regions(problem: Problem) -> ExactRegime:
    """Return a regime that holds in the regions of its problem."""
    gains = problem.scenario.controller.tracking_gains
    T = problem.model.dt
    b = problem.model.track_width
    loops = [exact_wheel_loops(gains, lower, upper, T, b) for lower, upper in problem.regions]
    feedbacks = [
        list(dict.fromkeys(exact_vertex_feedbacks(gains, schedule_box(lower, upper, T, b))))
        for lower, upper in problem.regions
    ]
    return ExactRegime(problem, gains, loops, feedbacks, disturbance_points(problem), None)


def _of_band(problem: Problem, ends: tuple[float, float]) -> ExactRegime:
    """Return a regime that holds in a band."""
    gains = problem.scenario.controller.tracking_gains
    T = problem.model.dt
    b = problem.model.track_width
    corners = band_corners(*_find_box(problem), ends)
    loops = exact_polygon_loops(gains, corners, T, b)
    feedbacks = exact_polygon_feedbacks(gains, corners, b)
    return ExactRegime(problem, gains, [loops], [feedbacks], disturbance_points(problem), ends)


def _find_box(problem: Problem) -> tuple[Row, Row]:
    """Return the least and the greatest wheel speeds (right, left), m/s."""
    low, high = problem.model.box
    return exact_row(low), exact_row(high)


def disturbance_points(problem: Problem) -> list[Row]:
    """Return at most twelve points whose hull is exactly W: segment + box where it is computed,
    else a box."""
    if problem.disturbance_bound is None:
        lower = -problem.disturbance_set.support(-np.eye(3))
        upper = problem.disturbance_set.support(np.eye(3))
        return [exact_row(point) for point in product(*zip(lower, upper, strict=True))]
    bound = prove_bound(problem)
    yaw, lateral_per_yaw = exact_row((bound.yaw, bound.lateral_per_yaw))
    kick = (Fraction(0), lateral_per_yaw * yaw, yaw)
    widths = exact_row(bound.box)
    along = 1 if lateral_per_yaw >= 0 else -1
    points = []
    for sign, *sides in product((-1, 1), repeat=4):
        # A corner of the box that lies against the kick in both of its coordinates is no extreme
        # point of the sum.
        if not sides[1] * along == sides[2] == -sign:
            corner = [side * width for side, width in zip(sides, widths, strict=True)]
            points.append(tuple(sign * k + c for k, c in zip(kick, corner, strict=True)))
    return points


def _room_in_region(wheels: Row, lower: Row, upper: Row) -> Fraction:
    """Return by how much wheel speeds lie inside a box of them."""
    above = [speed - least for speed, least in zip(wheels, lower, strict=True)]
    below = [most - speed for speed, most in zip(wheels, upper, strict=True)]
    return min(*above, *below)
