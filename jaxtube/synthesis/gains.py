"""Gains u = +K(th) e scheduled on wheel speeds, and the loops A + B K that they close over the
certified regions.

    bilinear    K(th) between its values at the four vertices of the box
    decoupled   u1 = -k1 e_x - Om e_y,  u2 = -k2 e_y - k3 e_th,  T Om the model's own A_12,
                so that  e_x+ = (1 - T k1) e_x + w_x

Under the exact Jacobian the loop of a decoupled gain depends on h and c alone, and affinely: it is
bilinear in the stretched wheel speeds. So a few loops stand for all: mixtures of those at the
corners of a region, of plain or of stretched speeds, hold the loop at every schedule in it.

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (22)-(25), for the compensating gain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from jaxtube.plant.model import VERTEX_SIDES, Model, bilinear_weights
from jaxtube.synthesis.problem import Problem, region_corners
from sets.riccati import lqr_gain

Region = Float[np.ndarray, "2 2"]
"""A box of wheel speeds: lower and upper (right, left), m/s."""


@dataclass(frozen=True, eq=False)
class Gain:
    """A gain u = +K(th) e, bilinear in the schedule, with its loops over a problem's regions."""

    model: Model
    regions: Float[np.ndarray, "m 2 2"]
    nominal: Float[np.ndarray, "2 3"]  # at the centre of the box
    vertices: Float[np.ndarray, "4 2 3"]

    def at(self, weights: Float[np.ndarray, "... 4"]) -> Float[np.ndarray, "... 2 3"]:
        """Return the gain at the schedules with these bilinear weights."""
        return np.tensordot(weights, self.vertices, axes=1)

    def along(self, schedules: Float[np.ndarray, "... 2"]) -> Float[np.ndarray, "... 2 3"]:
        """Return the gain at schedules (right, left), m/s."""
        return self.at(self.model.weights(schedules))

    def loops_along(self, schedules: Float[np.ndarray, "... 2"]) -> Float[np.ndarray, "... 3 3"]:
        """Return the loops A + B K at schedules."""
        transitions, inputs = self.model.matrices(schedules)
        return transitions + inputs @ self.along(schedules)

    @cached_property
    def corner_gains(self) -> Float[np.ndarray, "4m 2 3"]:
        """Gains at the corners of the regions, whose mixtures hold every gain used there."""
        return self.along(region_corners(self.regions))

    @cached_property
    def pairs(self) -> tuple[Float[np.ndarray, "v 3 3"], Float[np.ndarray, "v 2 3"]]:
        """Loops and gains whose joint mixtures are to hold (A + B K, K) at every schedule in the
        regions."""
        return self.loops_along(region_corners(self.regions)), self.corner_gains

    @cached_property
    def loops(self) -> Float[np.ndarray, "v 3 3"]:
        """Loops whose mixtures are to hold A + B K at every schedule in the regions, each once."""
        return distinct(self.pairs[0])

    def of_regime(self, regime: int) -> Gain:
        """Return the gain that may act in a regime: itself."""
        return self

    def region_loops(self, region: Region) -> Float[np.ndarray, "4 3 3"]:
        """Return the loops at the corners of a region."""
        return self.loops_along(region_corners(region))

    def mixture(
        self, schedules: Float[np.ndarray, "k 2"], region: Region
    ) -> Float[np.ndarray, "k 4"]:
        """Return the weights that mix a region's loops to the loop at each schedule."""
        return bilinear_weights(schedules, *region)

    def coverage_gap(
        self, schedules: Float[np.ndarray, "k 2"], region: Region
    ) -> Float[np.ndarray, " k"]:
        """Return by how much the loop at each schedule misses the mixtures of a region's loops."""
        weights = self.mixture(schedules, region)
        mixed = np.tensordot(weights, self.region_loops(region), axes=1)
        missed = np.abs(self.loops_along(schedules) - mixed).max(axis=(1, 2))
        return np.maximum(missed, -weights.min(axis=1))


class StretchedGain(Gain):
    """A decoupled gain under the exact Jacobian, whose loops are bilinear in stretched speeds."""

    @cached_property
    def pairs(self) -> tuple[Float[np.ndarray, "v 3 3"], Float[np.ndarray, "v 2 3"]]:
        """Every loop with every gain: the loops are bilinear in other speeds than the gains."""
        loops = distinct(np.concatenate([self.region_loops(region) for region in self.regions]))
        gains = distinct(self.corner_gains)
        return np.repeat(loops, len(gains), axis=0), np.tile(gains, (len(loops), 1, 1))

    def region_loops(self, region: Region) -> Float[np.ndarray, "4 3 3"]:
        """Return the loops at the corners of a region's stretched speeds."""
        stretched = np.stack(self.model.stretched_box(*region))
        return exact_loops(self, stretched[VERTEX_SIDES, [0, 1]])

    def mixture(
        self, schedules: Float[np.ndarray, "k 2"], region: Region
    ) -> Float[np.ndarray, "k 4"]:
        """Return the weights that mix a region's loops to the loop at each schedule."""
        return bilinear_weights(self.model.stretched(schedules), *self.model.stretched_box(*region))


def vertex_gain(problem: Problem, vertices: Float[np.ndarray, "4 2 3"]) -> Gain:
    """Return the gain with these values at the vertices of the box."""
    return Gain(problem.model, problem.regions, vertices.mean(axis=0), vertices)


def compensating_gain(problem: Problem) -> Gain:
    """Return the gain of eqs. (22)-(25): LQR at the centre, first rows of A_r and A_l cancelled."""
    model = problem.model
    nominal = lqr_gain(*model.matrices(model.centre), problem.error_weight, problem.input_weight)
    slopes = np.stack(model.compensating_gains())
    vertices = nominal + np.tensordot(model.vertices - model.centre, slopes, axes=1)
    return Gain(model, problem.regions, nominal, vertices)


def decoupled_gain(problem: Problem, gains: Sequence[float] | Float[np.ndarray, "3"]) -> Gain:
    """Return the gain with k1 (1/s), k2 (rad/(m s)) and k3 (1/s)."""
    model = problem.model
    k1, k2, k3 = gains

    def law(schedules: Float[np.ndarray, "... 2"]) -> Float[np.ndarray, "... 2 3"]:
        transitions, _ = model.matrices(schedules)
        values = np.tile([[-k1, 0.0, 0.0], [0.0, -k2, -k3]], (*transitions.shape[:-2], 1, 1))
        values[..., 0, 1] = -transitions[..., 0, 1] / model.dt
        return values

    kind = StretchedGain if model.discretisation == "exact" else Gain
    return kind(model, problem.regions, law(model.centre), law(model.vertices))


def given_gain(problem: Problem, numbers: Float[np.ndarray, " kappa"]) -> Gain:
    """Return the gain of numbers in the order of `Problem.given_gains`: three decouple, 24 are the
    vertex gains."""
    if len(numbers) == 3:
        return decoupled_gain(problem, numbers)
    return vertex_gain(problem, np.reshape(numbers, (4, 2, 3)))


def exact_loops(gain: Gain, stretched: Float[np.ndarray, "v 2"]) -> Float[np.ndarray, "v 3 3"]:
    """Return the loops of a decoupled gain under the exact Jacobian, affine in stretched wheel
    speeds."""
    T = gain.model.dt
    k1 = -gain.nominal[0, 0]
    k2 = -gain.nominal[1, 1]
    k3 = -gain.nominal[1, 2]
    h, c = gain.model.turn_and_reach(stretched).T
    loops = np.zeros((len(stretched), 3, 3))
    loops[:, 0, 0] = 1 - T * k1
    loops[:, 1, 0] = -h * (2 - T * k1)
    loops[:, 1, 1] = 1 - c * T * k2 / 2
    loops[:, 1, 2] = c * (1 - T * k3 / 2)
    loops[:, 2, 1] = -T * k2
    loops[:, 2, 2] = 1 - T * k3
    return loops


def distinct(matrices: Float[np.ndarray, "v m n"]) -> Float[np.ndarray, "w m n"]:
    """Return the matrices without repetitions, in the order of their first appearance."""
    first = np.unique(matrices.reshape(len(matrices), -1), axis=0, return_index=True)[1]
    return matrices[np.sort(first)]
