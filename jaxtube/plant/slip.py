"""Random slips and pose noise of one realisation, drawn by index so that no batch or chunk changes
them.

The deviations xi in [-1, 1]^2, (right, left), of true and measured slips become slips by
`jaxtube.plant.slip_bounds`; a third deviation is that of the sideslip.

A slip process says how xi evolves: one of those named in `jaxtube.plant.slip_processes`, or any
other object that fits `SlipProcess`. Which of the two slips varies is `uncertain_slip`: "true",
"measured" or "both" (then independently, except under an opposed process such as the adversary).
The body slips sideways on its own, except under an opposed process: there it drifts to the side
that the errors of the wheels turn it to, and pushes the lateral error as they do.

Each draw is a pure function of seed, realisation, purpose and step, or patch of ground, by
`jax.random.fold_in` (Salmon, Moraes, Dror, Shaw 2011); an adversary's choice depends on the
tracking error too. All functions are for one realisation; the caller vmaps them.

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, section IV (slip measurements vary by 10 %).
"""

from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import DTypeLike
from jaxtyping import Float, Key

from jaxtube.plant.protocol import Memory
from jaxtube.plant.streams import Stream

START = 0xFFFFFFFF
"""Number with which the stream of a process starts; no step reaches it."""

UNCERTAIN_SLIPS = ("true", "measured", "both")


class Situation(NamedTuple):
    """What a process may look at when it chooses the deviation of one step."""

    wheel_positions: Float[Array, "2 2"]  # contact points (right, left) by (x, y), m, world frame
    errors: Float[Array, "3"]  # true tracking error, (m, m, rad)


class SlipProcess(Protocol):
    """How the deviation xi of one slip evolves, for both wheels of one realisation.

    Both methods run inside `jax.jit`, `jax.vmap` over realisations and `jax.lax.scan` over steps.
    They must be pure: every random number comes from the key, by `jax.random.fold_in`. The process
    itself is a static argument of compiled programs and hence hashable; a frozen dataclass of plain
    numbers is, and compares by value, so that equal processes share one compilation.

    A wheel that loses its grip step by step:

        @dataclass(frozen=True)
        class Fading:
            rate: float = 0.01  # per step
            opposed = False

            def initial(self, key, dtype):
                return ()

            def draw(self, key, step, memory, situation):
                xi = jnp.minimum(self.rate * step, 1.0)
                return jnp.full(2, xi, situation.errors.dtype), memory
    """

    @property
    def opposed(self) -> bool:
        """Whether the measured slip deviates by the negative of `draw`, from the draws of the true
        one.

        A measured slip that is too large drives the wheel faster; a true one that is too large lets
        it lose more. A process that acts against the robot is opposed; where chance alone decides,
        the two slips are independent.
        """
        ...

    def initial(self, key: Key[Array, ""], dtype: DTypeLike) -> Memory:
        """Return the memory before the first step.

        Args:
            key: of this slip in this realisation, the same as in `draw`.
            dtype: of the memory's real numbers.
        """
        ...

    def draw(
        self, key: Key[Array, ""], step: Array | int, memory: Memory, situation: Situation
    ) -> tuple[Float[Array, "2"], Memory]:
        """Return the deviation of one step and the next memory.

        Args:
            key: of this slip in this realisation; fold the step in for a fresh draw.
            step: number of the step, from 0.
            memory: what `initial` or the last step returned.
            situation: where robot and wheels are.

        Returns:
            (xi (right, left) in [-1, 1], next memory); xi has the dtype of `situation.errors`. A xi
            beyond 1 is a slip error beyond the one that sets and certificates know.
        """
        ...


@runtime_checkable
class JointProcess(Protocol):
    """A process whose sideslip belongs to its slips: it is drawn from their key, so that one draw
    makes both. What is measured of the slips follows a law of its own."""

    @property
    def measured(self) -> SlipProcess:
        """How the deviation of the measured slip evolves."""
        ...

    @property
    def sideslip(self) -> SlipProcess:
        """How the deviation of the sideslip evolves, as its first number."""
        ...


def realisation_key(
    seed_key: Key[Array, ""], index_high: Array | int, index_low: Array | int
) -> Key[Array, ""]:
    """Return the key of one realisation.

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
    run_key: Key[Array, ""], process: SlipProcess, dtype: DTypeLike = float
) -> tuple[Memory, Memory]:
    """Return the memories of the true and the measured slip before the first step.

    Args:
        run_key: key of the realisation.
        process: how deviations evolve.
        dtype: of the memories' real numbers.

    Returns:
        The pair of memories that `draw_slip` takes first.
    """
    true_key, measured_key = _slip_keys(run_key, process)
    true_memory = process.initial(true_key, dtype)
    measured_memory = _measured_process(process).initial(measured_key, dtype)
    return true_memory, measured_memory


def draw_slip(
    run_key: Key[Array, ""],
    step: Array | int,
    memory: tuple[Memory, Memory],
    situation: Situation,
    process: SlipProcess,
    uncertain_slip: str,
) -> tuple[Float[Array, "2"], Float[Array, "2"], tuple[Memory, Memory]]:
    """Draw the deviations of the true and the measured slip at one step.

    Args:
        run_key: key of the realisation.
        step: number of the step, from 0.
        memory: what `initial_slip` or the last step returned.
        situation: where robot and wheels are.
        process: how deviations evolve.
        uncertain_slip: which slip varies, "true", "measured" or "both"; the other's deviation is 0.

    Returns:
        (xi_true, xi_measured, next memory); xi is (right, left) in [-1, 1].

    Raises:
        ValueError: when `uncertain_slip` is none of the three.
    """
    choices = ", ".join(UNCERTAIN_SLIPS)
    _refuse_unless(
        uncertain_slip in UNCERTAIN_SLIPS, "random", uncertain_slip, f"choose one of {choices}"
    )
    true_key, measured_key = _slip_keys(run_key, process)
    true_memory, measured_memory = memory
    nothing = jnp.zeros(2, situation.errors.dtype)
    xi_true = nothing
    xi_measured = nothing
    if uncertain_slip != "measured":
        xi_true, true_memory = process.draw(true_key, step, true_memory, situation)
    if uncertain_slip != "true":
        measured = _measured_process(process)
        xi_measured, measured_memory = measured.draw(measured_key, step, measured_memory, situation)
        xi_measured = -xi_measured if process.opposed else xi_measured
    return xi_true, xi_measured, (true_memory, measured_memory)


def initial_sideslip(
    run_key: Key[Array, ""], process: SlipProcess, dtype: DTypeLike = float
) -> Memory:
    """Return the memory of the sideslip before the first step, as `initial_slip` does."""
    key, sideways = _sideslip_stream(run_key, process)
    return sideways.initial(key, dtype)


def draw_sideslip(
    run_key: Key[Array, ""],
    step: Array | int,
    memory: Memory,
    situation: Situation,
    process: SlipProcess,
    slip_error: Float[Array, "2"],
) -> tuple[Float[Array, ""], Memory]:
    """Draw the deviation of the sideslip at one step.

    Args:
        run_key: key of the realisation.
        step: number of the step, from 0.
        memory: what `initial_sideslip` or the last step returned.
        situation: where robot and wheels are.
        process: how deviations evolve.
        slip_error: deviations of the true slips less those of the measured ones (right, left).

    Returns:
        (xi in [-1, 1], positive to the left, next memory).
    """
    if process.opposed:
        right, left = jnp.clip(slip_error, -1.0, 1.0)
        return (left - right) / 2.0, memory
    key, sideways = _sideslip_stream(run_key, process)
    xi, following = sideways.draw(key, step, memory, situation)
    return xi[0], following


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
    key = jax.random.fold_in(jax.random.fold_in(run_key, Stream.POSE_NOISE), step)
    return half_widths * draw_uniform(key, (3,), half_widths.dtype)


def _slip_keys(
    run_key: Key[Array, ""], process: SlipProcess
) -> tuple[Key[Array, ""], Key[Array, ""]]:
    """Return the streams of the true and the measured slip: one for both where they are opposed."""
    true_key = jax.random.fold_in(run_key, Stream.TRUE_SLIP)
    if process.opposed:
        return true_key, true_key
    return true_key, jax.random.fold_in(run_key, Stream.MEASURED_SLIP)


def _measured_process(process: SlipProcess) -> SlipProcess:
    """Return how the measured slip evolves."""
    return process.measured if isinstance(process, JointProcess) else process


def _sideslip_stream(
    run_key: Key[Array, ""], process: SlipProcess
) -> tuple[Key[Array, ""], SlipProcess]:
    """Return the stream of the sideslip, and how it evolves."""
    if isinstance(process, JointProcess):
        return jax.random.fold_in(run_key, Stream.TRUE_SLIP), process.sideslip
    return jax.random.fold_in(run_key, Stream.SIDESLIP), process


def draw_uniform(key: Key[Array, ""], shape: tuple[int, ...], dtype: DTypeLike) -> Array:
    """Draw uniformly from [-1, 1)."""
    return jax.random.uniform(key, shape, dtype, -1.0, 1.0)


def _refuse_unless(valid: bool, field: str, value: object, cure: str) -> None:
    """Refuse a bad setting in one line."""
    if not valid:
        raise ValueError(f"slip: {field} = {value!r} is not usable; {cure}")
