"""The contract of a plant: what a closed loop asks of whatever moves.

A period of length dt, from instant k to k + 1, goes

    sense      the plant measures the tracking error and the slips of the period that begins
    act        the controller turns the measurement into a command (`jaxtube.control.protocol`)
    advance    the plant moves under the command, which is held over the period

A plant knows no controller. It is handed a `Command`: wheel speeds, which a robot follows, and the
virtual inputs that they realise, which are all that the prediction model understands.

All arrays carry the realisations in their first axis. Wheels and slips are (right, left); errors
are (longitudinal m, lateral m, heading rad) in the frame of the robot, positive where the reference
is ahead and to the left. A plant is a pytree, its methods are pure functions that run under jit,
and what it draws depends on the key of a realisation and the step alone, so that no batch changes
it. Its memory is a pytree of fixed shapes.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Key

Memory = Any
"""Whatever a plant, a controller or a slip process keeps from one period to the next: a pytree of
arrays, of the same structure, shapes and dtypes in every period; () for none."""

Script = dict[str, Float[Array, "times batch n"]]
"""What the bounded uncertainties of a plant do, by name, time first; beyond its last time an entry
goes on with its last value, so that a single value is a constant."""


class Measurement(NamedTuple):
    """What a controller learns of the plant at the start of a period.

    Attributes:
        errors: tracking errors, measured or estimated, (m, m, rad).
        slip: slips (right, left) of the period that begins, without unit.
    """

    errors: Float[Array, "batch 3"]
    slip: Float[Array, "batch 2"]


class Command(NamedTuple):
    """What a controller asks of the plant over one period.

    Attributes:
        inputs: virtual inputs (u1 m/s, u2 rad/s).
        wheels: the wheel speeds (right, left) that realise them, m/s, not saturated.
    """

    inputs: Float[Array, "batch 2"]
    wheels: Float[Array, "batch 2"]


class Advance(NamedTuple):
    """Where one period leads."""

    errors: Float[Array, "batch 3"]  # true tracking errors at its end, (m, m, rad)
    memory: Memory
    wheels: Float[Array, "batch 2"]  # wheel speeds within the limits, m/s; NaN without wheels


class Plant(Protocol):
    """A plant, as a closed loop sees it (see the module)."""

    @property
    def reference_wheels(self) -> Float[Array, "steps 2"]:
        """Wheel speeds of the reference in every period, m/s: as many periods as a lap has."""
        ...

    def initial(self, keys: Key[Array, " batch"], errors: Float[Array, "batch 3"]) -> Memory:
        """Return the memory before the first period, which begins at true `errors`."""
        ...

    def sense(
        self, keys: Key[Array, " batch"], step, memory: Memory, errors: Float[Array, "batch 3"]
    ) -> tuple[Measurement, Memory]:
        """Return the measurement at instant `step`, where the true errors are `errors`."""
        ...

    def advance(
        self,
        keys: Key[Array, " batch"],
        step,
        memory: Memory,
        errors: Float[Array, "batch 3"],
        command: Command,
    ) -> Advance:
        """Return where period `step` leads from true `errors` under a command."""
        ...


class Uncertainty(NamedTuple):
    """One bounded uncertainty of a plant: `times` values, each in the hull of `vertices`, or of
    those of its time."""

    vertices: Float[Array | np.ndarray, "v n"] | Float[Array | np.ndarray, "times v n"]
    times: int

    @property
    def by_time(self) -> Float[np.ndarray, "times v n"]:
        """The vertices of every time."""
        vertices = np.asarray(self.vertices)
        return np.broadcast_to(vertices, (self.times, *vertices.shape[-2:]))


class SearchablePlant(Plant, Protocol):
    """A plant whose uncertainties can be searched for the worst case."""

    @property
    def has_wheels(self) -> bool:
        """Whether the plant has wheels, whose speeds have limits."""
        ...

    def uncertainties(self) -> dict[str, Uncertainty]:
        """Return everything bounded that the plant would draw, by name.

        Raises:
            ValueError: for a law of drawing that is not the box of its values.
        """
        ...

    def under_script(self, script: Script) -> Plant:
        """Return the plant that meets what a script says instead of what it would draw."""
        ...


def script_entry(values: Float[Array, "times batch n"], step) -> Float[Array, "batch n"]:
    """Return what a script says at a step."""
    return values[jnp.minimum(step, len(values) - 1)]
