"""Whether loops of gains by speed are mixtures of the corner loops of their band, and what W is
bounded over holds the band."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from jaxtube.synthesis.banded_gain import BandedGain, BandGain
from sets.certificate import ROUNDING

SAMPLES = 200
"""Wheel speeds of a band at which its loops are compared with mixtures of corner loops."""


def find_band_gap(
    gain: BandedGain,
    schedules: Float[np.ndarray, "windows horizon 2"],
    regimes: Int[np.ndarray, "windows horizon"],
) -> float:
    """Return by how much a loop misses the mixtures of the corner loops of its band, along windows
    and all over the bands; infinite where the boxes over which W is bounded miss wheel speeds."""
    gaps = []
    for number, band in enumerate(gain.bands):
        shares = np.random.default_rng(0).dirichlet(np.ones(len(band.corners)), SAMPLES)
        used = schedules[regimes == number]
        points = np.concatenate([band.corners, shares @ band.corners, used])
        gaps.append(np.inf if _misses_boxes(band, points) else float(band.miss_at(points).max()))
    return max(gaps)


def _misses_boxes(band: BandGain, points: Float[np.ndarray, "k 2"]) -> bool:
    """Whether some wheel speeds lie in none of the boxes of a band."""
    lower = band.regions[:, 0] - ROUNDING
    upper = band.regions[:, 1] + ROUNDING
    in_box = np.all((points[:, None] >= lower) & (points[:, None] <= upper), axis=2)
    return not bool(in_box.any(axis=1).all())
