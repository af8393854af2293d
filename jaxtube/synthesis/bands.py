"""Gains, caps and disturbance sets by speed: a scheduled tracking law, certified over a wide range
of wheel speeds.

    u = K_m(th) e,    K_m = [[-k1, -Om, 0], [0, -k2, -k3]]        for mean wheel speeds V in band m

With one gain and one W for all speeds a slow robot is asked to correct what only a fast one
suffers. Here each band has its own: W_m bounds the disturbances over the band alone, under the
band's caps. One invariant set holds for all, under arbitrary changes of speed:

    Phi Omega + W_m in Omega    for every loop Phi of band m,     Omega in E_op,     u in the caps of band m on Omega.

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

from jaxtube.scenario import Scenario
from jaxtube.synthesis.certificate.fill import ring_normals
from jaxtube.synthesis.certificate.robot import (
    assumptions,
    check_disturbance_set,
    check_true_error,
)
from jaxtube.synthesis.disturbance import ground_speed_limits, with_computed_bound
from jaxtube.synthesis.gains import Gain, decoupled_gain, exact_loops
from jaxtube.synthesis.problem import Problem, input_constraints, make_problem
from sets import certificate as check
from sets.certificate import Certificate, Condition, judge
from sets.invariant import MaximalRpi, maximal_rpi, minimal_rpi_bound
from sets.polytope import Polytope, SupportFunction
from sets.robot.disturbance import DisturbanceBound

COVER = 3
"""Boxes along the width of a band that cover it: more are tighter and take longer."""
SAMPLES = 200
"""Wheel speeds of a band at which its loops are compared with mixtures of corner loops."""


@dataclass(frozen=True, eq=False)
class Band:
    """One band: the problem under its caps (regions: boxes that cover it), its gain and what its
    loops are hulls of."""

    corners: Float[np.ndarray, "p 2"]
    problem: Problem
    gain: Gain
    loops: Float[np.ndarray, "v 3 3"]

    @property
    def rows(self) -> Float[np.ndarray, "g k 3"]:
        """The band's input rows under its gain, one stack a corner."""
        return self.problem.input_rows.on_errors(self.gain.along(self.corners))

    @property
    def bound(self) -> DisturbanceBound:
        """What the band's W was computed from."""
        assert self.problem.disturbance_bound is not None
        return self.problem.disturbance_bound

    @property
    def farthest_stretch(self) -> float:
        """The greatest factor by which wheel speeds in the band are stretched."""
        return float(np.max(self.problem.model.stretched(self.corners) / self.corners))


@dataclass(frozen=True, eq=False)
class BandedLaw:
    """The scheduled law: its bands from slow to fast, the invariant set, shares of the caps,
    certificate, seconds."""

    problem: Problem
    bands: tuple[Band, ...]
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
    caps = _admissible_set(problem, bands)
    inner = Polytope(caps.normals, caps.offsets * (1 - check.ROUNDING) - check.ROUNDING)
    invariant = maximal_rpi(loops, inner, supports)
    shares = _cap_shares(problem, bands, loops, supports)
    certificate = certify_law(problem, bands, invariant, shares)
    seconds = time.perf_counter() - started
    return BandedLaw(problem, bands, invariant, shares, certificate, seconds)


def _make_bands(problem: Problem) -> tuple[Band, ...]:
    """Return the bands from slow to fast, each from the end of the one before."""
    made = []
    slowest = problem.scenario.reference.wheel_speed_min_mps
    for index, settings in enumerate(problem.scenario.operating.bands):
        made.append(_make_band(problem, index, slowest, settings.below_mps))
        slowest = settings.below_mps
    return tuple(made)


def _make_band(problem: Problem, index: int, slowest: float, fastest: float) -> Band:
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
    band = Band(corners, with_computed_bound(of_band), gain, np.zeros((0, 3, 3)))
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


def _admissible_set(problem: Problem, bands: tuple[Band, ...]) -> Polytope:
    """Return {e in E_op : the inputs of every band lie within its caps}."""
    E = problem.operating_set
    rows = [rows for band in bands for rows in band.rows]
    offsets = [band.problem.input_rows.offsets for band in bands for _ in band.rows]
    return Polytope(np.concatenate([E.normals, *rows]), np.concatenate([E.offsets, *offsets]))


def _cap_shares(
    problem: Problem,
    bands: tuple[Band, ...],
    loops: Float[np.ndarray, "v 3 3"],
    supports: list[SupportFunction],
) -> dict[str, float]:
    """Return the share of E_op's caps, and of the input caps of every band, that the law's tube
    fills at its widest."""
    E = problem.operating_set
    caps = _admissible_set(problem, bands)
    normals = np.concatenate([caps.normals / caps.offsets[:, None], ring_normals(problem)])
    tube = minimal_rpi_bound(loops, supports, normals)
    names = ["longitudinal error", "lateral error", "heading error"]
    names += [f"inputs of band {number}" for number in range(1, len(bands) + 1)]
    if tube is None:
        return dict.fromkeys(names, np.inf)
    shares = list((tube.support(E.normals) / E.offsets).reshape(2, -1).max(axis=0))
    for band in bands:
        offsets = band.problem.input_rows.offsets
        shares.append(np.max([tube.support(rows) / offsets for rows in band.rows]))
    return dict(zip(names, map(float, shares), strict=True))


def certify_law(
    problem: Problem, bands: tuple[Band, ...], invariant: MaximalRpi, shares: dict[str, float]
) -> Certificate:
    """Re-check the law: invariance band by band, caps, wheel limits, coverage, W."""
    conditions = [
        *_check_invariance(problem, bands, invariant.polytope, shares),
        _check_coverage(bands),
        check_true_error(problem),
        _check_disturbance_sets(bands),
        _check_wheels(problem, bands),
    ]
    return Certificate(tuple(conditions), assumptions(problem, any_order=True))


def _check_invariance(
    problem: Problem, bands: tuple[Band, ...], omega: Polytope | None, shares: dict[str, float]
) -> list[Condition]:
    if omega is None:
        binding = max(shares, key=lambda name: shares[name])
        sentence = (
            f"No invariant set was found inside the caps; {binding} binds, at "
            f"{shares[binding]:.1%} of its cap."
        )
        missing = 1 - shares[binding]
        margin = missing if missing < 0 else -np.inf
        return [Condition("invariant_set", margin, sentence)]
    margin = min(
        check.invariance_margin(band.loops, band.problem.disturbance_set.vertices(), omega)
        for band in bands
    )
    invariance = judge(
        "invariant_set",
        margin,
        f"A set of {len(omega.offsets)} facets is invariant for every band's loops and "
        "disturbances, in any order.",
        f"Some band leaves the set by {-margin:.3g}.",
    )
    margin = _admissible_set(problem, bands).containment_margin(omega)
    caps = judge(
        "caps",
        margin,
        "On the set errors and inputs keep the caps of every band.",
        f"On the set a cap is passed by {-margin:.3g}.",
    )
    return [invariance, caps]


def _check_wheels(problem: Problem, bands: tuple[Band, ...]) -> Condition:
    slowest, fastest = ground_speed_limits(problem)
    speeds = np.stack([band.bound.ground_speeds for band in bands])
    least = speeds[:, 0].min(axis=0)
    greatest = speeds[:, 1].max(axis=0)
    room = float(min(np.min(fastest - greatest), np.min(least - slowest)))
    asked = f"Ground speeds of {least.min():.3f} to {greatest.max():.3f} m/s may be asked for"
    return judge(
        "wheel_limits",
        room,
        f"{asked}; {room:.3g} m/s to spare.",
        f"{asked}: {-room:.3g} m/s too much.",
        "robot",
    )


def _check_coverage(bands: tuple[Band, ...]) -> Condition:
    gap = max(coverage_gap(band) for band in bands)
    return judge(
        "vertices_cover_bands",
        check.ROUNDING - gap,
        "At sampled wheel speeds every loop of a band is a mixture of its corner loops, and its "
        "boxes cover them.",
        f"Some loop of a band differs from mixtures of its corner loops by {gap:.3g}.",
    )


def _check_disturbance_sets(bands: tuple[Band, ...]) -> Condition:
    """Return the condition on the W that has least room, of all bands."""
    return min(
        (check_disturbance_set(band.problem) for band in bands),
        key=lambda condition: condition.margin,
    )


def coverage_gap(band: Band) -> float:
    """Return by how much loops at sampled wheel speeds miss those of their stretched speeds, or
    these the corners'; infinite where the boxes miss some of the band."""
    shares = np.random.default_rng(0).dirichlet(np.ones(len(band.corners)), SAMPLES)
    points = np.concatenate([band.corners, shares @ band.corners])
    lower = band.problem.regions[:, 0] - check.ROUNDING
    upper = band.problem.regions[:, 1] + check.ROUNDING
    in_box = np.all((points[:, None] >= lower) & (points[:, None] <= upper), axis=2)
    if not in_box.any(axis=1).all():
        return np.inf
    stretched = band.problem.model.stretched(points)
    missed = np.abs(band.gain.loops_along(points) - exact_loops(band.gain, stretched))
    far_corners = band.farthest_stretch * band.corners
    hull = Polytope.from_vertices(np.concatenate([band.corners, far_corners]))
    return max(float(np.max(missed)), -float(np.min(hull.margin(stretched))))
