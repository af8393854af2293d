"""A controller whose short program leaves QPs unsolved, to see which laps the whole one runs."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from jaxtube import qp
from jaxtube.control.laws import TrackingLaw

FASTER_MPS = 0.01
"""What the short program adds to the wheels of all laps: none of them goes unnoticed."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Doubtful:
    """A tracking law whose short program leaves QPs unsolved: those of laps whose lateral error is
    larger than `far`, in m."""

    inner: TrackingLaw
    far: Any  # a number, for one program whatever it is
    is_short: bool = dataclasses.field(default=False, metadata={"static": True})

    def without_rounds(self):
        return dataclasses.replace(self, is_short=True)

    def initial(self, errors):
        return self.inner.initial(errors)

    def act(self, step, memory, measurement, reference_wheels):
        command, memory, diagnostics = self.inner.act(step, memory, measurement, reference_wheels)
        if self.is_short:
            left = jnp.abs(measurement.errors[:, 1]) > self.far
            status = jnp.where(left, qp.UNSOLVED, diagnostics.status)
            diagnostics = diagnostics._replace(status=status)
            command = command._replace(wheels=command.wheels + FASTER_MPS)
        return command, memory, diagnostics
