"""A robot with imperfections that no certificate knows: a slipping robot whose period is not what
the model assumes.

    travel of a wheel    int_0^t speed,  speed' = clip((command - speed) / lag, +-1 / sluggishness)
    body                 x' = v cos phi - y~ sin phi,  y' = v sin phi + y~ cos phi,  phi' = om
    error                e_x' = om e_y + V cos e_th - v,  e_y' = -om e_x + V sin e_th - y~
                         e_th' = Om - om,  y~ = sideslip zeta v

v, om follow from the wheels and the true slips by eqs. (1)-(2), y~ is the body's own lateral
velocity, positive to the left, zeta in [-1, 1] its share of the moment; what the ideal robot slips
sideways by itself comes on top. The period is cut where a
late command arrives, where the slip changes, and into equal arcs. How far the wheels travel along
each arc is exact, hence the heading too; within an arc the turn is taken as uniform, which is an
approximation only while the wheels still change speed.

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (1)-(4), for the ideal robot; the
imperfections are new.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Int, Key

from jaxtube.plant.angles import sinc, sine_and_cosine
from jaxtube.plant.error_dynamics import Sideslip, advance, tracking_error
from jaxtube.plant.protocol import Advance, Command, Measurement
from jaxtube.plant.robot import body_velocity, saturate, wheel_commands
from jaxtube.plant.slipping import SlipMemory, SlippingRobot
from jaxtube.plant.streams import Stream

ARCS = 16
"""Equal arcs that a period is cut into."""


class Imperfections(NamedTuple):
    """How imperfect a robot is; 0 everywhere is the ideal one.

    Attributes:
        lag: time constant of the wheels, s.
        delay: by which commands arrive late, in periods, 0 to 1.
        sluggishness: 1 / (limit of a wheel's acceleration), s^2/m; 0 is no limit.
        sideslip: greatest lateral velocity of the body, by its speed.
        slip_change: share of the last period's slip error that lasts into this one, 0 to 1.
    """

    lag: Float[Array, ""] | float = 0.0
    delay: Float[Array, ""] | float = 0.0
    sluggishness: Float[Array, ""] | float = 0.0
    sideslip: Float[Array, ""] | float = 0.0
    slip_change: Float[Array, ""] | float = 0.0


class ImperfectMemory(NamedTuple):
    """What a period leaves to the next one."""

    slip: SlipMemory
    wheels: Float[Array, "batch 2"]  # speeds that the wheels have reached, m/s
    command: Float[Array, "batch 2"]  # what they follow until a new one arrives, m/s
    deviation: Float[Array, "batch 2"]  # of the true slip of the last period, in [-1, 1]


class Motion(NamedTuple):
    """What drives the robot through one period."""

    wheels: Float[Array, "batch 2"]  # speeds at its start, m/s
    late_commands: Float[Array, "batch 2"]  # followed until the delay, m/s
    commands: Float[Array, "batch 2"]  # followed from there on, m/s
    early_slips: Float[Array, "batch 2"]  # true slips before the instant
    slips: Float[Array, "batch 2"]  # and after it
    instant: Float[Array, " batch"]  # at which the slip changes, in periods
    sideslip: Float[Array, " batch"]  # lateral velocity by the forward speed


@partial(
    jax.tree_util.register_dataclass, data_fields=["ideal", "imperfections"], meta_fields=["arcs"]
)
@dataclass(frozen=True)
class ImperfectRobot:
    """The nonlinear plant with imperfections: draws, noise and wheel limits are those of the ideal
    one.

    The levels are data: a loop compiles once for all of them. Before its first period the robot
    drives as the reference does, under the nominal slip. The body drifts to the side that the slip
    error of the moment turns it to, zeta = half the difference (left - right) of its deviations:
    what pushes the heading error also pushes the lateral one.
    """

    ideal: SlippingRobot
    imperfections: Imperfections = field(default_factory=Imperfections)
    arcs: int = ARCS

    @property
    def reference_wheels(self) -> Float[Array, "steps 2"]:
        """The reference, m/s."""
        return self.ideal.reference_wheels

    def initial(
        self, keys: Key[Array, " batch"], errors: Float[Array, "batch 3"]
    ) -> ImperfectMemory:
        """Return the memory of slips and wheels."""
        ideal = self.ideal
        none = jnp.zeros_like(errors[:, :2])
        commands = wheel_commands(
            none, ideal.reference_wheels[0], ideal.slips.nominal, ideal.robot.track_width
        )
        wheels = saturate(commands, ideal.robot)
        return ImperfectMemory(ideal.initial(keys, errors), wheels, wheels, none)

    def sense(
        self,
        keys: Key[Array, " batch"],
        step,
        memory: ImperfectMemory,
        errors: Float[Array, "batch 3"],
    ) -> tuple[Measurement, ImperfectMemory]:
        """Draw the pose noise of an instant and the slips of the period that begins there."""
        measurement, slip = self.ideal.sense(keys, step, memory.slip, errors)
        return measurement, memory._replace(slip=slip)

    def true_slip(self, memory: ImperfectMemory) -> Float[Array, "batch 2"]:
        """Return the true slips that the period which has begun ends with."""
        return self.ideal.true_slip(memory.slip)

    def advance(
        self,
        keys: Key[Array, " batch"],
        step,
        memory: ImperfectMemory,
        errors: Float[Array, "batch 3"],
        command: Command,
    ) -> Advance:
        """Move through one period; the wheel speeds returned are the commands within the limits."""
        ideal = self.ideal
        true = memory.slip.true
        commands = saturate(command.wheels, ideal.robot)
        early = true + self.imperfections.slip_change * (memory.deviation - true)
        slip_error = jnp.clip(true - memory.slip.measured, -1.0, 1.0)
        motion = Motion(
            wheels=memory.wheels,
            late_commands=memory.command,
            commands=commands,
            early_slips=jnp.asarray(ideal.slips.true_slip(early)),
            slips=jnp.asarray(ideal.slips.true_slip(true)),
            instant=jax.vmap(lambda key: _instant(key, step, errors.dtype))(keys),
            sideslip=self.imperfections.sideslip * (slip_error[:, 1] - slip_error[:, 0]) / 2.0,
        )
        if ideal.sideslip is not None and memory.slip.sideslip is not None:
            own = ideal.sideslip * memory.slip.sideslip
            motion = motion._replace(sideslip=motion.sideslip + own)
        following, wheels = self.drive(step, errors, motion)
        return Advance(following, ImperfectMemory(memory.slip, wheels, commands, true), commands)

    def drive(
        self, step, errors: Float[Array, "batch 3"], motion: Motion
    ) -> tuple[Float[Array, "batch 3"], Float[Array, "batch 2"]]:
        """Drive through one period.

        Args:
            step: of the reference.
            errors: true tracking errors at its start, (m, m, rad).
            motion: what drives the robot.

        Returns:
            (tracking errors, wheel speeds m/s) at the end of the period: exact without lag and
            limit of acceleration, else with a heading error that is exact and positions to second
            order in the length of the arcs.
        """
        ideal = self.ideal
        level = self.imperfections
        track_width = ideal.robot.track_width
        dt = ideal.dt
        times = _breakpoints(motion.instant, level.delay, self.arcs, errors.dtype) * dt
        travel, wheels = _wheel_travel(motion, level.delay * dt, times, level)
        middle = (times[1:] + times[:-1]) / 2.0
        is_early = (middle < motion.instant * dt)[..., None]
        slip = jnp.where(is_early, motion.early_slips, motion.slips)
        sideslip = Sideslip(motion.sideslip, ideal.robot.lever_arm)
        pose = _path(jnp.diff(travel, axis=0), slip, sideslip, track_width)
        # In the frame of the robot at the start: there the reference stands at the error, and ends
        # where a robot that does not move would see it.
        standing = jnp.zeros_like(motion.wheels)
        reference = ideal.reference_wheels[step]
        reference_pose = advance(errors, standing, 0.0, reference, track_width, dt)
        return tracking_error(pose, reference_pose), wheels[-1]


def shifted_preview(
    index: Int[Array, " steps"],
    reference_wheels: Float[Array, "steps 2"],
    shift: Int[Array, ""] | int,
) -> Int[Array, " steps"]:
    """Give the windows of a controller that expects each change of the reference some steps off its
    time.

    The present reference is always right. What is wrong lies ahead: the window is that of the step
    `shift` later, or of the last one before the reference changes. A change is expected too early
    by that many steps, and again and again for the next step, until it comes; too late (`shift`
    below 0), so that it comes unannounced.

    Args:
        index: window of each step.
        reference_wheels: what is driven, m/s. One that changes at every step leaves nothing to be
            wrong about.
        shift: steps.

    Returns:
        The windows that the controller believes in.
    """
    changes = jnp.any(jnp.diff(reference_wheels, axis=0) != 0.0, axis=1)
    run = jnp.cumsum(jnp.concatenate([jnp.zeros(1, bool), changes]))
    first = jnp.searchsorted(run, run, side="left")
    last = jnp.searchsorted(run, run, side="right") - 1
    steps = jnp.arange(len(index), dtype=first.dtype)
    return index[jnp.clip(steps + shift, first, last)]


def _instant(key: Key[Array, ""], step, dtype) -> Float[Array, ""]:
    key = jax.random.fold_in(jax.random.fold_in(key, Stream.INSTANT), step)
    return jax.random.uniform(key, (), dtype)


def _breakpoints(
    instant: Float[Array, " batch"], delay, arcs: int, dtype
) -> Float[Array, "arcs+3 batch"]:
    """Give the ends of the arcs, in periods: equal ones, cut at the delay and at the instant."""
    even = jnp.broadcast_to(
        jnp.linspace(0.0, 1.0, arcs + 1, dtype=dtype)[:, None], (arcs + 1, len(instant))
    )
    return _insert_time(_insert_time(even, jnp.full_like(instant, delay)), instant)


def _insert_time(
    ordered: Float[Array, "times batch"], time: Float[Array, " batch"]
) -> Float[Array, "times+1 batch"]:
    """Insert a time between the first and the last of increasing ones: much faster than sorting."""
    return jnp.clip(
        time, jnp.concatenate([ordered[:1], ordered]), jnp.concatenate([ordered, ordered[-1:]])
    )


def _wheel_travel(
    motion: Motion, delay, times: Float[Array, "times batch"], level: Imperfections
) -> tuple[Float[Array, "times batch 2"], Float[Array, "times batch 2"]]:
    """Return (travel since the start m, speeds m/s) of wheels that follow one command until the
    delay, then another."""
    earlier = jnp.minimum(times, delay)[..., None]
    later = jnp.maximum(times - delay, 0.0)[..., None]
    travel, reached = _follow(motion.wheels, motion.late_commands, earlier, level)
    until_delay = jnp.full_like(motion.wheels, delay)
    _, at_delay = _follow(motion.wheels, motion.late_commands, until_delay, level)
    more, speeds = _follow(at_delay, motion.commands, later, level)
    return travel + more, jnp.where(later > 0.0, speeds, reached)


def _follow(wheels, command, time, level: Imperfections) -> tuple[Array, Array]:
    """Return (travel, speed) after some time: at the limit of acceleration first, exponentially
    from there on."""
    gap = command - wheels
    least = jnp.finfo(wheels.dtype).tiny
    # Both quotients are 0 / least where nothing limits: no time is spent at the limit, or no time
    # has passed.
    ramp = jnp.minimum(time, jnp.maximum(level.sluggishness * jnp.abs(gap) - level.lag, 0.0))
    left = gap - jnp.sign(gap) * ramp / jnp.maximum(level.sluggishness, least)
    closed = -jnp.expm1(-(time - ramp) / jnp.maximum(level.lag, least))
    lost = (gap + left) / 2.0 * ramp + level.lag * left * closed
    return command * time - lost, command - left * (1.0 - closed)


def _path(travel, slip, sideslip: Sideslip, track_width) -> Float[Array, "batch 3"]:
    """Return the pose after arcs, in the frame of its start, from how far the wheels travel along
    each of them."""
    moved = body_velocity(travel, slip, track_width)
    turn = moved[..., 1]
    shortening = sinc(turn / 2.0)
    forwards = moved[..., 0] * shortening
    sideways = sideslip.share * forwards - sideslip.lever_arm * turn * shortening
    heading = jnp.cumsum(turn, axis=0)
    chord_heading = heading - turn / 2.0
    s, c = sine_and_cosine(chord_heading)
    x = jnp.sum(c * forwards - s * sideways, axis=0)
    y = jnp.sum(s * forwards + c * sideways, axis=0)
    return jnp.stack([x, y, heading[-1]], axis=-1)
