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
from jaxtube.synthesis.certificate.robot import assumptions
from jaxtube.synthesis.disturbance import ground_speed_limits, with_computed_bound
from jaxtube.synthesis.problem import Problem, input_constraints, make_problem
from jaxtube.synthesis.tightening import DecoupledGain, decoupled_gain, exact_loops
from sets import certificate as check
from sets.certificate import Certificate
from sets.invariant import MaximalRpi, maximal_rpi, minimal_rpi_bound
from sets.polytope import Polytope

COVER = 3
"""Boxes along the width of a band that cover it: more are tighter and take longer."""
RING = 60
SAMPLES = 200


@dataclass(frozen=True, eq=False)
class Band:
    """One band: the problem under its caps (regions: boxes that cover it), its gain and what its
    loops are hulls of."""

    corners: Float[np.ndarray, "p 2"]
    problem: Problem
    gain: DecoupledGain
    loops: Float[np.ndarray, "v 3 3"]

    @property
    def rows(self) -> Float[np.ndarray, "g k 3"]:
        """The band's input rows under its gain, one stack a corner."""
        return self.problem.input_rows.under(self.gain.at(self.problem.model.weights(self.corners)))


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
        weights = self.problem.model.weights(schedules)
        every = np.stack([band.gain.at(weights) for band in self.bands])
        return every[self.band_of(schedules), np.arange(len(schedules))]


def make_law(scenario: Scenario) -> BandedLaw:
    """Compute the disturbance sets of the bands, the invariant set of the law and its certificate.

    Raises:
        ScenarioError: as `make_problem`, or where W cannot be bounded.
    """
    started, problem = time.perf_counter(), make_problem(scenario)
    lower = [
        scenario.reference.wheel_speed_min_mps,
        *(band.below_mps for band in scenario.operating.bands),
    ]
    bands = tuple(_band(problem, m, lower[m], lower[m + 1]) for m in range(len(lower) - 1))
    loops = np.concatenate([band.loops for band in bands])
    supports = [band.problem.disturbance_set.support for band in bands for _ in band.loops]
    caps = _admissible(problem, bands)
    inner = Polytope(caps.normals, caps.offsets * (1 - check.ROUNDING) - check.ROUNDING)
    found = maximal_rpi(loops, inner, supports)
    shares = _shares(problem, bands, loops, supports, caps)
    certificate = _certify(problem, bands, found, shares)
    return BandedLaw(problem, bands, found, shares, certificate, time.perf_counter() - started)


def _band(problem: Problem, index: int, slowest: float, fastest: float) -> Band:
    """Return the band of mean wheel speeds between two ends."""
    settings = problem.scenario.operating.bands[index]
    names = [
        name for name in settings.__struct_fields__ if name not in ("below_mps", "tracking_gains")
    ]
    operating = msgspec.structs.replace(
        problem.scenario.operating, bands=(), **{name: getattr(settings, name) for name in names}
    )
    scenario = msgspec.structs.replace(problem.scenario, operating=operating)
    model, (low, high) = problem.model, problem.model.box
    strip = np.array([[0.5, 0.5], [-0.5, -0.5]])
    corners = (
        Polytope.box(low, high).intersect(Polytope(strip, np.array([fastest, -slowest]))).vertices()
    )
    input_set, input_rows = input_constraints(scenario, problem.robot)
    regions = _cover(low, high, slowest, fastest)
    mine = replace(
        problem, scenario=scenario, input_set=input_set, input_rows=input_rows, regions=regions
    )
    mine = with_computed_bound(mine)
    gain = decoupled_gain(problem, settings.tracking_gains)
    farthest = float(np.max(model.stretched(corners) / corners))
    loops = exact_loops(model, gain, np.concatenate([corners, farthest * corners]))
    return Band(corners, mine, gain, loops)


def _cover(low, high, slowest: float, fastest: float) -> Float[np.ndarray, "m 2 2"]:
    """Return boxes whose union holds every pair of wheel speeds in [low, high] with a mean between
    two ends."""
    count = max(int(np.ceil(COVER * (high[0] - low[0]) / (fastest - slowest))), 1)
    edges = np.linspace(low[0], high[0], count + 1)
    cells = np.array(
        [
            [[edges[i], edges[j]], [edges[i + 1], edges[j + 1]]]
            for i in range(count)
            for j in range(count)
        ]
    )
    means = cells.mean(axis=2)
    return cells[(means[:, 0] <= fastest) & (means[:, 1] >= slowest)]


def _admissible(problem: Problem, bands) -> Polytope:
    """Return {e in E_op : the inputs of every band lie within its caps}."""
    E = problem.operating_set
    rows = [rows for band in bands for rows in band.rows]
    offsets = [band.problem.input_rows.offsets for band in bands for _ in band.rows]
    return Polytope(np.concatenate([E.normals, *rows]), np.concatenate([E.offsets, *offsets]))


def _shares(problem: Problem, bands, loops, supports, caps: Polytope) -> dict[str, float]:
    """Return the share of E_op's caps, and of the input caps of every band, that the law's tube
    fills at its widest."""
    E, angles = problem.operating_set, 2 * np.pi * np.arange(RING) / RING
    ring = np.stack(
        [np.zeros(RING), *(np.stack([np.cos(angles), np.sin(angles)]) / E.offsets[1:3, None])],
        axis=1,
    )
    bound = minimal_rpi_bound(
        loops, supports, np.concatenate([caps.normals / caps.offsets[:, None], ring])
    )
    names = ["longitudinal error", "lateral error", "heading error"]
    names += [f"inputs of band {m + 1}" for m in range(len(bands))]
    if bound is None:
        return dict.fromkeys(names, np.inf)
    shares = list((bound.support(E.normals) / E.offsets).reshape(2, -1).max(axis=0))
    for band in bands:
        offsets = band.problem.input_rows.offsets
        shares += [np.max([bound.support(rows) / offsets for rows in band.rows])]
    return dict(zip(names, map(float, shares), strict=True))


def _certify(problem: Problem, bands, found: MaximalRpi, shares) -> Certificate:
    """Re-check the law: invariance band by band, caps, wheel limits, coverage, W."""
    certificate, omega = Certificate(), found.polytope
    binding = max(shares, key=lambda name: shares[name])
    if omega is None:
        certificate.add(
            "invariant_set",
            1 - shares[binding],
            "",
            f"No invariant set was found inside the caps; {binding} binds, at {shares[binding]:.1%} of its cap.",
        )
    else:
        margins = [
            check.invariance_margin(band.loops, band.problem.disturbance_set.vertices(), omega)
            for band in bands
        ]
        certificate.add(
            "invariant_set",
            min(margins),
            f"A set of {len(omega.offsets)} facets is invariant for every band's loops and disturbances, in any order.",
            f"Some band leaves the set by {-min(margins):.3g}.",
        )
        margin = _admissible(problem, bands).containment_margin(omega)
        certificate.add(
            "caps",
            margin,
            "On the set errors and inputs keep the caps of every band.",
            f"On the set a cap is passed by {-margin:.3g}.",
        )
    slowest, fastest = ground_speed_limits(problem)
    speeds = np.stack([_bound(band).ground_speeds for band in bands])
    least, greatest = speeds[:, 0].min(axis=0), speeds[:, 1].max(axis=0)
    room = min(np.min(fastest - greatest), np.min(least - slowest))
    certificate.add(
        "wheel_limits",
        float(room),
        f"Ground speeds of {least.min():.3f} to {greatest.max():.3f} m/s may be asked for; {room:.3g} m/s to spare.",
        f"Ground speeds of {least.min():.3f} to {greatest.max():.3f} m/s may be asked for: {-room:.3g} m/s too much.",
    )
    gap = max(coverage_gap(band) for band in bands)
    certificate.add(
        "vertices_cover_bands",
        check.ROUNDING - gap,
        "At sampled wheel speeds every loop of a band is a mixture of its corner loops, and its boxes cover them.",
        f"Some loop of a band differs from mixtures of its corner loops by {gap:.3g}.",
    )
    wide = min(np.min(band.problem.disturbance_set.offsets - _supports(band)) for band in bands)
    certificate.assumptions = assumptions(problem)
    certificate.add(
        "disturbance_bound_proved",
        float(wide) + check.ROUNDING,
        "W of every band holds every disturbance of the robot there, proved by interval arithmetic.",
        f"W of some band is narrower than the proved bound by {-wide:.3g}.",
    )
    return certificate


def _bound(band: Band):
    assert band.problem.residual is not None
    return band.problem.residual


def _supports(band: Band) -> Float[np.ndarray, " k"]:
    return _bound(band).support(band.problem.disturbance_set.normals)


def coverage_gap(band: Band) -> float:
    """Return by how much loops at sampled wheel speeds miss those of their stretched speeds, or
    these the corners'."""
    shares = np.random.default_rng(0).dirichlet(np.ones(len(band.corners)), SAMPLES)
    points = np.concatenate([band.corners, shares @ band.corners])
    model = band.problem.model
    farthest = float(np.max(model.stretched(band.corners) / band.corners))
    hull = Polytope.from_vertices(np.concatenate([band.corners, farthest * band.corners]))
    lower, upper = band.problem.regions[:, 0], band.problem.regions[:, 1]
    inside = np.all(
        (points[:, None] >= lower - check.ROUNDING) & (points[:, None] <= upper + check.ROUNDING),
        axis=2,
    )
    if not inside.any(axis=1).all():
        return np.inf
    stretched, (A, B) = model.stretched(points), model.matrices(points)
    found = A + B @ band.gain.at(model.weights(points))
    missed = float(np.max(np.abs(found - exact_loops(model, band.gain, stretched))))
    return max(missed, -float(np.min(hull.margin(stretched))))
