"""A plant whose controller compensates slips that are learnt on line from measured poses.

In the place of the slips that the plant measures, the controller gets the centres of the intervals
of `jaxtube.plant.slip_observer`, which hold the true slips while noise and changes of the slips
keep their bounds. The truth stays the plant's own: its draws, its slips and its motion.

Source: new.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, Protocol, TypeVar

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Key

from jaxtube.plant.observed import ObservedPlant
from jaxtube.plant.protocol import Advance, Command, Measurement, Memory, Plant
from jaxtube.plant.slip_observer import SlipKnowledge, SlipObserver


class SlippingPlant(Plant, Protocol):
    """A plant that knows its true slips."""

    def true_slip(self, memory: Memory) -> Float[Array, "batch 2"]:
        """Return the slips (right, left) of the period that has begun."""
        ...


SlippingType = TypeVar("SlippingType", bound=SlippingPlant, covariant=True)


class LearningMemory(NamedTuple):
    """What learning leaves from one instant to the next.

    Attributes:
        plant: its memory.
        knowledge: of the slips of the period that begins, after an instant.
        is_missed: whether a true slip of that period lies outside of its interval, which no
            controller knows.
        wheels: speeds (right, left) of the period that ended, m/s.
        reference: those of the reference, m/s.
    """

    plant: Memory
    knowledge: SlipKnowledge
    is_missed: Bool[Array, " batch"]
    wheels: Float[Array, "batch 2"]
    reference: Float[Array, "batch 2"]


@partial(jax.tree_util.register_dataclass, data_fields=["plant", "observer"], meta_fields=[])
@dataclass(frozen=True)
class LearningRobot(ObservedPlant[SlippingType]):
    """A robot with the observer of its slips.

    Attributes:
        plant: a robot with wheels that obey at once.
        observer: of its slips.
    """

    observer: SlipObserver

    def initial(
        self, keys: Key[Array, " batch"], errors: Float[Array, "batch 3"]
    ) -> LearningMemory:
        """Return the memory before the first measurement."""
        memory = self.plant.initial(keys, errors)
        none = jnp.zeros_like(errors[:, :2])
        return LearningMemory(
            plant=memory,
            knowledge=self.observer.initial(errors),
            is_missed=jnp.zeros(len(errors), bool),
            wheels=none,
            reference=none,
        )

    def sense(
        self,
        keys: Key[Array, " batch"],
        step,
        memory: LearningMemory,
        errors: Float[Array, "batch 3"],
    ) -> tuple[Measurement, LearningMemory]:
        """Measure, and learn from the period that ended."""
        measured, of_plant = self.plant.sense(keys, step, memory.plant, errors)
        knowledge = self.observer.update(
            memory.knowledge, measured.errors, memory.wheels, memory.reference
        )
        is_missed = find_missed(self.plant.true_slip(of_plant), knowledge)
        memory = memory._replace(plant=of_plant, knowledge=knowledge, is_missed=is_missed)
        return Measurement(measured.errors, knowledge.centre), memory

    def advance(
        self,
        keys: Key[Array, " batch"],
        step,
        memory: LearningMemory,
        errors: Float[Array, "batch 3"],
        command: Command,
    ) -> Advance:
        """Let the plant move, and remember how fast its wheels ran."""
        moved = self.plant.advance(keys, step, memory.plant, errors, command)
        reference = jnp.broadcast_to(self.reference_wheels[step], moved.wheels.shape)
        following = memory._replace(plant=moved.memory, wheels=moved.wheels, reference=reference)
        return Advance(moved.errors, following, moved.wheels)


def find_missed(slips: Float[Array, "batch 2"], knowledge: SlipKnowledge) -> Bool[Array, " batch"]:
    """Return whether a true slip lies outside of its interval; NaN counts as outside."""
    is_inside = (knowledge.lower <= slips) & (slips <= knowledge.upper)
    return ~jnp.all(is_inside, axis=-1)
