"""Closed loops: any controller on any plant, all realisations at once, scanned over time.

    sense -> act -> advance -> sense -> ...        (`jaxtube.plant.protocol`)

The realisations come first in every array, so that a controller can share matrices across them.
Draws depend on the key of a realisation and the step alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int, Key

from jaxtube import qp
from jaxtube.columns import scan_by_columns, use_twice
from jaxtube.control import planning
from jaxtube.control.laws import TubeMpc, without_rounds
from jaxtube.control.mpc import Diagnostics
from jaxtube.control.protocol import Controller
from jaxtube.plant import slip as slips
from jaxtube.plant.protocol import Measurement, Memory, Plant
from jaxtube.plant.random_keys import make_key
from jaxtube.qp.batched_ldl import matmul
from jaxtube.qp.regions import AnyArray

DIAGNOSTICS = "diagnostics_"
"""Begins the names of the arrays of diagnostics in a file."""


class Trajectory(NamedTuple):
    """What a rollout records; the leading axis is time, the next one the realisations."""

    errors: Float[Array, "steps+1 batch 3"]  # true tracking errors
    measured: Float[Array, "steps+1 batch 3"]  # what the controller saw: an observer's estimate
    inputs: Float[Array, "steps batch 2"]  # virtual inputs asked for
    wheels: Float[Array, "steps batch 2"]  # wheel speeds (right, left) after saturation, m/s
    demanded: Float[Array, "steps batch 2"]  # before saturation
    diagnostics: Diagnostics

    def arrays(self) -> dict[str, np.ndarray]:
        """Return all arrays as numpy arrays, for a file."""
        arrays = self._asdict()
        diagnostics = arrays.pop("diagnostics")._asdict()
        arrays |= {f"{DIAGNOSTICS}{name}": values for name, values in diagnostics.items()}
        return {name: np.asarray(values) for name, values in arrays.items()}


def read_trajectory(arrays: Mapping[str, np.ndarray]) -> Trajectory:
    """Return the trajectory that `Trajectory.arrays` wrote."""
    diagnostics = Diagnostics._make(arrays[f"{DIAGNOSTICS}{name}"] for name in Diagnostics._fields)
    names = [name for name in Trajectory._fields if name != "diagnostics"]
    return Trajectory._make([*(arrays[name] for name in names), diagnostics])


class LoopState(NamedTuple):
    """A closed loop between two periods."""

    errors: Float[Array, "batch 3"]  # true tracking errors
    measurement: Measurement
    memory: Memory  # of the controller
    plant_memory: Memory

    @property
    def measured(self) -> Float[Array, "batch 3"]:
        """The tracking errors that the controller sees: measured, or estimated."""
        return self.measurement.errors


class PeriodOutcome(NamedTuple):
    """What happened in one period: what was asked of the wheels, what they did, and how the
    controller found it."""

    inputs: Float[Array, "batch 2"]
    wheels: Float[Array, "batch 2"]
    demanded: Float[Array, "batch 2"]
    diagnostics: Diagnostics


def begin(
    controller: Controller,
    plant: Plant,
    keys: Key[Array, " batch"],
    errors: Float[Array, "batch 3"],
    step: Int[Array, ""] | int = 0,
) -> LoopState:
    """Return the closed loop at true errors, before the period that begins at `step`."""
    measurement, plant_memory = plant.sense(keys, step, plant.initial(keys, errors), errors)
    return LoopState(errors, measurement, controller.initial(measurement.errors), plant_memory)


def run_period(
    controller: Controller,
    plant: Plant,
    keys: Key[Array, " batch"],
    step: Int[Array, ""],
    state: LoopState,
) -> tuple[LoopState, PeriodOutcome]:
    """Run one period of the closed loop, the one that begins at `step`, and measure at its end."""
    errors, memory, plant_memory, happened = advance_period(controller, plant, keys, step, state)
    return _measure(plant, keys, step + 1, errors, memory, plant_memory), happened


def advance_period(
    controller: Controller,
    plant: Plant,
    keys: Key[Array, " batch"],
    step: Int[Array, ""],
    state: LoopState,
) -> tuple[Float[Array, "batch 3"], Memory, Memory, PeriodOutcome]:
    """Run one period of the closed loop, the one that begins at `step`; return errors, memories of
    controller and plant, and what happened, before anything is measured."""
    command, memory, diagnostics = controller.act(
        step, state.memory, state.measurement, plant.reference_wheels[step]
    )
    for_plant, for_record = use_twice(command)
    errors, plant_memory, wheels = plant.advance(
        keys, step, state.plant_memory, state.errors, for_plant
    )
    happened = PeriodOutcome(for_record.inputs, wheels, for_record.wheels, diagnostics)
    return errors, memory, plant_memory, happened


def _measure(
    plant: Plant,
    keys: Key[Array, " batch"],
    step,
    errors: Float[Array, "batch 3"],
    memory: Memory,
    plant_memory: Memory,
) -> LoopState:
    """Return the closed loop at an instant; memories are those before it."""
    errors, for_sensor = use_twice(errors)
    measurement, plant_memory = plant.sense(keys, step, plant_memory, for_sensor)
    return LoopState(errors, measurement, memory, plant_memory)


@jax.jit
def rollout(
    controller: Controller,
    plant: Plant,
    keys: Key[Array, " batch"],
    errors: Float[Array, "batch 3"],
) -> Trajectory:
    """Run every realisation through the whole reference.

    Args:
        controller: any.
        plant: any.
        keys: one key a realisation.
        errors: initial tracking errors, (m, m, rad).

    Returns:
        The trajectory. Nothing raises: the diagnostics say where a QP had no solution.
    """

    def period(state, step):
        following, happened = run_period(controller, plant, keys, step, state)
        return following, (state.errors, state.measured, happened)

    start = begin(controller, plant, keys, errors)
    steps = jnp.arange(plant.reference_wheels.shape[0])
    last, (before, measured, happened) = scan_by_columns(period, start, steps)
    errors = jnp.concatenate([before, last.errors[None]])
    measured = jnp.concatenate([measured, last.measured[None]])
    return Trajectory(errors, measured, *happened)


def run_laps(
    controller: Controller,
    plant: Plant,
    keys: Key[Array, " batch"],
    errors: Float[Array, "batch 3"],
) -> Trajectory:
    """Return what `rollout` does, to rounding, from a program that is compiled in two thirds of the
    time (see `run_shortened`)."""

    def find_unsolved(trajectory: Trajectory) -> Bool[np.ndarray, " batch"]:
        return is_unsolved(trajectory.diagnostics.status, trajectory.errors)

    return run_shortened(rollout, find_unsolved, controller, plant, keys, errors)


def run_shortened(
    run: Callable[..., Any],
    find_unsolved: Callable[[Any], Bool[np.ndarray, " batch"]],
    controller: Controller,
    *arguments: Any,
) -> Any:
    """Return what `run(controller, *arguments)` does, a tree of arrays (steps, batch, ..).

    The program that is compiled first leaves out what hardly any lap needs (see
    `laws.without_rounds`). Laps that it leaves unsolved are those of the whole program.
    """
    short = without_rounds(controller)
    laps = run(short, *arguments)
    unsolved = find_unsolved(laps)
    if short is controller or not unsolved.any():
        return laps
    whole = run(controller, *arguments)

    def choose(of_whole, of_short):
        where = unsolved.reshape(-1, *[1] * (of_short.ndim - 2))
        return jnp.where(where, of_whole, of_short)

    return jax.tree.map(choose, whole, laps)


def is_unsolved(
    status: Int[AnyArray, "steps batch"], errors: Float[AnyArray, "steps batch 3"]
) -> Bool[np.ndarray, " batch"]:
    """Return which laps have a QP that is UNSOLVED although their errors are numbers."""
    is_finite = np.isfinite(errors).all(axis=(0, 2))
    return np.any(np.asarray(status) == qp.UNSOLVED, axis=0) & is_finite


@jax.jit
def follow_plan(
    controller: TubeMpc,
    plant: Plant,
    keys: Key[Array, " batch"],
    state: LoopState,
    step: Int[Array, ""],
    plan: planning.Plan,
) -> Float[Array, "horizon batch 3"]:
    """Follow plans to their end, u = g_j + K(th) (e - e_nominal), without planning again.

    Args:
        controller: the tube-MPC whose nominal model and tube gain are used.
        plant: any.
        keys: one key a realisation.
        state: the closed loop at `step`.
        step: where along the reference, at least a horizon before its end.
        plan: made from the measured errors at `step`.

    Returns:
        e - e_nominal after 1 .. N steps, measured, to be compared with R_1 .. R_N where there was a
        plan.
    """

    def follow_period(carry, ahead):
        """Apply a planned input with the tube's feedback; move the robot and the nominal error."""
        state, nominal = carry
        offset, planned = ahead
        now = step + offset
        condensed = controller.condensed_qp(now)
        inputs = planned + matmul(state.measured - nominal, condensed.tube_gain.T)
        command = controller.wheel_map.command(
            inputs, state.measurement, plant.reference_wheels[now]
        )
        errors, plant_memory, _ = plant.advance(
            keys, now, state.plant_memory, state.errors, command
        )
        state = _measure(plant, keys, now + 1, errors, state.memory, plant_memory)
        nominal = planning.predict(condensed, nominal, planned)
        return (state, nominal), state.measured - nominal

    planned = jnp.moveaxis(plan.inputs, 1, 0)
    offsets = jnp.arange(len(planned), dtype=step.dtype)
    _, deviations = scan_by_columns(follow_period, (state, state.measured), (offsets, planned))
    return deviations


def realisation_keys(seed: int, first: int, count: int) -> Key[Array, " count"]:
    """Return the keys of realisations first .. first + count - 1: functions of seed and index
    alone."""
    seed_key = make_key(seed)
    indices = range(first, first + count)
    high = jnp.array([index >> 32 for index in indices], jnp.uint32)
    low = jnp.array([index & 0xFFFFFFFF for index in indices], jnp.uint32)
    return _make_keys(seed_key, high, low)


# Compiled as a whole: operation by operation it is 20 programs.
_make_keys = jax.jit(jax.vmap(slips.realisation_key, in_axes=(None, 0, 0)))
