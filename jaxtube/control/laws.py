"""The controllers a rollout can run, behind one interface.

    initial(errors) -> memory
    act(step, memory, errors, reference_wheels) -> (virtual inputs, next memory, diagnostics)

`errors` are the measured ones, (batch, 3); virtual inputs (speed deficit m/s, yaw rate deficit
rad/s), in the sense of the controller's `input_map`, become wheels by eqs. (7)-(8) with the
measured slip where it `compensates`, else with none. All are pytrees whose arrays run along the
reference.

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, sections III and IV.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import jax
from jax import Array
from jaxtyping import Float, Int

from jaxtube.control import mpc
from jaxtube.control.tracking import tracking_input


@partial(
    jax.tree_util.register_dataclass,
    meta_fields=["restart", "input_map"],
    data_fields=["windows", "index"],
)
@dataclass(frozen=True)
class TubeMpc:
    """The controller: windows along the reference, which one each step uses, and its two choices."""

    windows: mpc.Window
    index: Int[Array, " steps"]
    restart: bool = True
    input_map: str = "paper"
    compensates = True

    def initial(self, errors: Float[Array, "batch 3"]) -> mpc.MpcState:
        """Return the memory before the first step."""
        return mpc.initial_state(errors, self.windows.linear.shape[1] // 2)

    def act(
        self,
        step,
        state: mpc.MpcState,
        errors: Float[Array, "batch 3"],
        reference_wheels: Float[Array, "2"],
    ):
        """Return (inputs, next memory, diagnostics) of one step; see `mpc.act`."""
        return mpc.act(mpc.take_window(self.windows, self.index[step]), state, errors, self.restart)


@partial(jax.tree_util.register_dataclass, data_fields=["track_width"], meta_fields=["compensates"])
@dataclass(frozen=True)
class TrackingLaw:
    """The linear tracking law as a controller, with or without slip compensation."""

    track_width: float
    compensates: bool
    input_map = "paper"

    def initial(self, errors: Float[Array, "batch 3"]) -> tuple[()]:
        """Return no memory."""
        return ()

    def act(
        self, step, state, errors: Float[Array, "batch 3"], reference_wheels: Float[Array, "2"]
    ):
        """Return (inputs, no memory, diagnostics without QP) of one step."""
        return (
            tracking_input(errors, reference_wheels, self.track_width),
            state,
            mpc.no_diagnostics(errors),
        )


@partial(jax.tree_util.register_dataclass, data_fields=["gains"], meta_fields=["input_map"])
@dataclass(frozen=True)
class ScheduledGain:
    """The static law u = K(th_k) e with slip compensation: a tube's local gain without prediction."""

    gains: Float[Array, "steps 2 3"]
    input_map: str = "paper"
    compensates = True

    def initial(self, errors: Float[Array, "batch 3"]) -> tuple[()]:
        """Return no memory."""
        return ()

    def act(
        self, step, state, errors: Float[Array, "batch 3"], reference_wheels: Float[Array, "2"]
    ):
        """Return (inputs, no memory, diagnostics without QP) of one step."""
        return errors @ self.gains[step].T, state, mpc.no_diagnostics(errors)
