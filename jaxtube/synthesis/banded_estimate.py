"""Estimated shares of the caps of several bands of speed at once, for one search over all of them.

A point holds logarithms of the caps of the error, which all bands share, then of each band its caps
on inputs and its gains (`NAMES`, k1, k2, k3). Each band has its W (`Estimate`); the tube is one for
all of them in any order:

    e_x:          r = max_m  w_m / (1 - |1 - T k1_m|)
    (e_y, e_th):  the polygon of `lateral_tube`, over the loops of all bands, each with its own W
                  and with what e_x, up to r, adds to the lateral error

Source: new.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxtube.synthesis import lateral_tube
from jaxtube.synthesis.banded_gain import band_corners
from jaxtube.synthesis.bands import list_ends, rule_of_bands, split_bands
from jaxtube.synthesis.corners import (
    CAPS_AND_GAINS,
    ERROR_CAPS,
    NAMES,
    Corners,
    EstimatedDisturbance,
)
from jaxtube.synthesis.estimate import CAP_ROWS, LIMIT_ROWS, Estimate, Shares
from jaxtube.synthesis.lateral_tube import Policy, Ring
from jaxtube.synthesis.natural import DECIMALS
from jaxtube.synthesis.problem import Problem

OWN = CAPS_AND_GAINS - ERROR_CAPS
"""Numbers of each band."""
SHARED_LIMITS = 8
"""Limits of caps and start; those of the wheels are of each band."""


class BandedActive(NamedTuple):
    """What makes every W and the tube at a point."""

    corners: tuple[Corners, ...]
    policy: Policy


class TubeData(NamedTuple):
    """What the tube is made of at n points: W of every band, the reach in e_x, and in (e_y, e_th)
    the disturbances of one step, the images of the directions, and the rows of the caps."""

    disturbances: list[EstimatedDisturbance]
    ahead: Float[np.ndarray, " n"]
    steps: Float[np.ndarray, "n loops directions"]
    images: Float[np.ndarray, "n loops directions 2"]
    rows: Float[np.ndarray, "n rows 2"]


class BandedEstimate:
    """The shares of a problem with bands at points; as `Estimate`, in natural units.

    A start counts for the bands of the first plan alone; of a reference whose speeds jump, for all:
    any may come first.
    """

    def __init__(self, problem: Problem):
        self.problem = problem
        ends = list_ends(problem.scenario)
        first = _list_first_bands(problem)
        self.bands = []
        for number, (band, of_band) in enumerate(
            zip(split_bands(problem), pairwise(ends), strict=True)
        ):
            estimate = _estimate_band(band, *of_band)
            self.bands.append(estimate if number in first else estimate.from_the_path())
        self.units = self.bands[0].units
        self._set_ring(self.bands[0].ring)
        each = range(1, len(self.bands) + 1)
        self.cap_rows = (
            *CAP_ROWS[:ERROR_CAPS],
            *(f"{row}, band {number}" for number in each for row in CAP_ROWS[ERROR_CAPS:]),
        )
        self.limit_rows = (
            *LIMIT_ROWS[:SHARED_LIMITS],
            *(f"{row}, band {number}" for number in each for row in LIMIT_ROWS[SHARED_LIMITS:]),
        )

    def _set_ring(self, ring: Ring) -> None:
        self.ring = ring
        for band in self.bands:
            band.ring = ring

    def _logarithms(self) -> Float[np.ndarray, " k"]:
        """Return the logarithms of the units of a point's numbers."""
        of_band = self.units.logarithms(NAMES)[:CAPS_AND_GAINS]
        return np.append(of_band[:ERROR_CAPS], np.tile(of_band[ERROR_CAPS:], len(self.bands)))

    def to_point(self, values: Sequence[float]) -> Float[np.ndarray, " k"]:
        """Return caps and gains, in the order of `starts.caps_and_gains` and their own units, as a
        point."""
        return (np.log(values) - self._logarithms()).round(DECIMALS)

    def to_values(self, point: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        """Return the caps and gains of a point in their own units."""
        return np.exp(point + self._logarithms())

    def ranges(self, size: int) -> Float[np.ndarray, "2 k"]:
        """Return the least and the greatest value of each number of a point, infinite where a
        search sets none."""
        of_band = self.bands[0].ranges(CAPS_AND_GAINS)
        return np.hstack(
            [of_band[:, :ERROR_CAPS], np.tile(of_band[:, ERROR_CAPS:], len(self.bands))]
        )

    def with_less_speed(self, factor: float) -> BandedEstimate:
        """Return the same estimate, with the greatest ground speed divided by a factor."""
        return self._change(lambda band: band.with_less_speed(factor))

    def with_more_speed(self, share: float) -> BandedEstimate:
        """Return the same estimate, with the least ground speed higher by a share of the greatest
        one."""
        return self._change(lambda band: band.with_more_speed(share))

    def with_reserve(self, reserve: float) -> BandedEstimate:
        """Return the same estimate, with another share by which proved errors may pass those at
        corners."""
        return self._change(lambda band: band.with_reserve(reserve))

    def with_farther_start(self, factor: float) -> BandedEstimate:
        """Return the same estimate, with the start farther away by a factor."""
        return self._change(lambda band: band.with_farther_start(factor))

    def _change(self, change: Callable[[Estimate], Estimate]) -> BandedEstimate:
        changed = copy.copy(self)
        changed.bands = [change(band) for band in self.bands]
        return changed

    def shaped_like(self, point: Float[np.ndarray, " k"]) -> BandedEstimate:
        """Return the same estimate, with directions spread as the tube of a point is wide, one of
        them along the row of turning of the band that turns hardest."""
        shares = self.shares(point)
        if shares is None:
            return self
        lateral, heading = shares.caps[0, 1:ERROR_CAPS] * np.exp(point[1:ERROR_CAPS])
        turning = shares.caps[0, ERROR_CAPS:].reshape(len(self.bands), -1)[:, 2]
        k2, k3 = np.exp(self.split(point[None])[int(np.argmax(turning))][0, 9:])
        shaped = self._change(copy.copy)
        shaped._set_ring(Ring.through(k2, k3, lateral / np.deg2rad(heading)))
        return shaped

    def split(self, points: Float[np.ndarray, "n k"]) -> list[Float[np.ndarray, "n 11"]]:
        """Return the points of every band on its own."""
        shared = points[:, :ERROR_CAPS]
        own = np.split(points[:, ERROR_CAPS:], len(self.bands), axis=1)
        return [np.hstack([shared, of_band]) for of_band in own]

    def shares(self, point: Float[np.ndarray, " k"]) -> Shares | None:
        """Return the shares of caps and limits at one point, None where the loops have no bounded
        tube there."""
        active = self.find_active(point)
        return None if active is None else self.shares_nearby(point[None], active)

    def find_corners(
        self, point: Float[np.ndarray, " k"], known: tuple[Corners, ...] | None = None
    ) -> tuple[Corners, ...]:
        """Return the corners that make each W at a point, with those that are known."""
        before = known or (None,) * len(self.bands)
        of_bands = zip(self.bands, self.split(point[None]), before, strict=True)
        return tuple(band.find_corners(own[0], corners) for band, own, corners in of_bands)

    def find_active(
        self, point: Float[np.ndarray, " k"], corners: tuple[Corners, ...] | None = None
    ) -> BandedActive | None:
        """Return what makes every W and the tube at a point, None where the tube is not bounded; of
        all corners, or of those given."""
        points = self.split(point[None])
        if not all(band.keeps_ahead(own) for band, own in zip(self.bands, points, strict=True)):
            return None
        corners = self.find_corners(point) if corners is None else corners
        data = self._gather(points, corners)
        policy = lateral_tube.settle(self.ring, data.images[0], data.steps[0], data.rows[0])
        return None if policy is None else BandedActive(corners, policy)

    def shares_nearby(self, points: Float[np.ndarray, "n k"], active: BandedActive) -> Shares:
        """Return the shares at points where the same corners and sides count."""
        by_band = self.split(points)
        data = self._gather(by_band, active.corners)
        loops = active.policy.loops
        steps = data.steps[:, loops, np.arange(len(loops))]
        supports = lateral_tube.solve(self.ring, active.policy, data.images, steps)
        sideways = lateral_tube.reach(self.ring, active.policy.rows, supports, data.rows)
        shared = np.column_stack([data.ahead, sideways[:, :2]])
        filled = [
            band.fill(own, w, np.column_stack([shared, sideways[:, 2 + number]]))
            for number, (band, own, w) in enumerate(
                zip(self.bands, by_band, data.disturbances, strict=True)
            )
        ]
        caps = np.stack([shares.caps for shares in filled], axis=1)
        limits = np.stack([shares.limits for shares in filled], axis=1)
        return Shares(_join(caps, ERROR_CAPS), _join(limits, SHARED_LIMITS))

    def _gather(
        self, points: list[Float[np.ndarray, "n 11"]], corners: tuple[Corners, ...]
    ) -> TubeData:
        """Return what the tube is made of at the points of every band."""
        of_bands = list(zip(self.bands, points, strict=True))
        disturbances = [
            band.corners.disturbance(own, known)
            for (band, own), known in zip(of_bands, corners, strict=True)
        ]
        reaches = [
            band.reach_ahead(own, w) for (band, own), w in zip(of_bands, disturbances, strict=True)
        ]
        ahead = np.max(reaches, axis=0)
        parts = [
            band.tube_data(own, w, ahead)
            for (band, own), w in zip(of_bands, disturbances, strict=True)
        ]
        images = [of_band[1] for of_band in parts]
        steps = [np.broadcast_to(of_band[0][:, None], of_band[1].shape[:3]) for of_band in parts]
        shared_rows = parts[0][2][:, :2]
        own_rows = [of_band[2][:, 2:] for of_band in parts]
        return TubeData(
            disturbances,
            ahead,
            np.concatenate(steps, axis=1),
            np.concatenate(images, axis=1),
            np.concatenate([shared_rows, *own_rows], axis=1),
        )


def _list_first_bands(problem: Problem) -> set[int]:
    """Return the bands that a start is made in."""
    scenario = problem.scenario
    if scenario.reference.shape == "jumps":
        return set(range(len(scenario.operating.bands)))
    first_plan = problem.schedule[: problem.horizon]
    return set(rule_of_bands(scenario).number(first_plan).tolist())


def _estimate_band(band: Problem, slowest: float, fastest: float) -> Estimate:
    """Return the estimate of one band: W over the boxes that cover it, loops over its polygon."""
    estimate = Estimate(band)
    speed = estimate.units.length / estimate.units.time
    corners = band_corners(estimate.model, slowest / speed, fastest / speed)
    farthest = float(np.max(estimate.model.stretched(corners) / corners))
    return estimate.over(corners, np.concatenate([corners, farthest * corners]))


def _join(shares: Float[np.ndarray, "n bands rows"], shared: int) -> Float[np.ndarray, "n joined"]:
    """Return the largest share of the first rows, which the bands have in common, and those of all
    others, band by band."""
    own = shares[:, :, shared:].reshape(len(shares), -1)
    return np.hstack([shares[:, :, :shared].max(axis=1), own])
