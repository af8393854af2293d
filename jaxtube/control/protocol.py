"""The contract of a controller: measurements in, commands out.

At the start of every period a controller is handed a `Measurement` and the reference, and returns
a `Command`: virtual inputs u and the wheel speeds that realise them. How u becomes wheel speeds
(input map, slip compensation) is the controller's business; `WheelMap` does it as eqs. (7)-(8) of
the paper do. A controller knows no plant.

A controller is a pytree; its methods are pure functions that run under jit, and all arrays carry
the realisations in their first axis. The shortest way to a controller is a function
u = law(errors, reference_wheels):

    controller = Feedback(lambda errors, reference_wheels: errors @ K.T, wheel_map)

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, sections III and IV.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from jaxtube.control.mpc import Diagnostics, no_diagnostics
from jaxtube.plant.input_maps import acting_input
from jaxtube.plant.protocol import Command, Measurement, Memory
from jaxtube.plant.robot import wheel_commands


class Controller(Protocol):
    """A controller, as a closed loop sees it (see the module)."""

    def initial(self, errors: Float[Array, "batch 3"]) -> Memory:
        """Return the memory before the first period, whose measured errors are `errors`."""
        ...

    def act(
        self,
        step,
        memory: Memory,
        measurement: Measurement,
        reference_wheels: Float[Array, "2"],
    ) -> tuple[Command, Memory, Diagnostics]:
        """Return what period `step` is to do, the next memory, and how it was found.

        Args:
            step: number of the period, from 0.
            memory: what `initial` or the last period returned.
            measurement: at the start of the period.
            reference_wheels: wheel speeds of the reference (right, left) in this period, m/s.
        """
        ...


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["track_width", "dt"],
    meta_fields=["input_map", "compensates"],
)
@dataclass(frozen=True)
class WheelMap:
    """From virtual inputs to wheel speeds, eqs. (7)-(8).

    Attributes:
        track_width: m.
        dt: period, s.
        input_map: what virtual inputs mean: a name of `input_maps.INPUT_MAPS`.
        compensates: divide by 1 - measured slip; otherwise as if no wheel slipped.
    """

    track_width: float
    dt: float
    input_map: str = "paper"
    compensates: bool = True

    def command(
        self,
        inputs: Float[Array, "batch 2"],
        measurement: Measurement,
        reference_wheels: Float[Array, "2"],
    ) -> Command:
        """Return the command that realises virtual inputs (u1 m/s, u2 rad/s)."""
        deficits = acting_input(
            self.input_map, inputs, measurement.errors, reference_wheels, self.track_width, self.dt
        )
        slip = measurement.slip if self.compensates else jnp.zeros_like(measurement.slip)
        wheels = wheel_commands(deficits, reference_wheels, slip, self.track_width)
        return Command(inputs, wheels)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DirectInputs:
    """Inputs that act as they are, in the place of a `WheelMap` where there are no wheels."""

    def command(
        self,
        inputs: Float[Array, "batch m"],
        measurement: Measurement,
        reference_wheels: Float[Array, " p"],
    ) -> Command:
        """Return the command of inputs."""
        return Command(inputs, inputs)


Law = Callable[[Float[Array, "batch 3"], Float[Array, "2"]], Float[Array, "batch 2"]]


@partial(jax.tree_util.register_dataclass, data_fields=["wheel_map"], meta_fields=["law"])
@dataclass(frozen=True)
class Feedback:
    """A controller without memory, u = law(measured errors, reference wheels)."""

    law: Law
    wheel_map: WheelMap | DirectInputs

    solves_qp = False

    def initial(self, errors: Float[Array, "batch 3"]) -> tuple[()]:
        """Return no memory."""
        return ()

    def act(
        self, step, memory: tuple[()], measurement: Measurement, reference_wheels: Float[Array, "2"]
    ) -> tuple[Command, tuple[()], Diagnostics]:
        """Return the command of the law, no memory, and diagnostics without a QP."""
        errors = measurement.errors
        inputs = self.law(errors, reference_wheels)
        command = self.wheel_map.command(inputs, measurement, reference_wheels)
        return command, memory, no_diagnostics(errors)
