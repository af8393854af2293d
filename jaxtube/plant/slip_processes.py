"""The slip processes that a scenario can name: how the deviation xi of one slip evolves.

    iid           afresh at each step                vertex        afresh, at the extremes -1 or 1
    constant      one draw a realisation             patches       one draw a patch of ground
    walk          a bounded random walk              adversarial   against the robot

Each is an instance of a class that fits `jaxtube.plant.slip.SlipProcess`. "recorded", which needs a
file, is made by `jaxtube.plant.recorded_slips`.

Source: new; the paper's slip measurements vary by 10 % (Gonzalez, Fiacchini, Guzman, Alamo 2009,
section IV) without a word on how they evolve.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import DTypeLike
from jaxtyping import Float, Key

from jaxtube.plant import adversary
from jaxtube.plant.protocol import Memory
from jaxtube.plant.slip import START, SlipProcess, draw_uniform

STEP_SIZE = 0.1
"""A step of `Walk` is uniform within this on either side, in units of xi."""

PATCH_SIZE = 1.0
"""Side of a square patch of ground, m."""


@dataclass(frozen=True)
class Iid:
    """Draw each wheel afresh at each step, uniformly."""

    opposed = False

    def initial(self, key: Key[Array, ""], dtype: DTypeLike) -> Memory:
        """Return no memory."""
        return ()

    def draw(self, key, step, memory, situation):
        """Return fresh deviations."""
        step_key = jax.random.fold_in(key, step)
        return draw_uniform(step_key, (2,), situation.errors.dtype), memory


@dataclass(frozen=True)
class Constant:
    """Draw each wheel once per realisation, uniformly."""

    opposed = False

    def initial(self, key: Key[Array, ""], dtype: DTypeLike) -> Memory:
        """Return no memory: the draw depends on the key alone."""
        return ()

    def draw(self, key, step, memory, situation):
        """Return the deviations of the realisation."""
        start_key = jax.random.fold_in(key, START)
        return draw_uniform(start_key, (2,), situation.errors.dtype), memory


@dataclass(frozen=True)
class Walk:
    """Let each wheel walk at random between reflecting walls at -1 and 1.

    xi is uniform in [-1, 1] at every step, from the first on.
    """

    opposed = False

    def initial(self, key: Key[Array, ""], dtype: DTypeLike) -> Memory:
        """Return the deviations of the first step."""
        return draw_uniform(jax.random.fold_in(key, START), (2,), dtype)

    def draw(self, key, step, memory, situation):
        """Return the deviations in memory and those one step on."""
        xi = memory
        step_key = jax.random.fold_in(key, step)
        moved = xi + STEP_SIZE * draw_uniform(step_key, (2,), xi.dtype)
        reflected = jnp.sign(moved) * 2.0 - moved
        return xi, jnp.where(jnp.abs(moved) > 1.0, reflected, moved)


@dataclass(frozen=True)
class Patches:
    """Tie the slip to the ground: square patches, each with its own deviation for whichever wheel
    stands on it.

    Passing again over the same ground meets the same slip.
    """

    opposed = False

    def initial(self, key: Key[Array, ""], dtype: DTypeLike) -> Memory:
        """Return no memory: the ground remembers."""
        return ()

    def draw(self, key, step, memory, situation):
        """Return the deviations of the two patches."""

        def draw_patch(position: Float[Array, "2"]) -> Float[Array, ""]:
            column, row = jnp.floor(position / PATCH_SIZE).astype(jnp.int32)
            patch_key = jax.random.fold_in(jax.random.fold_in(key, column), row)
            return draw_uniform(patch_key, (), position.dtype)

        return jax.vmap(draw_patch)(situation.wheel_positions), memory


@dataclass(frozen=True)
class Vertex:
    """Draw each wheel afresh at each step, -1 or 1 with equal chance."""

    opposed = False

    def initial(self, key: Key[Array, ""], dtype: DTypeLike) -> Memory:
        """Return no memory."""
        return ()

    def draw(self, key, step, memory, situation):
        """Return fresh extremes."""
        step_key = jax.random.fold_in(key, step)
        return jax.random.rademacher(step_key, (2,), situation.errors.dtype), memory


@dataclass(frozen=True)
class Adversarial:
    """Act against the robot, each realisation by its own scheme (`jaxtube.plant.adversary`)."""

    opposed = True

    def initial(self, key: Key[Array, ""], dtype: DTypeLike) -> adversary.Scheme:
        """Return the scheme of the realisation."""
        return adversary.draw_scheme(jax.random.fold_in(key, START), dtype)

    def draw(self, key, step, memory, situation):
        """Return the extremes that push the tracking error furthest."""
        right, left = situation.wheel_positions
        track_width = jnp.hypot(right[0] - left[0], right[1] - left[1])
        direction = adversary.pushed_direction(memory, step, situation.errors)
        return adversary.worst_vertex(direction, situation.errors, track_width), memory


PROCESSES: dict[str, SlipProcess] = {
    "iid": Iid(),
    "constant": Constant(),
    "walk": Walk(),
    "patches": Patches(),
    "vertex": Vertex(),
    "adversarial": Adversarial(),
}

TEST_PROCESSES = ("iid", "vertex", "constant", "adversarial")
"""Names of the processes that a limit is put to the test with."""


def find_process(process: str | SlipProcess) -> SlipProcess:
    """Return the process of a name; an object that is a process already is returned as it is.

    Raises:
        ValueError: for an unknown name.
    """
    if not isinstance(process, str):
        return process
    if process not in PROCESSES:
        choices = ", ".join(PROCESSES)
        raise ValueError(f"slip: process = {process!r} is unknown; choose one of {choices}")
    return PROCESSES[process]
