"""Attacks on a tracking law scheduled on speed.

References whose wheel speeds jump anywhere in the certified range at every step, or stay for a
while, from starts all over the invariant set, under slips at their extremes, chosen against the
robot, constant and uniform.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxtube.control.laws import ScheduledGain
from jaxtube.plant.reference import Reference, from_wheels
from jaxtube.plant.robot import is_saturated
from jaxtube.plant.slipping import SlippingRobot
from jaxtube.simulation import batches, components
from jaxtube.simulation.components import make_robot
from jaxtube.simulation.rollout import Trajectory, realisation_keys
from jaxtube.simulation.starts import UniformStart, uniform_start
from jaxtube.statistics.checks import OUTSIDE
from jaxtube.synthesis.bands import BandedLaw
from sets.polytope import Polytope

REFERENCES = 8
"""References under each slip process, each with a block of laps."""
STEPS = 300
"""Steps of a lap."""


@dataclass(frozen=True)
class BandedLaps:
    """Laps under one slip process: how many, and in how many steps something was left, with the
    largest uses."""

    laps: int
    steps: int
    outside_set: int
    outside_w: int
    outside_caps: int
    saturated: int
    used_set: float
    used_w: float

    def joined(self, other: BandedLaps) -> BandedLaps:
        """Return both attacks as one."""
        return BandedLaps(
            self.laps + other.laps,
            self.steps + other.steps,
            self.outside_set + other.outside_set,
            self.outside_w + other.outside_w,
            self.outside_caps + other.outside_caps,
            self.saturated + other.saturated,
            max(self.used_set, other.used_set),
            max(self.used_w, other.used_w),
        )


NO_LAPS = BandedLaps(0, 0, 0, 0, 0, 0, 0.0, 0.0)


def attack(
    law: BandedLaw, process: str, seed: int, on_progress: Callable[[], object]
) -> BandedLaps:
    """Run laps of the law under one slip process and count what is left."""
    starts = _make_starts(law)
    total = NO_LAPS
    for index in range(REFERENCES):
        reference = random_reference(law, np.random.default_rng([seed, index]))
        keys = realisation_keys(seed, index * batches.BATCH, batches.BATCH)
        gains = jnp.asarray(law.gains(reference.wheels))
        controller = ScheduledGain(gains, components.make_wheel_map(law.problem))
        trajectory = batches.run_realisations(
            controller,
            _make_robot(law, reference, process),
            np.asarray(starts.draw(keys)),
            seed + index,
        )
        total = total.joined(_count(law, reference.wheels, trajectory))
        on_progress()
    return total


def _make_starts(law: BandedLaw) -> UniformStart:
    """Return true errors whose measured ones lie in the invariant set, whatever the noise."""
    omega = law.invariant.polytope
    assert omega is not None
    noise = law.problem.noise
    if noise.any():
        omega = omega.pontryagin_difference(Polytope.box(-noise, noise))
    return uniform_start(omega.vertices())


def _make_robot(law: BandedLaw, reference: Reference, process: str) -> SlippingRobot:
    return make_robot(law.problem, process, reference.wheels, reference.poses)


def random_reference(law: BandedLaw, generator: np.random.Generator) -> Reference:
    """Return a reference whose wheel speeds jump within the box: at every step, or after stretches
    of up to 3 s."""
    model = law.problem.model
    low, high = model.box
    corners = generator.choice([0.0, 1.0], (STEPS, 2))
    at_corner = generator.random((STEPS, 1)) < 0.5
    shares = np.where(at_corner, corners, generator.random((STEPS, 2)))
    if generator.random() < 0.5:
        shares = np.repeat(shares, generator.integers(2, 30, STEPS), axis=0)[:STEPS]
    return from_wheels(low + shares * (high - low), model.dt, model.track_width)


def _count(
    law: BandedLaw, wheels: Float[np.ndarray, "steps 2"], trajectory: Trajectory
) -> BandedLaps:
    omega = law.invariant.polytope
    assert omega is not None
    A, B = law.problem.model.matrices(wheels)
    e = trajectory.measured
    u = trajectory.inputs
    w = e[1:] - np.einsum("kij,kbj->kbi", A, e[:-1]) - np.einsum("kij,kbj->kbi", B, u)
    used_set = np.max(e @ omega.normals.T / omega.offsets, axis=2)
    used_w = np.zeros(w.shape[:2])
    outside_caps = np.zeros(w.shape[:2], bool)
    band_of_step = law.band_of(wheels)
    for number, band in enumerate(law.bands):
        steps = band_of_step == number
        W = band.problem.disturbance_set
        rows = band.problem.input_rows
        used_w[steps] = np.max(w[steps] @ W.normals.T / W.offsets, axis=2)
        used_rows = u[steps] @ rows.inputs.T + e[:-1][steps] @ rows.errors.T
        outside_caps[steps] = ~np.all(used_rows <= rows.offsets + OUTSIDE, axis=2)
    saturated = is_saturated(trajectory.demanded, trajectory.wheels)
    return BandedLaps(
        laps=e.shape[1],
        steps=w.shape[0] * w.shape[1],
        outside_set=int(np.sum(~(used_set <= 1 + OUTSIDE))),
        outside_w=int(np.sum(~(used_w <= 1 + OUTSIDE))),
        outside_caps=int(outside_caps.sum()),
        saturated=int(saturated.sum()),
        used_set=float(used_set.max()),
        used_w=float(used_w.max()),
    )
