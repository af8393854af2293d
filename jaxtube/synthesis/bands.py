"""Gains, caps and disturbance sets by speed: a scheduled tracking law, certified over a wide range
of wheel speeds.

    u = K_m(th) e,    K_m = [[-k1, -Om, 0], [0, -k2, -k3]]        for mean wheel speeds V in band m

With one gain and one W for all speeds a slow robot is asked to correct what only a fast one
suffers. Here each band has its own: W_m bounds the disturbances over the band alone, under the
band's caps. One invariant set holds for all, under arbitrary changes of speed:

    Phi Omega + W_m in Omega    for every loop Phi of band m,    Omega in E_op,
    u in the caps of band m on Omega.

A band is a polygon of wheel speeds v. Stretched by tan(x) / x in [1, f], x = T Om / 2, it lies in
the hull of v and f v over its corners, in which the loops of the exact Jacobian are affine. W_m is
bounded over boxes that cover the polygon.

Source: new.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import msgspec
import numpy as np
from jaxtyping import Float, Int

from jaxtube.coordinates import ERROR_NAMES
from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.certificate.fill import ring_normals
from jaxtube.synthesis.certificate.law import LawBand, certify_law, law_admissible_set
from jaxtube.synthesis.disturbance import with_computed_bound
from jaxtube.synthesis.gains import decoupled_gain, exact_loops
from jaxtube.synthesis.limits import input_constraints
from jaxtube.synthesis.problem import Problem, make_problem
from sets.certificate import ROUNDING, Certificate
from sets.invariant import MaximalRpi, maximal_rpi, minimal_rpi_bound
from sets.polytope import Polytope, SupportFunction

COVER = 3
"""Boxes along the width of a band that cover it: more are tighter and take longer."""


@dataclass(frozen=True, eq=False)
class BandedLaw:
    """The scheduled law: its bands from slow to fast, the invariant set, shares of the caps,
    certificate, seconds."""

    problem: Problem
    bands: tuple[LawBand, ...]
    invariant: MaximalRpi
    shares: dict[str, float]
    certificate: Certificate
    seconds: float

    def band_of(self, schedules: Float[np.ndarray, "k 2"]) -> Int[np.ndarray, " k"]:
        """Return the band of every pair of wheel speeds."""
        ends = [band.below_mps for band in self.problem.scenario.operating.bands[:-1]]
        return np.searchsorted(ends, schedules.mean(axis=1), side="left")

    def gains(self, schedules: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "k 2 3"]:
        """Return the gains of the law along wheel speeds."""
        by_band = np.stack([band.gain.along(schedules) for band in self.bands])
        return by_band[self.band_of(schedules), np.arange(len(schedules))]


def make_law(scenario: Scenario) -> BandedLaw:
    """Compute the disturbance sets of the bands, the invariant set of the law and its certificate.

    Raises:
        ScenarioError: as `make_problem`, or where W cannot be bounded.
    """
    started = time.perf_counter()
    problem = make_problem(scenario)
    bands = _make_bands(problem)
    loops = np.concatenate([band.loops for band in bands])
    supports = [band.problem.disturbance_set.support for band in bands for _ in band.loops]
    caps = law_admissible_set(problem, bands)
    inner = Polytope(caps.normals, caps.offsets * (1 - ROUNDING) - ROUNDING)
    invariant = maximal_rpi(loops, inner, supports)
    shares = _cap_shares(problem, bands, loops, supports)
    certificate = certify_law(problem, bands, invariant.polytope, shares)
    seconds = time.perf_counter() - started
    return BandedLaw(problem, bands, invariant, shares, certificate, seconds)


def _make_bands(problem: Problem) -> tuple[LawBand, ...]:
    """Return the bands from slow to fast, each from the end of the one before."""
    made = []
    slowest = problem.scenario.reference.wheel_speed_min_mps
    for index, settings in enumerate(problem.scenario.operating.bands):
        made.append(_make_band(problem, index, slowest, settings.below_mps))
        slowest = settings.below_mps
    return tuple(made)


def _make_band(problem: Problem, index: int, slowest: float, fastest: float) -> LawBand:
    """Return the band of mean wheel speeds between two ends."""
    settings = problem.scenario.operating.bands[index]
    scenario = _with_caps_of_band(problem.scenario, index)
    low, high = problem.model.box
    mean = np.array([[0.5, 0.5], [-0.5, -0.5]])
    strip = Polytope(mean, np.array([fastest, -slowest]))
    corners = Polytope.box(low, high).intersect(strip).vertices()
    input_set, input_rows = input_constraints(scenario, problem.robot)
    of_band = replace(
        problem,
        scenario=scenario,
        input_set=input_set,
        input_rows=input_rows,
        regions=_covering_boxes(low, high, slowest, fastest),
    )
    gain = decoupled_gain(problem, settings.tracking_gains)
    band = LawBand(corners, with_computed_bound(of_band), gain, np.zeros((0, 3, 3)))
    stretched = np.concatenate([corners, band.farthest_stretch * corners])
    return replace(band, loops=exact_loops(gain, stretched))


def _with_caps_of_band(scenario: Scenario, index: int) -> Scenario:
    """Return the scenario with the input caps of a band in the place of all bands."""
    settings = scenario.operating.bands[index]
    of_law = ("below_mps", "tracking_gains")
    caps = {
        name: getattr(settings, name) for name in settings.__struct_fields__ if name not in of_law
    }
    operating = msgspec.structs.replace(scenario.operating, bands=(), **caps)
    return msgspec.structs.replace(scenario, operating=operating)


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


def _cap_shares(
    problem: Problem,
    bands: tuple[LawBand, ...],
    loops: Float[np.ndarray, "v 3 3"],
    supports: list[SupportFunction],
) -> dict[str, float]:
    """Return the share of E_op's caps, and of the input caps of every band, that the law's tube
    fills at its widest."""
    E = problem.operating_set
    caps = law_admissible_set(problem, bands)
    normals = np.concatenate(
        [caps.normals / caps.offsets[:, None], ring_normals(problem.operating_set.offsets)]
    )
    tube = minimal_rpi_bound(loops, supports, normals)
    of_bands = [f"inputs of band {number}" for number in range(1, len(bands) + 1)]
    names = [*ERROR_NAMES, *of_bands]
    if tube is None:
        return dict.fromkeys(names, np.inf)
    shares = list((tube.support(E.normals) / E.offsets).reshape(2, -1).max(axis=0))
    for band in bands:
        offsets = band.problem.input_rows.offsets
        shares.append(np.max([tube.support(rows) / offsets for rows in band.rows]))
    return dict(zip(names, map(float, shares), strict=True))
