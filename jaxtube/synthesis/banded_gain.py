"""Decoupled gains by band of the mean wheel speed, and the loops that they close.

A band is a polygon of wheel speeds v. Stretched by tan(x) / x in [1, f], x = T Om / 2, it lies in
the hull of v and f v over its corners, in which the loops of the exact Jacobian are affine.

Source: new.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from jaxtube.plant.model import Model
from jaxtube.synthesis.gains import Gain, distinct, exact_loops
from jaxtube.synthesis.regimes import RegimeRule
from sets.polytope import Polytope


@dataclass(frozen=True, eq=False)
class BandGain(Gain):
    """The gain of one band, a polygon with these corners, m/s."""

    corners: Float[np.ndarray, "p 2"]

    @property
    def farthest_stretch(self) -> float:
        """The greatest factor by which wheel speeds in the band are stretched."""
        return float(np.max(self.model.stretched(self.corners) / self.corners))

    @cached_property
    def stretched_corners(self) -> Float[np.ndarray, "2p 2"]:
        """Wheel speeds whose hull holds those of the band, stretched, m/s."""
        return np.concatenate([self.corners, self.farthest_stretch * self.corners])

    @cached_property
    def corner_gains(self) -> Float[np.ndarray, "p 2 3"]:
        """Gains at the corners, whose mixtures hold every gain of the band."""
        return self.along(self.corners)

    @cached_property
    def pairs(self) -> tuple[Float[np.ndarray, "v 3 3"], Float[np.ndarray, "v 2 3"]]:
        """Every loop with every gain: the loops are affine in other speeds than the gains."""
        loops = distinct(exact_loops(self, self.stretched_corners))
        gains = distinct(self.corner_gains)
        return np.repeat(loops, len(gains), axis=0), np.tile(gains, (len(loops), 1, 1))

    def miss_at(self, schedules: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, " k"]:
        """Return by how much the loops at wheel speeds miss those of their stretched speeds, or
        these the hull of the corners', m/s."""
        stretched = self.model.stretched(schedules)
        missed = np.abs(self.loops_along(schedules) - exact_loops(self, stretched))
        hull = Polytope.from_vertices(self.stretched_corners)
        return np.maximum(missed.max(axis=(1, 2)), -hull.margin(stretched))


@dataclass(frozen=True, eq=False)
class BandedGain(Gain):
    """Decoupled gains of several bands; `nominal` and `vertices` have a leading axis over them.

    Attributes:
        rule: numbers the bands of wheel speeds.
        corners: of every band.
        band_regions: boxes that cover every band.
    """

    rule: RegimeRule
    corners: tuple[Float[np.ndarray, "p 2"], ...]
    band_regions: tuple[Float[np.ndarray, "m 2 2"], ...]

    def at(self, weights: Float[np.ndarray, "... 4"]) -> Float[np.ndarray, "... 2 3"]:
        """Refuse: weights do not tell the band.

        Raises:
            TypeError: always.
        """
        raise TypeError("gains by band have no weights; ask `along` with wheel speeds")

    def along(self, schedules: Float[np.ndarray, "... 2"]) -> Float[np.ndarray, "... 2 3"]:
        """Return the gain of the band that each pair of wheel speeds (right, left), m/s, is in."""
        weights = self.model.weights(schedules)
        numbers = self.rule.number(schedules.reshape(-1, 2)).reshape(schedules.shape[:-1])
        return np.einsum("...v,...vij->...ij", weights, self.vertices[numbers])

    @cached_property
    def bands(self) -> tuple[BandGain, ...]:
        """The gain of every band."""
        of_bands = zip(self.nominal, self.vertices, self.band_regions, self.corners, strict=True)
        return tuple(BandGain(self.model, *of_band) for of_band in of_bands)

    def of_regime(self, regime: int) -> BandGain:
        """Return the gain of a band."""
        return self.bands[regime]

    @cached_property
    def corner_gains(self) -> Float[np.ndarray, "k 2 3"]:
        """Gains at the corners of all bands."""
        return np.concatenate([band.corner_gains for band in self.bands])

    @cached_property
    def pairs(self) -> tuple[Float[np.ndarray, "v 3 3"], Float[np.ndarray, "v 2 3"]]:
        """Loops and gains of all bands."""
        loops, gains = zip(*(band.pairs for band in self.bands), strict=True)
        return np.concatenate(loops), np.concatenate(gains)


def band_corners(model: Model, slowest: float, fastest: float) -> Float[np.ndarray, "p 2"]:
    """Return the corners of the wheel speeds in the model's box with a mean between two ends, all
    in m/s."""
    mean = np.array([[0.5, 0.5], [-0.5, -0.5]])
    strip = Polytope(mean, np.array([fastest, -slowest]))
    return Polytope.box(*model.box).intersect(strip).vertices()
