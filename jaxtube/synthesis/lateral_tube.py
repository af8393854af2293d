"""A polygon around the minimal RPI set in (e_y, e_th), by policy iteration.

    h_i = s_i + max over loops j of  alpha_ij h_a + beta_ij h_(a+1)
    Phi_j^T d_i = alpha_ij d_a + beta_ij d_(a+1),    alpha, beta >= 0,    a = a(i, j)

h_i is the support number along direction d_i, s_i that of one step's disturbance, which may be
another one with every loop: s_ij then stands inside the max. The set is
symmetric, so half a turn of directions is enough. For a fixed choice of loops j(i) the equations
are linear; the choice with the largest right-hand sides is solved anew until none is larger. A
solution with all h > 0 = s - (h - M h) bounds the set; another one says that the loops have no
bounded tube.

Source: policy iteration by Howard 1960, for the fixed point of Kolmanovsky and Gilbert 1998; the
polygon is an outer bound as the sum of the supports of two neighbours bounds that in between.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

HALF_TURN = 60
"""Directions in half a turn."""
MOST_POLICIES = 60
"""Choices of loops that are tried at most; a few are enough."""
SETTLED = 1e-9
"""Relative growth of a side at which a choice of loops is the last one."""


class Cones(NamedTuple):
    """Between which two directions rows lie: those of number `first` and the next, after a turn by
    half where `sign` is -1."""

    first: Int[np.ndarray, "..."]
    sign: Float[np.ndarray, "..."]


class Policy(NamedTuple):
    """The choice of a loop for each direction, and where all images and rows lie."""

    loops: Int[np.ndarray, " directions"]
    images: Cones
    rows: Cones


class Ring:
    """Directions (lateral, heading) around half a turn.

    Args:
        lateral_m: lateral error that counts as much as a heading error of 1 rad.
    """

    def __init__(self, lateral_m: float):
        angles = np.pi * np.arange(HALF_TURN + 1) / HALF_TURN
        sides = np.stack([np.cos(angles) / lateral_m, np.sin(angles)], axis=1)
        # Exact, so that the row of the lateral error is the first direction.
        sides[-1] = -sides[0]
        self.lateral_m = lateral_m
        self.sides = sides

    @classmethod
    def through(cls, k2: float, k3: float, lateral_m: float) -> Ring:
        """Return the ring closest to one of this lateral error that has a direction along the row
        (k2, k3)."""
        step = np.pi / HALF_TURN
        angle = np.arctan2(k3, k2 * lateral_m)
        places = np.clip(np.round(angle / step), 1, HALF_TURN // 2 - 1)
        return cls(float(k3 / (k2 * np.tan(places * step))))

    @property
    def directions(self) -> Float[np.ndarray, "directions 2"]:
        """The directions of the unknown support numbers."""
        return self.sides[:-1]

    def locate(self, rows: Float[np.ndarray, "... 2"]) -> Cones:
        """Return between which directions rows lie."""
        angles = np.arctan2(rows[..., 1], rows[..., 0] * self.lateral_m)
        halves = np.floor(angles / np.pi)
        place = np.floor((angles / np.pi - halves) * HALF_TURN).astype(int)
        return Cones(np.clip(place, 0, HALF_TURN - 1), np.where(halves % 2 == 0, 1.0, -1.0))

    def shares(
        self, rows: Float[np.ndarray, "n ... 2"], cones: Cones
    ) -> tuple[Float[np.ndarray, "n ..."], Float[np.ndarray, "n ..."]]:
        """Return (alpha, beta) of rows as sums of the two directions of their cones."""
        first = self.sides[cones.first] * cones.sign[..., None]
        following = self.sides[cones.first + 1] * cones.sign[..., None]
        determinant = _cross(first, following)
        return _cross(rows, following) / determinant, _cross(first, rows) / determinant


def settle(
    ring: Ring,
    images: Float[np.ndarray, "loops directions 2"],
    steps: Float[np.ndarray, "*loops directions"],
    rows: Float[np.ndarray, "rows 2"],
) -> Policy | None:
    """Return the choice of loops that carries the tube, None where it is not bounded.

    Args:
        ring: the directions.
        images: Phi_j^T d_i.
        steps: support numbers of one step's disturbance, positive; of each loop's own where there
            is an axis of loops.
        rows: directions whose support numbers are wanted as well.
    """
    cones = ring.locate(images)
    alpha, beta = ring.shares(images, cones)
    following = (cones.first + 1) % HALF_TURN
    places = np.arange(HALF_TURN)
    steps = np.broadcast_to(steps, alpha.shape)
    loops = np.argmax(alpha + beta, axis=0)
    policy = Policy(loops, cones, ring.locate(rows))
    for _ in range(MOST_POLICIES):
        chosen = steps[policy.loops, places]
        supports = solve(ring, policy, images[None], chosen[None])[0]
        if not np.all(supports > 0):
            return None
        reach = steps + alpha * supports[cones.first] + beta * supports[following]
        best = np.argmax(reach, axis=0)
        gained = reach[best, places] - reach[policy.loops, places]
        if np.all(gained <= SETTLED * supports):
            return policy
        policy = policy._replace(loops=np.where(gained > 0, best, policy.loops))
    return None


def solve(
    ring: Ring,
    policy: Policy,
    images: Float[np.ndarray, "n loops directions 2"],
    steps: Float[np.ndarray, "n directions"],
) -> Float[np.ndarray, "n directions"]:
    """Return the support numbers under a choice of loops, NaN where they have none; `steps` are
    those of the loops chosen."""
    places = np.arange(HALF_TURN)
    chosen = Cones(
        policy.images.first[policy.loops, places], policy.images.sign[policy.loops, places]
    )
    alpha, beta = ring.shares(images[:, policy.loops, places], chosen)
    matrices = np.tile(np.eye(HALF_TURN), (len(images), 1, 1))
    matrices[:, places, chosen.first] -= alpha
    matrices[:, places, (chosen.first + 1) % HALF_TURN] -= beta
    try:
        return np.linalg.solve(matrices, steps[..., None])[..., 0]
    except np.linalg.LinAlgError:
        return np.full(steps.shape, np.nan)


def reach(
    ring: Ring,
    cones: Cones,
    supports: Float[np.ndarray, "n directions"],
    rows: Float[np.ndarray, "n rows 2"],
) -> Float[np.ndarray, "n rows"]:
    """Return bounds of the set along rows in these cones, exact where both sides touch it."""
    alpha, beta = ring.shares(rows, cones)
    following = (cones.first + 1) % HALF_TURN
    return alpha * supports[:, cones.first] + beta * supports[:, following]


def _cross(
    left: Float[np.ndarray, "... 2"], right: Float[np.ndarray, "... 2"]
) -> Float[np.ndarray, "..."]:
    return left[..., 0] * right[..., 1] - left[..., 1] * right[..., 0]
