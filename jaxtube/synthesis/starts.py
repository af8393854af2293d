"""Starts of the search for caps and tracking gains: made for the robot at hand, so that no number
is right for one size or speed only.

    caps <- R(caps) / ratio,    R the estimated tube of W(caps)

from small caps on, for a few gains of usual damping: the caps that their own tube fills alike. The
iteration stops where caps reach the limits; a start need not hold anything, only have a bounded
tube.

Source: new.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np
from jaxtyping import Float

from jaxtube.scenario.tree import BandTable, Operating, Scenario
from jaxtube.synthesis.banded_estimate import BandedEstimate
from jaxtube.synthesis.bands import read_band_values, with_band_values
from jaxtube.synthesis.corners import CAPS_AND_GAINS, ERROR_CAPS, NAMES
from jaxtube.synthesis.estimate import Estimate


class Damping(NamedTuple):
    """Gains without units: (V T) T k2 and T k3."""

    lateral: float
    heading: float


DAMPINGS = (
    Damping(0.0135, 0.15),
    Damping(0.019, 0.25),
    Damping(0.024, 0.4),
    Damping(0.048, 0.4),
    Damping(0.127, 0.65),
)
"""From soft to hard, damping ratios of 0.3 to 0.65; all bound a tube at a constant speed."""
FORWARD = 0.95
"""T k1 of every start."""
RATIO = 0.6
"""Share of its caps that the tube of a start fills, where there is room."""
COUPLED = 0.2
"""Share of the coupling's part of the ratio that the longitudinal error takes."""
FIRST = 0.1
"""Caps at first, as shares of the limits, of the speed, and of three radians a period."""
ROUNDS = 12
"""Iterations at most."""
STILL = 0.02
"""Relative change at which caps have settled."""
START_ROOM = 1.2
"""Times the start's error that caps have at least."""
COUPLED_ROOM = 1.45
"""Times the start's longitudinal error that the coupling leaves without turning, at least."""
FASTEST_TURN = 3.0
"""Yaw rate deficit at most, rad in a period."""


def make_starts(estimate: Estimate | BandedEstimate) -> list[Float[np.ndarray, " k"]]:
    """Return starts as logarithms of caps and gains, those first that miss least."""
    if isinstance(estimate, BandedEstimate):
        return _make_banded_starts(estimate)
    made = [_grow_caps(estimate, damping) for damping in DAMPINGS]
    judged = []
    for start in made:
        shares = estimate.shares(start)
        if shares is not None:
            judged.append((max(float(shares.caps.max()), float(shares.limits.max())), start))
    return [start for _, start in sorted(judged, key=lambda pair: pair[0])]


def _make_banded_starts(estimate: BandedEstimate) -> list[Float[np.ndarray, " k"]]:
    """Return the start that each band alone would have, with the widest caps of the error among
    them; none where some band has none."""
    alone = [make_starts(band)[:1] for band in estimate.bands]
    if not all(alone):
        return []
    points = np.concatenate(alone)
    return [np.append(points[:, :ERROR_CAPS].max(axis=0), points[:, ERROR_CAPS:])]


def caps_and_gains(scenario: Scenario) -> tuple[float, ...] | None:
    """Return the scenario's own caps, tracking gains and observer's gain, where it has one, as a
    start of the search; of bands those of each after the caps of the error. None where caps or
    tracking gains are missing."""
    if scenario.operating.bands:
        errors = [getattr(scenario.operating, name) for name in NAMES[:ERROR_CAPS]]
        is_bare = any(band.list_missing() for band in scenario.operating.bands)
        return None if is_bare or None in errors else (*errors, *read_band_values(scenario))
    caps = [getattr(scenario.operating, name) for name in NAMES]
    settings = scenario.controller
    if None in caps or not settings.tracking_gains:
        return None
    observed = settings.observer_gain if settings.has_observer else ()
    return (*(abs(cap) for cap in caps), *settings.tracking_gains, *observed)


def with_caps_and_gains(scenario: Scenario, values: Sequence[float]) -> Scenario:
    """Return the scenario with caps and gains in the order of a point of the search."""
    if scenario.operating.bands:
        errors = dict(zip(NAMES, values[:ERROR_CAPS], strict=False))
        operating = msgspec.structs.replace(scenario.operating, **errors)
        widened = msgspec.structs.replace(scenario, operating=operating)
        return with_band_values(widened, values[ERROR_CAPS:])
    caps = dict(zip(NAMES, values[:8], strict=True))
    caps["speed_deficit_min_mps"] *= -1
    gains = {"tracking_gains": tuple(values[8:CAPS_AND_GAINS])}
    if len(values) > CAPS_AND_GAINS:
        gains["observer_gain"] = tuple(values[CAPS_AND_GAINS:])
    change = msgspec.structs.replace
    return change(
        scenario,
        operating=change(scenario.operating, **caps),
        controller=change(scenario.controller, **gains),
    )


def without_caps(scenario: Scenario) -> Scenario:
    """Return the scenario without the caps and gains that a search replaces."""
    return msgspec.structs.replace(
        scenario,
        operating=Operating(
            bands=tuple(BandTable(below_mps=band.below_mps) for band in scenario.operating.bands)
        ),
        controller=msgspec.structs.replace(scenario.controller, tracking_gains=()),
    )


def _grow_caps(estimate: Estimate, damping: Damping) -> Float[np.ndarray, " 11"]:
    """Return the caps that the tube of these gains fills alike, within limits where it can be."""
    T = estimate.period.dt
    way = float(estimate.extreme_c.mean())
    limits = estimate.error_limits
    turn = FASTEST_TURN / T
    caps = FIRST * np.array([*limits, way / T, way / T, turn, 2 * limits[0], 2 * turn])
    gains = np.array([FORWARD / T, damping.lateral / (way * T), damping.heading / T])
    for _ in range(ROUNDS):
        shares = estimate.shares(_to_point(caps, gains))
        if shares is None:
            break
        grown = np.sqrt(
            caps * _fill_alike(estimate, shares.caps[0, [0, 1, 2, 3, 5]] * caps[[0, 1, 2, 3, 5]])
        )
        is_still = np.all(np.abs(np.log(grown / caps)) < STILL)
        caps = grown
        if is_still:
            break
    return _to_point(caps, gains)


def _fill_alike(estimate: Estimate, reach: Float[np.ndarray, "5"]) -> Float[np.ndarray, " 8"]:
    """Return caps that a tube of this reach fills alike: as little as limits, wheels and start
    allow, but no less than `RATIO`."""
    start = estimate.start
    wheel = reach[3] + reach[4] * estimate.period.track_width / 2
    fastest = estimate.fastest - float(estimate.corners.schedules.max())
    ratio = max(RATIO, float(np.max(reach[:3] / estimate.error_limits)), wheel / fastest)
    errors = np.minimum(np.maximum(reach[:3] / ratio, START_ROOM * start), estimate.error_limits)
    slower, turning = reach[3:] / ratio
    a = max(reach[0] / (COUPLED * ratio), COUPLED_ROOM * start[0])
    b = reach[4] / (ratio - reach[0] / a)
    return np.array([*errors, slower, slower, turning, a, b])


def _to_point(
    caps: Float[np.ndarray, " 8"], gains: Float[np.ndarray, "3"]
) -> Float[np.ndarray, " 11"]:
    """Return the point of the search with caps in SI units."""
    point = np.log(np.concatenate([caps, gains]))
    point[2] += np.log(np.rad2deg(1.0))
    return point
