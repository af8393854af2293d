"""Random slips and pose noise of one realisation, drawn by index so that no batch or chunk changes
them.

    true     = nominal (1 + relative_error xi_true)
    measured = nominal (1 + relative_error xi_measured)        xi in [-1, 1]^2, (right, left)

A process says how xi evolves: afresh at each step, constant, as a bounded random walk, tied to the
ground, at the extremes of its range, or against the robot. Which of the two slips varies is
`random`: "true", "measured" or "both" (then independently, but for the adversary, who is one).

Each draw is a pure function of seed, realisation, purpose and step, or patch of ground, by
`jax.random.fold_in` (Salmon, Moraes, Dror, Shaw 2011); what the adversary makes of its draw depends
on the tracking error too. All functions are for one realisation; the caller vmaps them.

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, section IV (slip measurements vary by 10 %); the
processes are new.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import DTypeLike
from jaxtyping import Float, Key

from jaxtube.plant import adversary

# Purposes: the streams of one realisation.
TRUE_SLIP, MEASURED_SLIP, POSE_NOISE = 0, 1, 2
# The stream of a process starts with this number, which no step reaches.
START = 0xFFFFFFFF

RANDOM_SLIPS = ("true", "measured", "both")

State = tuple[Array, ...]


class Situation(NamedTuple):
    """What a process may look at when it chooses the deviation of one step."""

    wheel_positions: Float[Array, "2 2"]  # contact points (right, left) by (x, y), m, world frame
    errors: Float[Array, "3"]  # true tracking error, (m, m, rad)


@dataclass(frozen=True)
class Process:
    """How the deviation xi of one slip evolves, for both wheels.

    Attributes:
        initial: (key, dtype) -> state before the first step.
        deviation: (key, step, state, situation) -> (xi (right, left) in [-1, 1], next state); xi
            has the dtype of the situation.
        opposed: the true slip follows `deviation` and the measured one its negative, from the same
            draws: a measured slip that is too large drives the wheel faster, a true one lets it
            lose more.
    """

    initial: Callable[[Key[Array, ""], DTypeLike], State]
    deviation: Callable[..., tuple[Float[Array, "2"], State]]
    opposed: bool = False


def iid() -> Process:
    """Draw each wheel afresh at each step, uniformly."""

    def deviation(key, step, state, situation):
        return _uniform(jax.random.fold_in(key, step), (2,), situation.errors.dtype), state

    return Process(_stateless, deviation)


def constant() -> Process:
    """Draw each wheel once per realisation, uniformly."""

    def deviation(key, step, state, situation):
        return _uniform(jax.random.fold_in(key, START), (2,), situation.errors.dtype), state

    return Process(_stateless, deviation)


def walk(step_size: float = 0.1) -> Process:
    """Let each wheel walk at random between reflecting walls at -1 and 1.

    Args:
        step_size: a step is uniform within +-step_size, in (0, 2].

    Returns:
        A process that is uniform in [-1, 1] at every step, from the first on.
    """
    _refuse_unless(0.0 < step_size <= 2.0, "step_size", step_size, "choose it in (0, 2]")

    def initial(key, dtype):
        return (_uniform(jax.random.fold_in(key, START), (2,), dtype),)

    def deviation(key, step, state, situation):
        (xi,) = state
        moved = xi + step_size * _uniform(jax.random.fold_in(key, step), (2,), xi.dtype)
        return xi, (jnp.where(jnp.abs(moved) > 1.0, jnp.sign(moved) * 2.0 - moved, moved),)

    return Process(initial, deviation)


def patches(patch_size: float = 1.0) -> Process:
    """Tie the slip to the ground: square patches, each with its own deviation for whatever wheel
    stands on it.

    Args:
        patch_size: side of a patch, m, positive.

    Returns:
        A process without memory: passing again over the same ground meets the same slip.
    """
    _refuse_unless(patch_size > 0.0, "patch_size", patch_size, "give a positive length in m")

    def deviation(key, step, state, situation):
        def under(position):
            column, row = jnp.floor(position / patch_size).astype(jnp.int32)
            return _uniform(
                jax.random.fold_in(jax.random.fold_in(key, column), row), (), position.dtype
            )

        return jax.vmap(under)(situation.wheel_positions), state

    return Process(_stateless, deviation)


def vertex() -> Process:
    """Draw each wheel afresh at each step, -1 or 1 with equal chance."""

    def deviation(key, step, state, situation):
        return jax.random.rademacher(
            jax.random.fold_in(key, step), (2,), situation.errors.dtype
        ), state

    return Process(_stateless, deviation)


def adversarial() -> Process:
    """Act against the robot, each realisation by a scheme of its own (`jaxtube.plant.adversary`)."""

    def initial(key, dtype):
        return adversary.draw_scheme(jax.random.fold_in(key, START), dtype)

    def deviation(key, step, state, situation):
        right, left = situation.wheel_positions
        track_width = jnp.hypot(right[0] - left[0], right[1] - left[1])
        direction = adversary.pushed_direction(state, step, situation.errors)
        return adversary.worst_vertex(direction, situation.errors, track_width), state

    return Process(initial, deviation, opposed=True)


PROCESSES = {
    "iid": iid,
    "constant": constant,
    "walk": walk,
    "patches": patches,
    "vertex": vertex,
    "adversarial": adversarial,
}


def find_process(process: str | Process) -> Process:
    """Return the slip process of a name, or the process itself."""
    return PROCESSES[process]() if isinstance(process, str) else process


def realisation_key(
    seed_key: Key[Array, ""], index_high: Array | int, index_low: Array | int
) -> Key[Array, ""]:
    """Give the key of one realisation.

    Args:
        seed_key: key of the whole experiment.
        index_high: index of the realisation divided by 2^32, rounded down.
        index_low: the remainder. Two words, because `fold_in` takes its number modulo 2^32 without
            a word.

    Returns:
        A key that depends on seed and index alone.
    """
    return jax.random.fold_in(jax.random.fold_in(seed_key, index_high), index_low)


def initial_slip(
    run_key: Key[Array, ""], process: Process, dtype: DTypeLike = float
) -> tuple[State, State]:
    """Start the true and the measured slip of one realisation.

    Args:
        run_key: key of the realisation.
        process: how deviations evolve.
        dtype: of the state's numbers.

    Returns:
        The pair of states that `draw_slip` takes first.
    """
    true_key, measured_key = _slip_keys(run_key, process)
    return process.initial(true_key, dtype), process.initial(measured_key, dtype)


def draw_slip(
    run_key: Key[Array, ""],
    step: Array | int,
    state: tuple[State, State],
    situation: Situation,
    process: Process,
    random: str,
) -> tuple[Float[Array, "2"], Float[Array, "2"], tuple[State, State]]:
    """Draw the deviations of the true and the measured slip at one step.

    Args:
        run_key: key of the realisation.
        step: number of the step, from 0.
        state: what `initial_slip` or the last step returned.
        situation: where robot and wheels are.
        process: how deviations evolve.
        random: which slip varies, "true", "measured" or "both"; the other's deviation is 0.

    Returns:
        (xi_true, xi_measured, next state); xi is (right, left) in [-1, 1].

    Raises:
        ValueError: when `random` is none of the three.
    """
    _refuse_unless(
        random in RANDOM_SLIPS, "random", random, f"choose one of {', '.join(RANDOM_SLIPS)}"
    )
    true_key, measured_key = _slip_keys(run_key, process)
    true_state, measured_state = state
    xi_true = xi_measured = jnp.zeros(2, situation.errors.dtype)
    if random != "measured":
        xi_true, true_state = process.deviation(true_key, step, true_state, situation)
    if random != "true":
        xi_measured, measured_state = process.deviation(
            measured_key, step, measured_state, situation
        )
        xi_measured = -xi_measured if process.opposed else xi_measured
    return xi_true, xi_measured, (true_state, measured_state)


def deviated(
    nominal_slip: Float[Array, "... 2"], relative_error: float, xi: Float[Array, "... 2"]
) -> Float[Array, "... 2"]:
    """Give the slip that deviates from the nominal one.

    Args:
        nominal_slip: (right, left).
        relative_error: greatest deviation, as a fraction of the nominal slip.
        xi: normalised deviation (right, left) in [-1, 1].

    Returns:
        nominal (1 + relative_error xi).
    """
    return nominal_slip * (1.0 + relative_error * xi)


def pose_noise(
    run_key: Key[Array, ""], step: Array | int, half_widths: Float[Array, "3"]
) -> Float[Array, "3"]:
    """Draw the noise of one pose measurement.

    Args:
        run_key: key of the realisation.
        step: number of the step, from 0.
        half_widths: of the box the noise is uniform in, (m, m, rad).

    Returns:
        (m, m, rad), within the box.
    """
    key = jax.random.fold_in(jax.random.fold_in(run_key, POSE_NOISE), step)
    return half_widths * _uniform(key, (3,), half_widths.dtype)


def _slip_keys(run_key: Key[Array, ""], process: Process) -> tuple[Key[Array, ""], Key[Array, ""]]:
    """Give the streams of the true and the measured slip: one for both where they are opposed."""
    true_key = jax.random.fold_in(run_key, TRUE_SLIP)
    return true_key, true_key if process.opposed else jax.random.fold_in(run_key, MEASURED_SLIP)


def _uniform(key: Key[Array, ""], shape: tuple[int, ...], dtype: DTypeLike) -> Array:
    """Draw uniformly from [-1, 1)."""
    return jax.random.uniform(key, shape, dtype, -1.0, 1.0)


def _stateless(key: Key[Array, ""], dtype: DTypeLike) -> State:
    """Start a process that keeps nothing between steps."""
    return ()


def _refuse_unless(valid: bool, field: str, value: object, cure: str) -> None:
    """Refuse a bad setting in one line."""
    if not valid:
        raise ValueError(f"slip: {field} = {value!r} is not usable; {cure}")
