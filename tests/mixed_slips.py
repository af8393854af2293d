"""Slips of which each lap follows one of several laws: one program runs laps of all."""

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxtube.plant.random_keys import make_key
from jaxtube.plant.slip import SlipProcess, realisation_key
from jaxtube.plant.streams import Stream

CHOICE = 0xFFFFFFFE
"""Number with which the stream of a law's choice starts; no step reaches it."""


@dataclass(frozen=True)
class MixedLaws:
    """Each lap follows one of these laws, each as often as another.

    For true slips alone, without sideslip: what an opponent does to measured slips is left out.
    """

    laws: tuple[SlipProcess, ...]
    opposed = False

    def initial(self, key, dtype):
        return tuple(law.initial(key, dtype) for law in self.laws)

    def draw(self, key, step, memory, situation):
        drawn = [
            law.draw(key, step, own, situation) for law, own in zip(self.laws, memory, strict=True)
        ]
        deviations = jnp.stack([deviation for deviation, _ in drawn])
        following = tuple(own for _, own in drawn)
        return deviations[choose_law(key, len(self.laws))], following


def choose_law(key: Array, count: int) -> Array:
    """Return the law of a lap, by the key of its true slips."""
    chosen = jax.random.fold_in(key, CHOICE)
    return jax.random.randint(chosen, (), 0, count, jnp.int32)  # the same in 32 and in 64 bits


def count_laps(mixture: MixedLaws, seed: int, laps: int) -> Sequence[int]:
    """Return how many of the first laps of a seed follow each law."""
    count = len(mixture.laws)

    def choose(lap):
        key = realisation_key(make_key(seed), 0, lap)
        return choose_law(jax.random.fold_in(key, Stream.TRUE_SLIP), count)

    chosen = jax.jit(jax.vmap(choose))(jnp.arange(laps, dtype=jnp.uint32))
    return np.bincount(np.asarray(chosen), minlength=count).tolist()
