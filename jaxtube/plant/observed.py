"""A plant seen through an observer: its controller gets what is estimated or learnt in the place of
what is measured, while its draws and its motion stay its own."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Generic, Self, TypeVar, cast

from jax import Array
from jaxtyping import Float

from jaxtube.plant.protocol import Plant, Script, SearchablePlant, Uncertainty

PlantType = TypeVar("PlantType", bound=Plant, covariant=True)


@dataclass(frozen=True)
class ObservedPlant(Generic[PlantType]):
    """What plants with an observer share; the observer is a subclass.

    Attributes:
        plant: that moves; to be searched it has to say what bounds its draws.
    """

    plant: PlantType

    has_wheels = True

    @property
    def reference_wheels(self) -> Float[Array, "steps 2"]:
        """The reference, m/s."""
        return self.plant.reference_wheels

    def uncertainties(self) -> dict[str, Uncertainty]:
        """Return everything bounded that the plant would draw."""
        return cast(SearchablePlant, self.plant).uncertainties()

    def under_script(self, script: Script) -> Self:
        """Return the same whose plant meets what a script says."""
        plant = cast(SearchablePlant, self.plant).under_script(script)
        return dataclasses.replace(self, plant=plant)


def robot_behind(plant: Plant) -> Plant:
    """Return the plant behind an observer, or the plant itself where there is none."""
    return plant.plant if isinstance(plant, ObservedPlant) else plant
