"""The certificate of a tracking law scheduled on speed: its bands, and the conditions on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxtube.synthesis.certificate.assumptions import assumptions
from jaxtube.synthesis.certificate.robot import (
    check_disturbance_set,
    judge_wheel_limits,
)
from jaxtube.synthesis.certificate.true_error import check_true_error
from jaxtube.synthesis.disturbance import prove_bound
from jaxtube.synthesis.gains import Gain, exact_loops
from jaxtube.synthesis.problem import Problem
from sets.certificate import ROUNDING, Certificate, Condition, invariance_margin, judge
from sets.polytope import Polytope
from sets.robot.disturbance import DisturbanceBound

SAMPLES = 200
"""Wheel speeds of a band at which its loops are compared with mixtures of corner loops."""


@dataclass(frozen=True, eq=False)
class LawBand:
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
        """What is proved of the band's disturbances."""
        return prove_bound(self.problem)

    @property
    def farthest_stretch(self) -> float:
        """The greatest factor by which wheel speeds in the band are stretched."""
        return float(np.max(self.problem.model.stretched(self.corners) / self.corners))


def law_admissible_set(problem: Problem, bands: tuple[LawBand, ...]) -> Polytope:
    """Return {e in E_op : the inputs of every band lie within its caps}."""
    E = problem.operating_set
    rows = [rows for band in bands for rows in band.rows]
    offsets = [band.problem.input_rows.offsets for band in bands for _ in band.rows]
    return Polytope(np.concatenate([E.normals, *rows]), np.concatenate([E.offsets, *offsets]))


def certify_law(
    problem: Problem, bands: tuple[LawBand, ...], omega: Polytope | None, shares: dict[str, float]
) -> Certificate:
    """Re-check a law: invariance of Omega band by band, caps, coverage, W, wheel limits.

    Args:
        problem: of the whole range, without the bands' caps.
        bands: from slow to fast.
        omega: the invariant set, None where none was found.
        shares: of each cap that the law's tube fills; told where there is no set.
    """
    conditions = [
        *_check_invariance(problem, bands, omega, shares),
        _check_coverage(bands),
        check_true_error(problem),
        _check_disturbance_sets(bands),
        _check_wheels(problem, bands),
    ]
    return Certificate(tuple(conditions), assumptions(problem, any_order=True))


def _check_invariance(
    problem: Problem, bands: tuple[LawBand, ...], omega: Polytope | None, shares: dict[str, float]
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
        invariance_margin(band.loops, band.problem.disturbance_set.vertices(), omega)
        for band in bands
    )
    invariance = judge(
        "invariant_set",
        margin,
        f"A set of {len(omega.offsets)} facets is invariant for every band's loops and "
        "disturbances, in any order.",
        f"Some band leaves the set by {-margin:.3g}.",
    )
    margin = law_admissible_set(problem, bands).containment_margin(omega)
    caps = judge(
        "caps",
        margin,
        "On the set errors and inputs keep the caps of every band.",
        f"On the set a cap is passed by {-margin:.3g}.",
    )
    return [invariance, caps]


def _check_wheels(problem: Problem, bands: tuple[LawBand, ...]) -> Condition:
    speeds = np.stack([band.bound.ground_speeds for band in bands])
    least = speeds[:, 0].min(axis=0)
    greatest = speeds[:, 1].max(axis=0)
    return judge_wheel_limits(
        problem, np.stack([least, greatest]), "{:.3g} m/s to spare", "{:.3g} m/s too much"
    )


def _check_coverage(bands: tuple[LawBand, ...]) -> Condition:
    gap = max(coverage_gap(band) for band in bands)
    return judge(
        "vertices_cover_bands",
        ROUNDING - gap,
        "At sampled wheel speeds every loop of a band is a mixture of its corner loops, and its "
        "boxes cover them.",
        f"Some loop of a band differs from mixtures of its corner loops by {gap:.3g}.",
    )


def _check_disturbance_sets(bands: tuple[LawBand, ...]) -> Condition:
    """Return the condition on the W that has least room, of all bands."""
    return min(
        (check_disturbance_set(band.problem) for band in bands),
        key=lambda condition: condition.margin,
    )


def coverage_gap(band: LawBand) -> float:
    """Return by how much loops at sampled wheel speeds miss those of their stretched speeds, or
    these the corners'; infinite where the boxes miss some of the band."""
    shares = np.random.default_rng(0).dirichlet(np.ones(len(band.corners)), SAMPLES)
    points = np.concatenate([band.corners, shares @ band.corners])
    lower = band.problem.regions[:, 0] - ROUNDING
    upper = band.problem.regions[:, 1] + ROUNDING
    in_box = np.all((points[:, None] >= lower) & (points[:, None] <= upper), axis=2)
    if not in_box.any(axis=1).all():
        return np.inf
    stretched = band.problem.model.stretched(points)
    missed = np.abs(band.gain.loops_along(points) - exact_loops(band.gain, stretched))
    far_corners = band.farthest_stretch * band.corners
    hull = Polytope.from_vertices(np.concatenate([band.corners, far_corners]))
    return max(float(np.max(missed)), -float(np.min(hull.margin(stretched))))
