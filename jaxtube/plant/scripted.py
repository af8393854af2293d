"""Plants whose uncertainties are given instead of drawn, and a controller that follows one plan to
its end.

A script is a mapping from the name of an uncertainty to its values, time first, realisations next:
`true` and `measured` deviations of the slips (times, batch, 2) and the pose `noise` (steps + 1,
batch, 3), all in [-1, 1], for the slipping robot; the `disturbance` w (steps, batch, 3) in W for
the linear plant. What is not named does not vary; beyond its last time a script goes on with its
last value, so that one entry is a constant.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int

from jaxtube import qp
from jaxtube.control import mpc
from jaxtube.control.laws import TubeMpc
from jaxtube.simulation.rollout import LinearPlant, SlippingRobot

Script = dict[str, Float[Array, "times batch n"]]


def entry(values: Float[Array, "times batch n"], step) -> Float[Array, "batch n"]:
    """Return what a script says at a step."""
    return values[jnp.minimum(step, len(values) - 1)]


@partial(jax.tree_util.register_dataclass, data_fields=["robot", "script"], meta_fields=[])
@dataclass(frozen=True)
class ScriptedRobot:
    """The slipping robot under given slips and noise; keys are ignored."""

    robot: SlippingRobot
    script: Script

    @property
    def reference_wheels(self) -> Float[Array, "steps 2"]:
        """The reference, m/s."""
        return self.robot.reference_wheels

    def initial(self, keys, errors: Float[Array, "batch 3"]) -> tuple[()]:
        """Return no memory."""
        return ()

    def measure(self, keys, step, errors: Float[Array, "batch 3"]) -> Float[Array, "batch 3"]:
        """Return the errors with the script's noise."""
        if "noise" not in self.script:
            return errors
        assert self.robot.noise is not None
        return errors + self.robot.noise * entry(self.script["noise"], step)

    def acting(self, step, inputs, measured, controller):
        """Return the deficits that virtual inputs ask for."""
        return self.robot.acting(step, inputs, measured, controller)

    def advance(self, keys, step, state, errors, inputs, controller):
        """Return (next errors, no memory, wheels, wheels before saturation) of one period."""
        nominal = jnp.zeros_like(inputs)
        true, measured = (
            entry(self.script[name], step) if name in self.script else nominal
            for name in ("true", "measured")
        )
        following, wheels, demanded = self.robot.move(
            step, errors, inputs, true, measured, controller
        )
        return following, state, wheels, demanded


@partial(jax.tree_util.register_dataclass, data_fields=["plant", "script"], meta_fields=[])
@dataclass(frozen=True)
class ScriptedLinearPlant:
    """The prediction model under a given w; keys are ignored."""

    plant: LinearPlant
    script: Script

    @property
    def reference_wheels(self) -> Float[Array, "steps 2"]:
        """The reference, m/s."""
        return self.plant.reference_wheels

    def initial(self, keys, errors: Float[Array, "batch 3"]) -> tuple[()]:
        """Return no memory."""
        return ()

    def measure(self, keys, step, errors: Float[Array, "batch 3"]) -> Float[Array, "batch 3"]:
        """Return the errors themselves."""
        return errors

    def acting(self, step, inputs, measured, controller):
        """Return the virtual inputs themselves."""
        return inputs

    def advance(self, keys, step, state, errors, inputs, controller):
        """Return (next errors, no memory, no wheels: NaN twice) of one period."""
        A, B = self.plant.transitions[step], self.plant.input_matrices[step]
        following = errors @ A.T + inputs @ B.T + entry(self.script["disturbance"], step)
        no_wheels = jnp.full_like(inputs, jnp.nan)
        return following, state, no_wheels, no_wheels


def scripted(
    plant: SlippingRobot | LinearPlant, script: Script
) -> ScriptedRobot | ScriptedLinearPlant:
    """Return a plant that meets what the script says instead of what it would draw."""
    return (
        ScriptedRobot(plant, script)
        if isinstance(plant, SlippingRobot)
        else ScriptedLinearPlant(plant, script)
    )


class Following(NamedTuple):
    """Memory of a plan that is followed; `deviates` where the next measured error is to be compared
    with `nominal`."""

    controller: mpc.MpcState
    plan: Float[Array, "batch horizon 2"]
    planned: Bool[Array, " batch"]
    nominal: Float[Array, "batch 3"]
    deviates: Bool[Array, " batch"]


@partial(jax.tree_util.register_dataclass, data_fields=["controller", "when"], meta_fields=[])
@dataclass(frozen=True)
class PlanFollower:
    """A tube-MPC that follows the plan made at step `when` to its end, u = g_j + K(th) (e -
    e_nominal).

    Before and after it acts as ever; an instance that has no plan then follows none.
    `controller.restart` must be true.
    """

    controller: TubeMpc
    when: Int[Array, " batch"]
    compensates = True

    @property
    def input_map(self) -> str:
        """What the controller's virtual inputs mean."""
        return self.controller.input_map

    def initial(self, errors: Float[Array, "batch 3"]) -> Following:
        """Return the memory before the first step."""
        memory, none = self.controller.initial(errors), jnp.zeros(len(errors), bool)
        return Following(memory, memory.inputs, none, errors, none)

    def act(
        self,
        step,
        state: Following,
        errors: Float[Array, "batch 3"],
        reference_wheels: Float[Array, "2"],
    ):
        """Return (inputs, next memory, diagnostics) of one step."""
        inputs, memory, diagnostics = self.controller.act(
            step, state.controller, errors, reference_wheels
        )
        window = mpc.take_window(self.controller.windows, self.controller.index[step])
        stage, horizon = jnp.asarray(step, self.when.dtype) - self.when, state.plan.shape[1]
        now = stage == 0
        plan = jnp.where(now[:, None, None], memory.inputs, state.plan)
        planned = jnp.where(now, diagnostics.status == qp.SOLVED, state.planned)
        nominal = jnp.where(now[:, None], errors, state.nominal)
        due = jnp.take_along_axis(plan, jnp.clip(stage, 0, horizon - 1)[:, None, None], axis=1)[
            :, 0
        ]
        follows = planned & (stage >= 0) & (stage < horizon)
        inputs = jnp.where(follows[:, None], due + (errors - nominal) @ window.tube_gain.T, inputs)
        expected = nominal @ window.transition.T + due @ window.input_matrix.T
        nominal = jnp.where(follows[:, None], expected, errors)
        return inputs, Following(memory, plan, planned, nominal, follows), diagnostics


def deviation(state: Following, measured: Float[Array, "batch 3"]) -> Float[Array, "batch 3"]:
    """Return e - e_nominal after a period in which the plan was followed, zero after the others."""
    return jnp.where(state.deviates[:, None], measured - state.nominal, 0.0)
