"""A robot whose wheels lag and whose commands come late, under given lags and delays: exact motion
over each period.

    wheel     v' = (c - v) / tau, under the command c_k from k T + D_k on
    tracked   the committed pose, where the commands given so far take the robot: the errors are
              those of that pose, and so is what is measured (`jaxtube.plant.forecast`)

Both wheels have the same lag, constant over a lap; the delay may differ from command to command.
Slips, sideslip and pose noise are those of the `SlippingRobot`, slips constant from instant to
instant. Before its first period the robot drives as the reference begins, under the nominal slip.

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (1)-(4), for the robot; lag and delay are new.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from jaxtube.plant.error_dynamics import Sideslip
from jaxtube.plant.forecast import INSTANT, Forecast, commit, count_whole_periods, withdraw
from jaxtube.plant.motions import Motion, arc_of_travel, join, undo
from jaxtube.plant.protocol import Advance, Command, Measurement
from jaxtube.plant.robot import saturate, wheel_commands
from jaxtube.plant.slipping import SlipMemory, SlippingRobot
from jaxtube.plant.wheel_lag import Wheels, drive

Errors = Float[Array, "batch 3"]
Pair = Float[Array, "batch 2"]


class LaggingMemory(NamedTuple):
    """What a period leaves to the next one."""

    slip: SlipMemory
    measured_slip: Pair  # in the period that has begun
    lag: Float[Array, " batch"]  # s
    wheels: Pair  # speeds, m/s
    commands: Float[Array, "n batch 2"]  # within the limits, m/s, the newest last
    expected: Pair  # speeds over ground by the nominal lag, m/s
    intended: Float[Array, "n batch 2"]  # commands as speeds over ground, m/s


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["ideal", "forecast", "lag", "delay"],
    meta_fields=["whole", "arrivals", "known_lag", "known_delay"],
)
@dataclass(frozen=True)
class LaggingBody:
    """The robot.

    Attributes:
        ideal: the robot whose wheels obey at once, with all that both have in common.
        forecast: what the controller counts on.
        lag: least and greatest time constant of the wheels, s.
        delay: least and greatest delay of the commands, s.
        whole: whole periods of the least delay.
        arrivals: how many commands may arrive within a period, not at its start.
        known_lag: whether the lag is known.
        known_delay: whether the delay is known, and the same for all commands.
    """

    ideal: SlippingRobot
    forecast: Forecast
    lag: Float[Array, "2"]
    delay: Float[Array, "2"]
    whole: int
    arrivals: int
    known_lag: bool
    known_delay: bool

    @classmethod
    def of(
        cls,
        ideal: SlippingRobot,
        forecast: Forecast,
        lag: tuple[float, float],
        delay: tuple[float, float],
    ) -> LaggingBody:
        """Return a robot whose wheels lag and whose commands come late.

        Args:
            ideal: with wheels that obey at once.
            forecast: what the controller counts on, its period a number.
            lag, delay: least and greatest, s.
        """
        dt = float(forecast.dt)
        low, high = delay
        whole = count_whole_periods(low, dt)
        is_on_time = low == high and abs(low - whole * dt) <= dt * INSTANT
        arrivals = 0 if is_on_time else 1 if high <= (whole + 1) * dt else 2
        return cls(
            ideal=ideal,
            forecast=forecast,
            lag=jnp.array(lag),
            delay=jnp.array(delay),
            whole=whole,
            arrivals=arrivals,
            known_lag=lag[0] == lag[1],
            known_delay=low == high,
        )

    def with_nominal_times(self) -> LaggingBody:
        """Return the robot whose lag and delay are those that the forecast counts on, and known."""
        forecast = self.forecast
        delay = forecast.latency - forecast.lag
        is_late = float(forecast.late) > 0
        return replace(
            self,
            lag=jnp.array([forecast.lag, forecast.lag]),
            delay=jnp.array([delay, delay]),
            whole=forecast.whole,
            arrivals=1 if is_late else 0,
            known_lag=True,
            known_delay=True,
        )

    @property
    def reference_wheels(self) -> Float[Array, "steps 2"]:
        """The reference, m/s."""
        return self.ideal.reference_wheels

    def begin(self, slips: SlipMemory, lag: Float[Array, " batch"]) -> LaggingMemory:
        """Return the memory before the first period, for deviations of the lag in [-1, 1]."""
        ideal = self.ideal
        none = jnp.zeros((*lag.shape, 2), lag.dtype)
        nominal = ideal.slips.nominal
        start = wheel_commands(none, self.reference_wheels[0], nominal, ideal.robot.track_width)
        start = saturate(start, ideal.robot)
        over_ground = start * (1.0 - nominal)
        count = max(self.forecast.memory, self.whole + 1 + self.arrivals)
        return LaggingMemory(
            slip=slips,
            measured_slip=none,
            lag=_between(self.lag, lag),
            wheels=start,
            commands=jnp.broadcast_to(start, (count, *start.shape)),
            expected=over_ground,
            intended=jnp.broadcast_to(over_ground, (count, *start.shape)),
        )

    def measure(
        self,
        step,
        memory: LaggingMemory,
        slips: SlipMemory,
        errors: Errors,
        add_noise: Callable[[Errors], Errors],
    ) -> tuple[Measurement, LaggingMemory]:
        """Return what is measured under slips, where `add_noise` acts on errors of the pose."""
        if self.ideal.noise is not None:
            ahead, behind = self._ahead_and_behind(step, memory)
            errors = commit(add_noise(withdraw(errors, ahead, behind)), ahead, behind)
        measured_slip = self.ideal.measured_slip(slips)
        memory = memory._replace(slip=slips, measured_slip=measured_slip)
        return Measurement(errors, measured_slip), memory

    def pose_errors(self, step, memory: LaggingMemory, errors: Errors) -> Errors:
        """Return the errors of the poses themselves, against where the reference was the latency
        before, from those of the committed poses."""
        return withdraw(errors, *self._ahead_and_behind(step, memory))

    def _ahead_and_behind(self, step, memory: LaggingMemory) -> tuple[Motion, Motion]:
        ahead = self.forecast.motion_ahead(memory.expected, memory.intended)
        behind = self.forecast.reference_behind(self.reference_wheels, step)
        return ahead, jnp.broadcast_to(behind, ahead.shape)

    def move(
        self,
        step,
        memory: LaggingMemory,
        errors: Errors,
        command: Command,
        delays: Callable[[Array], Float[Array, " batch"]],
    ) -> Advance:
        """Move through one period.

        Args:
            step: number of the period.
            memory: with lags, slips, wheels and commands.
            errors: of the committed poses at its start, (m, m, rad).
            command: of the period.
            delays: returns the deviations in [-1, 1] of the delays of a step's command.
        """
        ideal = self.ideal
        width = ideal.robot.track_width
        within = saturate(command.wheels, ideal.robot)
        commands = _remember(memory.commands, within)
        intended = _remember(memory.intended, within * (1.0 - memory.measured_slip))
        last = len(commands) - self.whole
        arrivals = self._arrivals(step, delays, memory.lag)
        followed = commands[last - 1 - self.arrivals : last]
        wheels = Wheels(memory.wheels, followed, arrivals, memory.lag)
        grip = 1.0 - jnp.asarray(ideal.slips.true_slip(memory.slip.true))
        sideslip = self._sideslip(memory.slip)
        motion, speeds = drive(wheels, grip, sideslip, width, ideal.dt)
        ahead = self.forecast.motion_ahead(memory.expected, memory.intended)
        expected = self.forecast.speeds_after(memory.expected, intended)
        committed = join(join(undo(ahead), motion), self.forecast.motion_ahead(expected, intended))
        reference = arc_of_travel(self.reference_wheels[step] * ideal.dt, width)
        following = join(join(undo(committed), errors), jnp.broadcast_to(reference, errors.shape))
        memory = memory._replace(
            wheels=speeds, commands=commands, expected=expected, intended=intended
        )
        return Advance(following, memory, within)

    def _sideslip(self, slips: SlipMemory) -> Sideslip | None:
        ideal = self.ideal
        if ideal.sideslip is None or slips.sideslip is None:
            return None
        return Sideslip(ideal.sideslip * slips.sideslip, ideal.robot.lever_arm)

    def _arrivals(
        self,
        step,
        delays: Callable[[Array], Float[Array, " batch"]],
        lag: Float[Array, " batch"],
    ) -> Float[Array, "n batch"]:
        """Return when the commands arrive that do so in a period, s after its start."""
        dt = self.ideal.dt
        arrivals = [jnp.zeros((0, *lag.shape), lag.dtype)]
        for later in range(self.arrivals - 1, -1, -1):
            back = self.whole + later
            arrival = _between(self.delay, delays(step - back)) - back * dt
            arrivals.append(jnp.clip(arrival, 0.0, dt)[None])
        return jnp.concatenate(arrivals)


def _between(
    interval: Float[Array, "2"], deviation: Float[Array, " batch"]
) -> Float[Array, " batch"]:
    """Return where in an interval a deviation in [-1, 1] lies."""
    low, high = interval
    return (low + high) / 2.0 + (high - low) / 2.0 * deviation


def _remember(commands: Float[Array, "n batch 2"], newest: Pair) -> Float[Array, "n batch 2"]:
    """Return the commands with the newest one last, the oldest forgotten."""
    return jnp.concatenate([commands[1:], newest[None]])
