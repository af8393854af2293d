"""Drawn laps of a closed loop and their extremes, to compare a search with."""

from __future__ import annotations

import time
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int, Key

from jaxtube.plant.random_keys import make_key
from jaxtube.simulation.usage import JudgedLoop, play_limits

BATCH = 256
"""Laps drawn at once."""


@dataclass(frozen=True)
class SampledExtremes:
    """The extremes of many drawn laps.

    Attributes:
        reach: greatest usage by limit; by step, or stage of a plan, and facet.
        laps: how many were drawn.
        seconds: that they took.
    """

    reach: dict[str, Float[np.ndarray, "stages facets"]]
    laps: int
    seconds: float

    def usage(self, name: str) -> float:
        """Return the greatest usage of a limit."""
        return float(np.max(self.reach[name]))


def sample(
    loop: JudgedLoop,
    starts: Float[np.ndarray, "k 3"],
    *,
    seconds: float = 60.0,
    seed: int = 0,
    laps: int | None = None,
) -> SampledExtremes:
    """Draw laps by the plant's own law and keep their extremes: what a search has to beat in the
    same time.

    Args:
        loop: each lap draws the step of its followed plan from those of the loop.
        starts: pool of initial errors, (m, m, rad), from which each lap draws its own.
        seconds: after which the drawing ends at the latest, compilation not counted.
        seed: of every draw.
        laps: after which it ends if the time is not up before.
    """
    generator = np.random.default_rng(seed)
    key = make_key(seed)
    pool = jnp.asarray(starts, float)
    choices = loop.list_plan_steps()

    def draw(block: int) -> dict[str, np.ndarray]:
        when = jnp.asarray(generator.choice(choices, BATCH), jnp.int32)
        errors = pool[generator.integers(len(pool), size=BATCH)]
        block_key = jax.random.fold_in(key, block)
        extremes = _find_extremes(loop, block_key, errors, when)
        return {name: np.asarray(usage) for name, usage in extremes.items()}

    reach = draw(0)  # compiles
    start = time.perf_counter()
    blocks = 0
    while time.perf_counter() - start < seconds and (laps is None or blocks * BATCH < laps):
        blocks += 1
        drawn = draw(blocks)
        reach = {name: np.maximum(reach[name], drawn[name]) for name in reach}
    return SampledExtremes(reach, blocks * BATCH, time.perf_counter() - start)


@jax.jit
def _find_extremes(
    loop: JudgedLoop,
    key: Key[Array, ""],
    errors: Float[Array, "batch 3"],
    when: Int[Array, " batch"],
) -> dict[str, Float[Array, "stages facets"]]:
    """Draw one batch of laps and return the greatest usages over it."""
    keys = jax.random.split(key, len(errors))
    usages = play_limits(loop, keys, errors, when)
    return {name: jnp.max(usage, axis=2) for name, usage in usages.items()}
