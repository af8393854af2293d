"""Random quadratic programs of the shape that a tube controller solves, for the tests of the
solver."""

from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_discrete_are

BATCH = 400
FACETS = 20
HORIZON = 5
DT = 0.1


class Family(NamedTuple):
    """Programs of a tube controller: q = gradient @ e, bounds = lower - offset @ e, upper - offset
    @ e."""

    P: np.ndarray
    A: np.ndarray
    gradient: np.ndarray
    offset: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    is_input: np.ndarray

    def programs(self, errors):
        shift = errors @ self.offset.T
        return errors @ self.gradient.T, self.lower - shift, self.upper - shift


def family(seed: int) -> Family:
    """A robot with random speed, turning either way; state box, wheel limits and a random terminal
    polytope."""
    rng = np.random.default_rng(seed)
    speed = rng.uniform(0.2, 1.5)
    turn = rng.choice([-1, 1]) * speed / 2.5
    model = np.eye(3) + DT * np.array([[0, turn, 0], [-turn, 0, speed], [0, 0, 0]])
    inputs = DT * np.array([[1.0, 0], [0, 0], [0, 1]])
    weight = np.diag([1, 1, 0.01])
    terminal = 1.2 * solve_discrete_are(model, inputs, weight, np.eye(2))
    reach = [np.zeros((3, 2 * HORIZON))]
    drift = [np.eye(3)]
    for j in range(HORIZON):
        reach.append(model @ reach[-1])
        reach[-1][:, 2 * j : 2 * j + 2] += inputs
        drift.append(model @ drift[-1])
    weights = [weight] * HORIZON + [terminal]
    P = 2 * (np.eye(2 * HORIZON) + sum(g.T @ w @ g for g, w in zip(reach, weights, strict=True)))
    gradient = np.sum(
        [2 * g.T @ w @ d for g, w, d in zip(reach, weights, drift, strict=True)], axis=0
    )
    box = np.array([0.28, 0.27, np.deg2rad(18)])
    states = [
        (reach[j][i], drift[j][i], -box[i], box[i])
        for j in range(1, HORIZON)
        for i in range(3)
        if reach[j][i].any()
    ]
    wheels = np.kron(np.eye(HORIZON), [[1, 0.25], [1, -0.25]])
    normals = rng.normal(size=(FACETS, 3))
    normals = np.vstack([np.eye(3), -np.eye(3), normals / np.linalg.norm(normals, axis=1)[:, None]])
    heights = 0.2 * np.abs(normals).max(axis=1) * np.r_[np.ones(6), rng.uniform(1, 1.4, FACETS)]
    rows = [*states, *((w, np.zeros(3), -0.7, 2.4) for w in wheels)]
    rows += [
        (a @ reach[HORIZON], a @ drift[HORIZON], -np.inf, b)
        for a, b in zip(normals, heights, strict=True)
    ]
    A = np.array([row[0] for row in rows])
    offset = np.array([row[1] for row in rows])
    lower = np.array([row[2] for row in rows])
    upper = np.array([row[3] for row in rows])
    is_input = (np.arange(len(A)) >= len(states)) & (np.arange(len(A)) < len(states) + len(wheels))
    return Family(P, A, gradient, offset, lower, upper, is_input)


def easy(fam: Family, seed: int):
    """Errors of which most leave every row inactive and none the feasible set."""
    return fam.programs(np.random.default_rng(seed).uniform(-0.22, 0.22, (BATCH, 3)))


def hard(fam: Family, seed: int, count: int = BATCH):
    """Errors at and beyond the edge of the feasible set, input limits down to a twentieth."""
    rng = np.random.default_rng(seed)
    q, lower, upper = fam.programs(rng.uniform(-1, 1, (count, 3)) * [0.36, 0.36, 0.4])
    scale = rng.uniform(0.1, 1, (count, 1))
    lower[:, fam.is_input] *= 0.5 * scale
    upper[:, fam.is_input] *= 0.2 * scale
    return q, lower, upper
