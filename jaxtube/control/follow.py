"""A controller that follows one plan of a tube-MPC to its end: what the tube is about.

    u = g_j + K(th) (e - e_nominal)     from the step of the plan until its horizon is reached

The deviations e - e_nominal are what the sections R_1 .. R_N of the tube promise to hold.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int

from jaxtube import qp
from jaxtube.control import mpc
from jaxtube.control.laws import TubeMpc
from jaxtube.control.protocol import DirectInputs, WheelMap
from jaxtube.plant.protocol import Command, Measurement


class Following(NamedTuple):
    """Memory of a followed plan; `deviates` where the next measured error is to be compared with
    `nominal`."""

    controller: mpc.MpcState
    plan: Float[Array, "batch horizon 2"]
    planned: Bool[Array, " batch"]
    nominal: Float[Array, "batch 3"]
    deviates: Bool[Array, " batch"]

    def deviation(self, measured: Float[Array, "batch 3"]) -> Float[Array, "batch 3"]:
        """Return e - e_nominal after a period in which the plan was followed, zero after others."""
        return jnp.where(self.deviates[:, None], measured - self.nominal, 0.0)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class PlanFollower:
    """A tube-MPC that follows the plan made at step `when` to its end.

    Before and after it acts as ever; an instance that has no plan then follows none.
    `controller.restart` must be true.
    """

    controller: TubeMpc
    when: Int[Array, " batch"]

    @property
    def wheel_map(self) -> WheelMap | DirectInputs:
        """How virtual inputs become wheel speeds."""
        return self.controller.wheel_map

    def initial(self, errors: Float[Array, "batch 3"]) -> Following:
        """Return the memory before the first period: no plan is followed."""
        memory = self.controller.initial(errors)
        none = jnp.zeros(len(errors), bool)
        return Following(memory, memory.inputs, none, errors, none)

    def act(
        self, step, memory: Following, measurement: Measurement, reference_wheels: Float[Array, "2"]
    ) -> tuple[Command, Following, mpc.Diagnostics]:
        """Return the command of the followed plan, or of the tube-MPC where none is followed."""
        errors = measurement.errors
        command, mpc_memory, diagnostics = self.controller.act(
            step, memory.controller, measurement, reference_wheels
        )
        condensed = self.controller.condensed_qp(step)
        stage = jnp.asarray(step, self.when.dtype) - self.when
        horizon = memory.plan.shape[1]
        now = stage == 0
        plan = jnp.where(now[:, None, None], mpc_memory.inputs, memory.plan)
        planned = jnp.where(now, diagnostics.status == qp.SOLVED, memory.planned)
        nominal = jnp.where(now[:, None], errors, memory.nominal)
        due_stage = jnp.clip(stage, 0, horizon - 1)[:, None, None]
        due = jnp.take_along_axis(plan, due_stage, axis=1)[:, 0]
        follows = planned & (stage >= 0) & (stage < horizon)
        followed = due + (errors - nominal) @ condensed.tube_gain.T
        inputs = jnp.where(follows[:, None], followed, command.inputs)
        command = self.wheel_map.command(inputs, measurement, reference_wheels)
        expected = nominal @ condensed.transition.T + due @ condensed.input_matrix.T
        nominal = jnp.where(follows[:, None], expected, errors)
        return command, Following(mpc_memory, plan, planned, nominal, follows), diagnostics
