"""Tubes: sets that hold the deviation from a plan, j steps ahead, under every admissible
disturbance and schedule.

    R_0 = {0},    R_1 = W,    deviation+ = Phi(th) deviation + w,    w in W

with Phi(th) = A(th) + B K(th), Phi_i its values at the vertices of the box of schedules:

* `paper`     R_{j+1} = Phi_n R_j + co{dV_min A_r R_j u dV_max A_r R_j} + co{... A_l ...} + W
* `hull`      R_{j+1} = co u_i Phi_i R_j + W, the exact one-step set made convex
* `summed`    S_0 = W, S_{j+1} = co u_i Phi_i S_j, R_{j+1} = R_j + S_j
* `sequence`  R_{j+1|k} = Phi(th_{k+j}) R_{j|k} + W along the known schedule, W that of the period

Every section is a Minkowski sum of convex hulls of point clouds, so its support function is a sum
of maxima and no facet is ever needed.

Sources: Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (26)-(29) (`paper`, tightening); Chisci,
Rossiter, Zappa 2001 (restarted tubes).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from sets.polytope import Polytope, hull_vertices


@dataclass(frozen=True)
class Section:
    """One tube section: the Minkowski sum of the convex hulls of its terms (no term: the origin
    alone)."""

    terms: tuple[Float[np.ndarray, "points n"], ...]
    dimension: int

    def support(self, directions: Float[np.ndarray, "k n"]) -> Float[np.ndarray, " k"]:
        """Return the support numbers along the rows of `directions`, exact up to rounding."""
        directions = np.atleast_2d(directions)
        total = np.zeros(len(directions))
        for term in self.terms:
            total = total + np.max(directions @ term.T, axis=1)
        return total

    def vertices(self) -> Float[np.ndarray, "v n"]:
        """Return the extreme points, by one planar hull a term."""
        vertices = np.zeros((1, self.dimension))
        for term in self.terms:
            vertices = hull_vertices(_sum_pairs(vertices, term))
        return vertices

    def polytope(self) -> Polytope:
        """Return the section as a polytope (facets through its extreme points)."""
        return Polytope.from_vertices(self.vertices())

    def image(self, matrix: Float[np.ndarray, "m n"]) -> Section:
        """Return the linear image {matrix x}."""
        return Section(tuple(term @ matrix.T for term in self.terms), matrix.shape[0])

    def __add__(self, other: Section) -> Section:
        """Return the Minkowski sum."""
        return Section(self.terms + other.terms, self.dimension)


def _sum_pairs(
    left: Float[np.ndarray, "k n"], right: Float[np.ndarray, "l n"]
) -> Float[np.ndarray, "kl n"]:
    """Return the sums of every pair of points."""
    return (left[:, None] + right[None]).reshape(-1, left.shape[1])


def _hull_of_images(
    matrices: Sequence[Float[np.ndarray, "n n"]], points: Float[np.ndarray, "k n"]
) -> Section:
    images = np.concatenate([points @ matrix.T for matrix in matrices])
    return Section((hull_vertices(images),), points.shape[1])


def _make_start(disturbance: Polytope) -> tuple[Section, Section]:
    """Return R_0 and R_1: the origin and W."""
    origin = Section((), disturbance.dimension)
    return origin, Section((disturbance.vertices(),), disturbance.dimension)


def paper_tube(
    nominal_loop: Float[np.ndarray, "n n"],
    slopes: Sequence[Float[np.ndarray, "n n"]],
    ranges: Sequence[tuple[float, float]],
    disturbance: Polytope,
    horizon: int,
) -> list[Section]:
    """Return R_0 .. R_N of eq. (27) (Gonzalez et al. 2009), for Phi(th) = nominal_loop + sum_m dV_m
    slopes[m].

    `ranges[m]` bounds dV_m; each parameter is treated on its own, which is why this tube contains
    `hull`.
    """
    origin, step = _make_start(disturbance)
    sections = [origin, step]
    for _ in range(1, horizon):
        last = sections[-1]
        points = last.vertices()
        section = last.image(nominal_loop)
        for slope, (low, high) in zip(slopes, ranges, strict=True):
            section = section + _hull_of_images([low * slope, high * slope], points)
        sections.append(section + step)
    return sections[: horizon + 1]


def hull_tube(
    loops: Float[np.ndarray, "v n n"], disturbance: Polytope, horizon: int
) -> list[Section]:
    """Return R_0 .. R_N with R_{j+1} = co u_i Phi_i R_j + W, the smallest convex tube for arbitrary
    schedules."""
    origin, step = _make_start(disturbance)
    sections = [origin, step]
    for _ in range(1, horizon):
        sections.append(_hull_of_images(list(loops), sections[-1].vertices()) + step)
    return sections[: horizon + 1]


def propagate(
    loops: Float[np.ndarray, "v n n"], disturbance: Polytope, steps: int
) -> list[Section]:
    """Return S_0 .. S_steps, S_j being the convex hull of Psi_j W over every product Psi_j of j
    vertex loops."""
    _, step = _make_start(disturbance)
    clouds = [step]
    for _ in range(steps):
        clouds.append(_hull_of_images(list(loops), clouds[-1].vertices()))
    return clouds


def summed_tube(
    loops: Float[np.ndarray, "v n n"], disturbance: Polytope, horizon: int
) -> list[Section]:
    """Return R_0 .. R_N with R_{j+1} = R_j + S_j.

    Contains `hull`, and by construction R_{j+1} contains R_j + Psi_j W for every product Psi_j of j
    vertex loops.
    """
    origin, _ = _make_start(disturbance)
    sections = [origin]
    clouds = propagate(loops, disturbance, max(horizon - 1, 0))
    for cloud in clouds[:horizon]:
        sections.append(sections[-1] + cloud)
    return sections


def sequence_tube(
    loops: Float[np.ndarray, "horizon n n"], disturbance: Polytope | Sequence[Polytope]
) -> list[Section]:
    """Return R_0 .. R_N along one known schedule: R_{j+1} = loops[j] R_j + W_j, W_j the one set, or
    that of the period of loops[j]."""
    by_period = [disturbance] * len(loops) if isinstance(disturbance, Polytope) else disturbance
    sections = [Section((), loops.shape[-1])]
    for loop, of_period in zip(loops, by_period, strict=True):
        _, step = _make_start(of_period)
        sections.append(sections[-1].image(loop) + step)
    return sections


def sequence_support(
    loops: Float[np.ndarray, "windows horizon n n"],
    disturbance: Polytope | Sequence[Polytope],
    directions: Float[np.ndarray, "windows k n"],
    steps: int,
    acting: Int[np.ndarray, "windows horizon"] | None = None,
) -> Float[np.ndarray, "windows k"]:
    """Return the support numbers of the `sequence` section R_steps of many windows at once.

    h_{R_j}(c) = sum over m = 1..j of h_{W_{m-1}}([Phi_{j-1} ... Phi_m]^T c), the factor being I at
    m = j.

    Args:
        loops: Phi_0 .. Phi_{N-1} of every window.
        disturbance: W, or several sets.
        directions: c.
        steps: j.
        acting: which of several sets is W of every period; the one set unless given.
    """
    several = [disturbance] if isinstance(disturbance, Polytope) else disturbance
    points = [one.vertices() for one in several]
    which = np.zeros(loops.shape[:2], int) if acting is None else acting
    total = np.zeros(directions.shape[:2])
    for m in range(steps, 0, -1):
        for number in np.unique(which[:, m - 1]):
            has_it = which[:, m - 1] == number
            total[has_it] += np.max(directions[has_it] @ points[number].T, axis=-1)
        directions = directions @ loops[:, m - 1]
    return total


def input_support(
    section: Section, gains: Float[np.ndarray, "v m n"], directions: Float[np.ndarray, "k m"]
) -> Float[np.ndarray, " k"]:
    """Return the support numbers of co u_i K_i R, what the tube controller may add to the planned
    input."""
    reach = [section.support(directions @ gain) for gain in gains]
    return np.max(reach, axis=0)
