"""A plant whose controller sees an estimate of the tracking error, not the measurement itself.

    p-  = f(p, wheels, measured slip)      the sampled robot, which slips as measured, not sideways
    p   = p- + L (y - p-)                  y measured, L in (0, 1] by coordinate

The first estimate is the first measurement. L = 1 is the measurement ever after; what less of it
does to a guarantee is in `sets.robot.observer`. The truth stays the plant's own: its draws, its
slips and its motion are those it has without an estimate.

Source: Luenberger 1966, IEEE Trans. Automatic Control 11(2), with the robot itself as its model.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Key

from jaxtube.plant.error_dynamics import advance
from jaxtube.plant.observed import ObservedPlant, PlantType
from jaxtube.plant.protocol import Advance, Command, Measurement, Memory


class EstimateMemory(NamedTuple):
    """What an estimate leaves from one instant to the next."""

    plant: Memory
    errors: Float[Array, "batch 3"]  # predicted before an instant, estimated after it, (m, m, rad)
    slip: Float[Array, "batch 2"]  # measured
    gain: Float[Array, "batch 3"]  # of the next correction: 1 for the first one


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["plant", "gain", "track_width", "dt"],
    meta_fields=[],
)
@dataclass(frozen=True)
class EstimatingRobot(ObservedPlant[PlantType]):
    """A robot with the estimate that its controller acts on.

    Attributes:
        plant: a robot with wheels.
        gain: L, (longitudinal, lateral, heading).
        track_width: of the prediction, m.
        dt: period, s.
    """

    gain: Float[Array, "3"]
    track_width: float
    dt: float

    def initial(
        self, keys: Key[Array, " batch"], errors: Float[Array, "batch 3"]
    ) -> EstimateMemory:
        """Return the memory before the first measurement, which counts in full."""
        none = jnp.zeros_like(errors)
        memory = self.plant.initial(keys, errors)
        return EstimateMemory(memory, none, none[:, :2], jnp.ones_like(errors))

    def sense(
        self,
        keys: Key[Array, " batch"],
        step,
        memory: EstimateMemory,
        errors: Float[Array, "batch 3"],
    ) -> tuple[Measurement, EstimateMemory]:
        """Measure, and correct the prediction: the estimate takes the place of the measured
        errors."""
        measured, of_plant = self.plant.sense(keys, step, memory.plant, errors)
        estimate = memory.errors + memory.gain * (measured.errors - memory.errors)
        gain = jnp.broadcast_to(jnp.asarray(self.gain, errors.dtype), errors.shape)
        memory = EstimateMemory(of_plant, estimate, measured.slip, gain)
        return Measurement(estimate, measured.slip), memory

    def advance(
        self,
        keys: Key[Array, " batch"],
        step,
        memory: EstimateMemory,
        errors: Float[Array, "batch 3"],
        command: Command,
    ) -> Advance:
        """Let the plant move, and predict where the estimate goes with the wheels within their
        limits."""
        moved = self.plant.advance(keys, step, memory.plant, errors, command)
        reference = self.reference_wheels[step]
        predicted = advance(
            memory.errors, moved.wheels, memory.slip, reference, self.track_width, self.dt
        )
        following = memory._replace(plant=moved.memory, errors=predicted)
        return Advance(moved.errors, following, moved.wheels)
