"""The controllers that come with a design: tube-MPC, the paper's tracking law, a scheduled gain.

Each is a `Controller`, a pytree whose arrays run along the reference. Beyond the contract they say
what runs and their checks ask of them: `free_gains_of`, `planner_of`, `solves_qp`, `input_map_of`,
`without_rounds`.

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, sections III and IV.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int

from jaxtube import qp
from jaxtube.columns import use_twice
from jaxtube.control import mpc, planning
from jaxtube.control.protocol import Controller, DirectInputs, WheelMap
from jaxtube.control.tracking import tracking_input
from jaxtube.plant.protocol import Command, Measurement
from jaxtube.qp.batched_ldl import matmul


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["qps", "index", "wheel_map"],
    meta_fields=["restart"],
)
@dataclass(frozen=True)
class TubeMpc:
    """Tube-MPC along a reference.

    Attributes:
        qps: condensed QPs, one for each distinct stretch of the reference ahead.
        index: which of them each period uses.
        wheel_map: how virtual inputs become wheel speeds.
        restart: start each prediction at the measured error, not at the nominal one.
    """

    qps: planning.CondensedQp
    index: Int[Array, " steps"]
    wheel_map: WheelMap | DirectInputs
    restart: bool = True

    @property
    def free_gains(self) -> Float[Array, "steps 2 3"] | None:
        """The gains of the first input where no constraint is active, None without restart."""
        return self.qps.free_inputs[self.index][:, : self.qps.inputs] if self.restart else None

    @property
    def planner(self) -> TubeMpc | None:
        """Itself, where its plans start at the measured error."""
        return self if self.restart else None

    def without_rounds(self) -> TubeMpc:
        """Return the controller for programs without the rounds of iterations that the solver ends
        with: a QP that needs them stays UNSOLVED."""
        factors = self.qps.factors._replace(iterated=None)
        return dataclasses.replace(self, qps=self.qps._replace(factors=factors))

    def condensed_qp(self, step) -> planning.CondensedQp:
        """Return the condensed QP of a period."""
        return planning.take_qp(self.qps, self.index[step])

    def initial(self, errors: Float[Array, "batch 3"]) -> mpc.MpcState:
        """Return the memory before the first period: no plan."""
        inputs = self.qps.inputs
        return mpc.initial_state(errors, self.qps.linear.shape[1] // inputs, inputs)

    def act(
        self,
        step,
        memory: mpc.MpcState,
        measurement: Measurement,
        reference_wheels: Float[Array, "2"],
    ) -> tuple[Command, mpc.MpcState, mpc.Diagnostics]:
        """Plan, and return the command of the plan's first period (see `mpc.act`)."""
        for_plan, for_wheels = use_twice(measurement)
        action: mpc.Action = mpc.act(
            self.qps, self.index[step], memory, for_plan.errors, self.restart
        )
        return self._command(action, for_wheels, reference_wheels)

    def act_freely(
        self,
        step,
        memory: mpc.MpcState,
        measurement: Measurement,
        reference_wheels: Float[Array, "2"],
    ) -> tuple[Bool[Array, ""], tuple[Command, mpc.MpcState, mpc.Diagnostics]]:
        """Return whether `act` meets no active row in any instance, and what it then returns: a
        short program without a solver."""
        errors = measurement.errors
        start = errors if self.restart else memory.nominal
        condensed = self.condensed_qp(step)
        fits = planning.are_all_free(condensed, start)
        action = mpc.act_freely(condensed, memory, errors, self.restart)
        return fits, self._command(action, measurement, reference_wheels)

    def act_as_known(
        self,
        step,
        memory: mpc.MpcState,
        measurement: Measurement,
        reference_wheels: Float[Array, "2"],
    ) -> tuple[Bool[Array, ""], tuple[Command, mpc.MpcState, mpc.Diagnostics]]:
        """Return whether `act` finds every plan without a solver, in the regions that the QPs have,
        and what it then returns."""
        condensed = self.condensed_qp(step)
        action = mpc.act_as_known(condensed, memory, measurement.errors, self.restart)
        command, following, diagnostics = self._command(action, measurement, reference_wheels)
        fits = jnp.all(diagnostics.status != qp.UNSOLVED)
        return fits, (command, following, diagnostics)

    def _command(
        self, action: mpc.Action, measurement: Measurement, reference_wheels: Float[Array, "2"]
    ) -> tuple[Command, mpc.MpcState, mpc.Diagnostics]:
        """Return what a step asks of the wheels, and the rest of it."""
        inputs, following, diagnostics = action
        command = self.wheel_map.command(inputs, measurement, reference_wheels)
        return command, following, diagnostics


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TrackingLaw:
    """The paper's linear tracking law, with or without slip compensation by its wheel map."""

    wheel_map: WheelMap

    solves_qp = False

    def initial(self, errors: Float[Array, "batch 3"]) -> tuple[()]:
        """Return no memory."""
        return ()

    def act(
        self, step, memory: tuple[()], measurement: Measurement, reference_wheels: Float[Array, "2"]
    ) -> tuple[Command, tuple[()], mpc.Diagnostics]:
        """Return the command of the law."""
        errors = measurement.errors
        inputs = tracking_input(errors, reference_wheels, self.wheel_map.track_width)
        command = self.wheel_map.command(inputs, measurement, reference_wheels)
        return command, memory, mpc.no_diagnostics(errors)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ScheduledGain:
    """The static law u = K(th_k) e: a tube's local gain without prediction."""

    gains: Float[Array, "steps 2 3"]
    wheel_map: WheelMap | DirectInputs

    solves_qp = False

    @property
    def free_gains(self) -> Float[Array, "steps 2 3"]:
        """The gains themselves."""
        return self.gains

    def initial(self, errors: Float[Array, "batch 3"]) -> tuple[()]:
        """Return no memory."""
        return ()

    def act(
        self, step, memory: tuple[()], measurement: Measurement, reference_wheels: Float[Array, "2"]
    ) -> tuple[Command, tuple[()], mpc.Diagnostics]:
        """Return the command of the law."""
        errors = measurement.errors
        inputs = matmul(errors, self.gains[step].T)
        command = self.wheel_map.command(inputs, measurement, reference_wheels)
        return command, memory, mpc.no_diagnostics(errors)


def free_gains_of(controller: Controller) -> Float[Array, "steps 2 3"] | None:
    """Return the linear feedback that a controller is while no constraint is active, in every
    period; None where it does not say, in a member `free_gains`."""
    return getattr(controller, "free_gains", None)


def planner_of(controller: Controller) -> TubeMpc | None:
    """Return the tube-MPC whose plans can be followed to their end, None where a controller makes
    none that start at the measured error."""
    return getattr(controller, "planner", None)


def solves_qp(controller: Controller) -> bool:
    """Return whether a controller solves QPs, of which its diagnostics tell; one that solves none
    says so in a member `solves_qp`."""
    return getattr(controller, "solves_qp", True)


def without_rounds(controller: Controller) -> Controller:
    """Return a controller for programs that leave the solver's last stage out, which takes long to
    compile and hardly ever runs; itself where it does not say how, in a method `without_rounds`."""
    leave_out = getattr(controller, "without_rounds", None)
    return controller if leave_out is None else leave_out()


def input_map_of(controller: Controller) -> str | None:
    """Return the input map in whose sense a controller's u is meant, None where it has no wheel
    map."""
    wheel_map = getattr(controller, "wheel_map", None)
    return None if wheel_map is None else wheel_map.input_map
