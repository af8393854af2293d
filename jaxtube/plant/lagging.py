"""The plant whose wheels lag and whose commands come late, by times unknown within intervals.

A `LaggingRobot` draws the lag of its wheels once a lap and the delay of each command, beside the
slips and the noise of the `SlippingRobot`; a `ScriptedLaggingRobot` is told them. What both have in
common is a `LaggingBody` (`jaxtube.plant.lagging_body`).

Source: new.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Key

from jaxtube.plant import slip
from jaxtube.plant.lagging_body import LaggingBody, LaggingMemory
from jaxtube.plant.protocol import (
    Advance,
    Command,
    Measurement,
    Script,
    Uncertainty,
    script_entry,
)
from jaxtube.plant.robot import Robot
from jaxtube.plant.slip_bounds import SlipBounds
from jaxtube.plant.slipping import ScriptedRobot, SlipMemory, SlippingRobot, box_vertices
from jaxtube.plant.streams import Stream


class SlipSource(Protocol):
    """What draws slips and noise: a `SlippingRobot`, or another plant that mixes several."""

    @property
    def draws_extremes(self) -> Bool[Array, ""] | bool:
        """Whether deviations are -1 or 1 only; then those of lag and delay are, too."""
        ...

    def initial(self, keys: Key[Array, " batch"], errors: Float[Array, "batch 3"]) -> SlipMemory:
        """Return the memory before the first period."""
        ...

    def draw_slips(
        self, keys: Key[Array, " batch"], step, memory: SlipMemory, errors: Float[Array, "batch 3"]
    ) -> SlipMemory:
        """Draw the deviations of the slips of one period."""
        ...

    def measure_errors(
        self, keys: Key[Array, " batch"], step, errors: Float[Array, "batch 3"]
    ) -> Float[Array, "batch 3"]:
        """Return the tracking errors with the noise of an instant."""
        ...


@partial(jax.tree_util.register_dataclass, data_fields=["body", "source"], meta_fields=[])
@dataclass(frozen=True)
class LaggingRobot:
    """The nonlinear plant with lag and delay.

    Attributes:
        body: what moves.
        source: of slips and noise.
    """

    body: LaggingBody
    source: SlipSource

    has_wheels = True

    @property
    def reference_wheels(self) -> Float[Array, "steps 2"]:
        """The reference, m/s."""
        return self.body.reference_wheels

    @property
    def robot(self) -> Robot:
        """Geometry and wheel limits."""
        return self.body.ideal.robot

    @property
    def slips(self) -> SlipBounds:
        """Where true and measured slips may lie."""
        return self.body.ideal.slips

    @property
    def slip_source(self) -> SlipSource:
        """What draws the slips."""
        return self.source

    def initial(self, keys: Key[Array, " batch"], errors: Float[Array, "batch 3"]) -> LaggingMemory:
        """Draw the lags, and return the memory of wheels that run as the reference begins."""
        slips = self.source.initial(keys, errors)
        lag = jnp.zeros_like(errors[:, 0])
        if not self.body.known_lag:
            lag = self._draw(keys, Stream.LAG, slip.START, errors.dtype)
        return self.body.begin(slips, lag)

    def sense(
        self,
        keys: Key[Array, " batch"],
        step,
        memory: LaggingMemory,
        errors: Float[Array, "batch 3"],
    ) -> tuple[Measurement, LaggingMemory]:
        """Draw the pose noise of an instant and the slips of the period that begins there."""
        slips = self.source.draw_slips(keys, step, memory.slip, errors)
        add_noise = partial(self.source.measure_errors, keys, step)
        return self.body.measure(step, memory, slips, errors, add_noise)

    def advance(
        self,
        keys: Key[Array, " batch"],
        step,
        memory: LaggingMemory,
        errors: Float[Array, "batch 3"],
        command: Command,
    ) -> Advance:
        """Move through one period under the slips and delays that are drawn for it."""

        def draw_delays(issued) -> Float[Array, " batch"]:
            if self.body.known_delay:
                return jnp.zeros_like(errors[:, 0])
            return self._draw(keys, Stream.DELAY, issued, errors.dtype)

        return self.body.move(step, memory, errors, command, draw_delays)

    def _draw(
        self, keys: Key[Array, " batch"], stream: Stream, number, dtype
    ) -> Float[Array, " batch"]:
        """Return a deviation in [-1, 1] for every robot."""

        def draw(key: Key[Array, ""]) -> Float[Array, ""]:
            key = jax.random.fold_in(jax.random.fold_in(key, stream), number)
            drawn = slip.draw_uniform(key, (), dtype)
            return jnp.where(self.source.draws_extremes, jnp.where(drawn < 0, -1.0, 1.0), drawn)

        return jax.vmap(draw)(keys)

    def with_nominal_times(self) -> LaggingRobot:
        """Return the robot whose lag and delay are the nominal ones and known."""
        return dataclasses.replace(self, body=self.body.with_nominal_times())

    def uncertainties(self) -> dict[str, Uncertainty]:
        """Return slips, noise, lag and delay as boxes; raises as `SlippingRobot.uncertainties`."""
        uncertainties = self.body.ideal.uncertainties()
        if not self.body.known_lag:
            uncertainties["lag"] = Uncertainty(box_vertices(1), 1)
        if not self.body.known_delay:
            uncertainties["delay"] = Uncertainty(box_vertices(1), len(self.reference_wheels))
        return uncertainties

    def under_script(self, script: Script) -> ScriptedLaggingRobot:
        """Return the robot under given slips, noise, lag and delay."""
        return ScriptedLaggingRobot(self.body, script)


@partial(jax.tree_util.register_dataclass, data_fields=["body", "script"], meta_fields=[])
@dataclass(frozen=True)
class ScriptedLaggingRobot:
    """The lagging robot under given slips, noise, lag and delay; keys are ignored.

    The script has what that of a `ScriptedRobot` has, and the deviations in [-1, 1] of the `lag`,
    (1, batch, 1), and of the `delay` of each command, (times, batch, 1). What it does not name does
    not deviate.
    """

    body: LaggingBody
    script: Script

    @property
    def reference_wheels(self) -> Float[Array, "steps 2"]:
        """The reference, m/s."""
        return self.body.reference_wheels

    @property
    def _slipping(self) -> ScriptedRobot:
        return ScriptedRobot(self.body.ideal, self.script)

    def initial(self, keys, errors: Float[Array, "batch 3"]) -> LaggingMemory:
        """Return the memory of wheels that run as the reference begins."""
        lag = self._read("lag", 0, errors)
        return self.body.begin(self._slipping.initial(keys, errors), lag)

    def sense(
        self, keys, step, memory: LaggingMemory, errors: Float[Array, "batch 3"]
    ) -> tuple[Measurement, LaggingMemory]:
        """Read noise and slips from the script."""
        _, slips = self._slipping.sense(keys, step, memory.slip, errors)

        def add_noise(true: Float[Array, "batch 3"]) -> Float[Array, "batch 3"]:
            return self._slipping.sense(keys, step, slips, true)[0].errors

        return self.body.measure(step, memory, slips, errors, add_noise)

    def advance(
        self, keys, step, memory: LaggingMemory, errors: Float[Array, "batch 3"], command: Command
    ) -> Advance:
        """Move through one period under the slips and delays of the script."""

        def read_delays(issued) -> Float[Array, " batch"]:
            return self._read("delay", jnp.maximum(issued, 0), errors)

        return self.body.move(step, memory, errors, command, read_delays)

    def _read(self, name: str, step, errors: Float[Array, "batch 3"]) -> Float[Array, " batch"]:
        none = jnp.zeros_like(errors[:, 0])
        return script_entry(self.script[name], step)[:, 0] if name in self.script else none


BareRobot = SlippingRobot | LaggingRobot
"""The slipping robot, with or without lag and delay of its wheels."""
