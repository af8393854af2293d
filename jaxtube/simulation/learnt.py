"""What was known of the slips along laps: the observer's intervals, made again from what it was
told."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float

from jaxtube.plant.slip_observer import SlipKnowledge, SlipObserver
from jaxtube.precision import in_64_bits
from jaxtube.simulation.simulate import Laps
from jaxtube.synthesis.learnt_slips import make_slip_observer


class SlipIntervals(NamedTuple):
    """What was known of the slips (right, left) of every period, at its start.

    Attributes:
        lower, upper: ends of the intervals that hold them.
        contradicted: whether the measurements said that noise or slips had not kept their bounds,
            so that nothing was known any more.
    """

    lower: Float[np.ndarray, "steps laps 2"]
    upper: Float[np.ndarray, "steps laps 2"]
    contradicted: Bool[np.ndarray, "steps laps"]


@in_64_bits
def find_slip_intervals(laps: Laps) -> SlipIntervals:
    """Return what was known of the slips along laps.

    Raises:
        ValueError: for laps of a scenario that has no slips learnt.
    """
    problem = laps.design.problem
    observer = make_slip_observer(problem)
    reference = jnp.asarray(problem.schedule[: problem.reference.steps])
    measured = jnp.asarray(laps.trajectory.measured[:-1])
    known = _observe(observer, measured, jnp.asarray(laps.trajectory.wheels), reference)
    return SlipIntervals(*map(np.asarray, known))


@jax.jit
def _observe(
    observer: SlipObserver,
    measured: Float[Array, "steps laps 3"],
    wheels: Float[Array, "steps laps 2"],
    reference: Float[Array, "steps 2"],
) -> tuple[Array, Array, Array]:
    """Return the fields of `SlipIntervals`."""

    def period(known: SlipKnowledge, told):
        known = observer.update(known, *told)
        return known, (known.lower, known.upper, known.contradicted)

    # The wheels of the period before; the first measurement has none, and asks for none.
    before = jnp.concatenate([wheels[:1], wheels[:-1]])
    reference_before = jnp.concatenate([reference[:1], reference[:-1]])
    start = observer.initial(measured[0])
    return jax.lax.scan(period, start, (measured, before, reference_before))[1]
