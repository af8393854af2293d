"""Quadratic programs that laps of a scenario pose to its tube-MPC: recorded, then solved again by
whatever is measured.

Source: new.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int, Key

from jaxtube.control.laws import TubeMpc
from jaxtube.control.planning import CondensedQp, take_qp
from jaxtube.experiments.bench.peers.problems import Problems
from jaxtube.plant.protocol import Plant
from jaxtube.simulation.choices import choose_starts
from jaxtube.simulation.components import make_tube_mpc, slipping_robot
from jaxtube.simulation.rollout import begin, realisation_keys, run_period
from jaxtube.synthesis.parts import Design

LAPS = 1024
"""Laps that are recorded at once."""
MOST_LAPS = 16 * LAPS
"""Laps after which no more programs are looked for."""


class Record(NamedTuple):
    """What laps posed, and what their controller answered; the leading axis is time."""

    starts: Float[np.ndarray, "steps laps 3"]  # of the predictions, (m, m, rad)
    plans: Float[np.ndarray, "steps laps n"]  # the inputs that are planned
    status: Int[np.ndarray, "steps laps"]
    residual: Float[np.ndarray, "steps laps"]
    active: Bool[np.ndarray, "steps laps"]


class Family(NamedTuple):
    """Programs of one window, every one of them with an active row."""

    window: int
    condensed: CondensedQp  # on the device, with the regions that the controller knows
    starts: Float[np.ndarray, "k 3"]
    problems: Problems


def record_laps(controller: TubeMpc, plant: Plant, starts, seed: int, numbers: range) -> Record:
    """Return what the laps of these numbers posed."""
    keys = realisation_keys(seed, numbers.start, len(numbers))
    return Record(*map(np.asarray, _record(controller, plant, keys, starts.draw(keys))))


@jax.jit
def _record(
    controller: TubeMpc, plant: Plant, keys: Key[Array, " laps"], errors: Float[Array, "laps 3"]
) -> tuple[Array, ...]:
    def period(state, step):
        posed = state.measured if controller.restart else state.memory.nominal
        following, happened = run_period(controller, plant, keys, step, state)
        told = happened.diagnostics
        plans = following.memory.inputs.reshape(len(errors), -1)
        return following, (posed, plans, told.status, told.residual, told.active)

    start = begin(controller, plant, keys, errors)
    return jax.lax.scan(period, start, jnp.arange(plant.reference_wheels.shape[0]))[1]


def collect_active(design: Design, starts: str, seed: int, count: int) -> Family:
    """Return programs with active rows, those of the window that has most of them.

    Args:
        design: whose tube-MPC poses them.
        starts: of the laps: "scenario", "feasible" or "edge".
        seed: of the laps, which are numbered from 0.
        count: programs wanted; fewer where `MOST_LAPS` laps pose fewer.
    """
    law = choose_starts(design, starts)
    controller = make_tube_mpc(design, law)
    record = partial(record_laps, controller, slipping_robot(design))
    index = design.windows.index
    found: list[list[np.ndarray]] = [[] for _ in range(index.max() + 1)]
    for first in range(0, MOST_LAPS, LAPS):
        record_of_laps = record(law, seed, range(first, first + LAPS))
        for window, errors in enumerate(found):
            of_window = record_of_laps.active & (index == window)[:, None]
            errors.append(record_of_laps.starts[of_window])
        if max(sum(map(len, errors)) for errors in found) >= count:
            break
    joined = [np.concatenate(errors)[:count] for errors in found]
    window = int(np.argmax([len(errors) for errors in joined]))
    condensed = take_qp(controller.qps, window)
    return Family(window, condensed, joined[window], pose(condensed, joined[window]))


def pose(condensed: CondensedQp, starts: Float[np.ndarray, "k 3"]) -> Problems:
    """Return the programs of one window from these errors."""
    qp = jax.tree.map(np.asarray, condensed)
    shift = starts @ qp.row_errors.T
    return Problems(
        P=qp.factors.hessian,
        A=qp.factors.rows * qp.factors.row_norms[:, None],
        q=starts @ qp.linear.T,
        l=qp.lower - shift,
        u=qp.upper - shift,
    )
