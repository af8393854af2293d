"""Gains, caps and disturbance sets by speed: a design over a wide range of wheel speeds.

    u = g + K_m(th) (e - e_nominal),   K_m = [[-k1, -Om, 0], [0, -k2, -k3]],   mean speed in band m

With one gain and one W for all speeds a slow robot is asked to correct what only a fast one
suffers. Here each band is a regime of its own (`regimes`): W_m bounds the disturbances over the
band alone, under the band's caps. The bands of a plan's periods are known with the reference, so
the tube along it sums the W of each, and a stage keeps the caps of the band that its period has.
One terminal set holds for all bands, under arbitrary changes of speed:

    Phi Omega + W_m in Omega    for every loop Phi of band m,    Omega in E_op,
    K_m(th) e in the caps of band m on Omega,

and so does one terminal cost.

Source: new.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import msgspec
import numpy as np
from jaxtyping import Float

from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.banded_gain import BandedGain, band_corners
from jaxtube.synthesis.gains import decoupled_gain
from jaxtube.synthesis.limits import InputRows, input_constraints
from jaxtube.synthesis.problem import Problem, with_regimes
from jaxtube.synthesis.regimes import RegimesBySpeed
from sets.polytope import Polytope

COVER = 3
"""Boxes along the width of a band that cover it: more are tighter and take longer."""


INPUT_CAPS = (
    "speed_deficit_min_mps",
    "speed_deficit_max_mps",
    "yaw_rate_deficit_radps",
    "turning_longitudinal_m",
    "turning_yaw_rate_radps",
)
"""Caps that each band has."""


def split_bands(problem: Problem) -> list[Problem]:
    """Return the problem of every band from slow to fast: its caps, its gain, and regions that
    cover it, for W to be bounded over."""
    ends = list_ends(problem.scenario)
    return [_make_band(problem, index, *of_band) for index, of_band in enumerate(pairwise(ends))]


def join_bands(problem: Problem, bands: list[Problem]) -> Problem:
    """Return the problem whose regimes are its bands, each with its W; its own inputs are the
    smallest box that holds those of every band."""
    axes = np.eye(2)
    upper = np.max([band.input_set.support(axes) for band in bands], axis=0)
    lower = -np.max([band.input_set.support(-axes) for band in bands], axis=0)
    input_set = Polytope.box(lower, upper)
    joined = with_regimes(problem, bands, rule_of_bands(problem.scenario))
    return replace(joined, input_set=input_set, input_rows=InputRows.from_set(input_set))


def banded_gain(problem: Problem, numbers: Float[np.ndarray, "bands 3"]) -> BandedGain:
    """Return the gain of k1 (1/s), k2 (rad/(m s)) and k3 (1/s) of every band."""
    by_band = [decoupled_gain(problem, row) for row in numbers]
    ends = list_ends(problem.scenario)
    return BandedGain(
        model=problem.model,
        nominal=np.stack([gain.nominal for gain in by_band]),
        vertices=np.stack([gain.vertices for gain in by_band]),
        regions=np.concatenate([regime.regions for regime in problem.every_regime]),
        rule=problem.rule,
        corners=tuple(band_corners(problem.model, *of_band) for of_band in pairwise(ends)),
        band_regions=tuple(regime.regions for regime in problem.every_regime),
    )


def rule_of_bands(scenario: Scenario) -> RegimesBySpeed:
    """Return the rule that numbers the bands of a scenario."""
    return RegimesBySpeed(tuple(list_ends(scenario)[1:]))


def list_ends(scenario: Scenario) -> list[float]:
    """Return the mean wheel speeds at which bands begin, and where the last one ends, m/s."""
    slowest = scenario.reference.wheel_speed_min_mps
    return [slowest, *(band.below_mps for band in scenario.operating.bands)]


def _make_band(problem: Problem, index: int, slowest: float, fastest: float) -> Problem:
    """Return the problem of mean wheel speeds between two ends."""
    scenario = with_band_alone(problem.scenario, index)
    input_set, input_rows = input_constraints(scenario, problem.robot)
    return replace(
        problem,
        scenario=scenario,
        input_set=input_set,
        input_rows=input_rows,
        regions=_covering_boxes(*problem.model.box, slowest, fastest),
    )


def with_band_alone(scenario: Scenario, index: int) -> Scenario:
    """Return the scenario with input caps and gains of a band in the place of all bands."""
    settings = scenario.operating.bands[index]
    of_law = ("below_mps", "tracking_gains")
    caps = {
        name: getattr(settings, name) for name in settings.__struct_fields__ if name not in of_law
    }
    change = msgspec.structs.replace
    return change(
        scenario,
        operating=change(scenario.operating, bands=(), **caps),
        controller=change(scenario.controller, tracking_gains=settings.tracking_gains),
    )


def read_band_values(scenario: Scenario) -> tuple[float, ...]:
    """Return the caps on inputs, the least speed deficit by its size, and the gains of every band,
    one band after the other."""
    return tuple(
        value
        for band in scenario.operating.bands
        for value in (*(abs(getattr(band, name)) for name in INPUT_CAPS), *band.tracking_gains)
    )


def with_band_values(scenario: Scenario, values: Sequence[float]) -> Scenario:
    """Return the scenario with caps and gains of its bands in the order of `read_band_values`."""
    change = msgspec.structs.replace
    count = len(INPUT_CAPS)
    bands = []
    by_band = np.reshape(values, (len(scenario.operating.bands), -1)).tolist()
    for band, numbers in zip(scenario.operating.bands, by_band, strict=True):
        caps = dict(zip(INPUT_CAPS, numbers[:count], strict=True))
        caps["speed_deficit_min_mps"] *= -1
        bands.append(change(band, **caps, tracking_gains=tuple(numbers[count:])))
    return change(scenario, operating=change(scenario.operating, bands=tuple(bands)))


def _covering_boxes(
    low: Float[np.ndarray, "2"], high: Float[np.ndarray, "2"], slowest: float, fastest: float
) -> Float[np.ndarray, "m 2 2"]:
    """Return boxes whose union holds every pair of wheel speeds in [low, high] with a mean between
    two ends."""
    count = max(int(np.ceil(COVER * (high[0] - low[0]) / (fastest - slowest))), 1)
    edges = np.linspace(low[0], high[0], count + 1)
    right, left = np.indices((count, count)).reshape(2, -1)
    lower = np.stack([edges[right], edges[left]], axis=1)
    upper = np.stack([edges[right + 1], edges[left + 1]], axis=1)
    meets_band = (lower.mean(axis=1) <= fastest) & (upper.mean(axis=1) >= slowest)
    return np.stack([lower, upper], axis=1)[meets_band]
