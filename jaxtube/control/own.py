"""A user's own controller in a closed loop: a function, or an object with `initial` and `act`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from jaxtube.arguments import describe_type
from jaxtube.control.laws import solves_qp
from jaxtube.control.mpc import Diagnostics
from jaxtube.control.protocol import Controller, DirectInputs, Feedback, Law, WheelMap
from jaxtube.plant.protocol import Command, Measurement, Memory

BATCH = 7
"""Realisations of the trial: a number that no other axis has."""


class Sizes(NamedTuple):
    """How many numbers a controller meets, and what those that it is scheduled on are called."""

    errors: int = 3
    inputs: int = 2
    schedule: int = 2
    scheduled_on: str = "wheel speeds"

    def say_law(self) -> str:
        """Return what a law must be, in words."""
        argument = self.scheduled_on.split()[0]
        if self.scheduled_on == "wheel speeds":
            argument = "reference_wheels"
        return (
            f"u = f(errors, {argument}), from errors (batch, {self.errors}) and "
            f"{self.scheduled_on} ({self.schedule},) to inputs (batch, {self.inputs}), in "
            "jax.numpy; no `if` on values, use jnp.where"
        )


ROBOT = Sizes()
"""Those of the robot."""


@partial(jax.tree_util.register_dataclass, data_fields=[], meta_fields=["controller"])
@dataclass(frozen=True)
class Unregistered:
    """A controller that is no pytree: to JAX it is a constant, and its arrays are compiled in."""

    controller: Controller

    @property
    def solves_qp(self) -> bool:
        """What the controller says."""
        return solves_qp(self.controller)

    def initial(self, errors: Float[Array, "batch 3"]) -> Memory:
        """Return the memory before the first period."""
        return self.controller.initial(errors)

    def act(
        self, step, memory: Memory, measurement: Measurement, reference_wheels: Float[Array, "2"]
    ) -> tuple[Command, Memory, Diagnostics]:
        """Return what the controller returns."""
        return self.controller.act(step, memory, measurement, reference_wheels)


def adapt_controller(
    controller: Controller | Law, wheel_map: WheelMap | DirectInputs, sizes: Sizes = ROBOT
) -> Controller:
    """Return what a closed loop can run of a user's own controller.

    Args:
        controller: a `Controller`, pytree or not, or a law u = f(errors, reference_wheels) on
            measured errors (batch, 3) in (m, m, rad) and wheel speeds (2,) in m/s that returns
            virtual inputs (batch, 2) in (m/s, rad/s), in the sense of the map's input map: the
            deficits of speed and yaw rate for "paper" alone. Of another system x (batch, n), th
            (v,) and u (batch, m).
        wheel_map: how the virtual inputs of a law become wheel speeds.
        sizes: of what it meets.

    Raises:
        ValueError: one line, for anything else, or where what it returns has other shapes.
    """
    if not hasattr(controller, "act"):
        if not callable(controller):
            raise ValueError(
                f"controller = {controller!r}: is neither a law nor an object with `initial` and "
                f"`act`; a law is {sizes.say_law()}"
            )
        law = cast(Law, controller)
        _check_law(law, sizes)
        return Feedback(law, wheel_map)
    adapted = cast(Controller, controller)
    if jax.tree_util.all_leaves([controller]):
        adapted = Unregistered(adapted)
    _check_controller(adapted, sizes)
    return adapted


def _check_law(law: Law, sizes: Sizes) -> None:
    """Trace a law, and refuse inputs of another shape."""
    contract = f"a law is {sizes.say_law()}"
    inputs = _trace(law, _floats(BATCH, sizes.errors), _floats(sizes.schedule), contract=contract)
    if getattr(inputs, "shape", None) != (BATCH, sizes.inputs):
        raise ValueError(f"controller: returns {_describe(inputs)}; {contract}")


def _check_controller(controller: Controller, sizes: Sizes) -> None:
    """Trace one period of a controller, and refuse commands of another shape, and a memory that
    changes its structure."""

    def act(errors: Array, slip: Array, reference_wheels: Array) -> tuple:
        memory = controller.initial(errors)
        measurement = Measurement(errors, slip)
        return controller.act(jnp.asarray(0), memory, measurement, reference_wheels)

    errors = _floats(BATCH, sizes.errors)
    contract = "jaxtube.control.protocol says what `initial` and `act` must do, in jax.numpy"
    before = _trace(controller.initial, errors, contract=contract)
    slip = _floats(BATCH, 2)
    answer = _trace(act, errors, slip, _floats(sizes.schedule), contract=contract)
    memory = _check_answer(answer, sizes)
    if jax.tree.map(_get_kind, before) != jax.tree.map(_get_kind, memory):
        raise ValueError(
            "controller: `act` returns a memory of another structure, shape or dtype than "
            "`initial`; return the same"
        )


def _check_answer(answer: Any, sizes: Sizes) -> Memory:
    """Return the memory that `act` returned, and refuse anything but what it must return."""
    match answer:
        case (Command() as command, memory, Diagnostics()):
            pass
        case _:
            raise ValueError(
                f"controller: `act` returns {_describe(answer)}; return (jaxtube.Command(inputs, "
                "wheels), memory, jaxtube.control.mpc.no_diagnostics(errors))"
            )
    for name, values in command._asdict().items():
        if getattr(values, "shape", None) != (BATCH, sizes.inputs):
            units = ", inputs in (m/s, rad/s) and wheels in m/s" if sizes == ROBOT else ""
            raise ValueError(
                f"controller: returns {name} of {_describe(values)} for errors (batch, "
                f"{sizes.errors}); return (batch, {sizes.inputs}){units}"
            )
    return memory


def _trace(function: Callable[..., Any], *shapes: jax.ShapeDtypeStruct, contract: str) -> Any:
    """Return the shapes of what a user's function returns.

    Args:
        function: of the user.
        shapes: of its arguments.
        contract: what it has to be, for the message.

    Raises:
        ValueError: one line, from whatever it raises.
    """
    try:
        return jax.eval_shape(function, *shapes)
    except (jax.errors.TracerArrayConversionError, jax.errors.ConcretizationTypeError) as error:
        # Both are TypeErrors whose messages are pages that say nothing of laws.
        problem = "needs the values of its arguments, which a compiled function does not have"
        raise ValueError(f"controller: {problem}; {contract}") from error
    except Exception as error:
        first = f"{type(error).__name__}: {error}".splitlines()[0]
        raise ValueError(f"controller: raises {first}; {contract}") from error


def _floats(*shape: int) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(shape, jnp.zeros(0).dtype)


def _describe(answer: Any) -> str:
    """Return what a function returned, in words."""
    if isinstance(answer, tuple):
        return f"({', '.join(_describe(part) for part in answer)})"
    if not isinstance(answer, jax.ShapeDtypeStruct):
        return "None" if answer is None else describe_type(answer)
    axes = ["batch" if size == BATCH else str(size) for size in answer.shape]
    comma = "," if len(axes) == 1 else ""
    return f"shape ({', '.join(axes)}{comma})"


def _get_kind(array: jax.ShapeDtypeStruct) -> tuple[tuple[int, ...], np.dtype]:
    return array.shape, array.dtype
