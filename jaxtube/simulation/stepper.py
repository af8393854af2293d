"""One robot: a controller of a design, period by period, in tens of microseconds.

`simulate` runs thousands of loops with their plant; a robot has a plant of its own, and asks for
one command a period. All that does not change from one period to the next is compiled in: the
controller, the reference and the shapes of a batch of one. Nothing is traced after that.

A tube-MPC has up to three programs. The first knows plans without active rows alone, the second the
critical regions that come with the design as well, and both say whether the plan is one of these;
where it is not, the last one, with the solver, makes it. A single program would pay in every period
for the buffers of a solver that it does not run.

Source: new.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from jaxtube import qp
from jaxtube.arguments import find_whole
from jaxtube.control.laws import TubeMpc
from jaxtube.control.mpc import Diagnostics
from jaxtube.control.protocol import Controller
from jaxtube.plant.protocol import Command, Measurement, Memory
from jaxtube.plant.robot import Robot, saturate
from jaxtube.plant.slip_bounds import slip_bounds
from jaxtube.plant.slip_observer import SlipKnowledge, SlipObserver
from jaxtube.precision import in_64_bits
from jaxtube.simulation.choices import ControllerChoice, choose_controller
from jaxtube.synthesis.learnt_slips import make_slip_observer
from jaxtube.synthesis.parts import Design, require_design

Acted = tuple[Command, Memory, Diagnostics]


class LearnerMemory(NamedTuple):
    """Memory of a controller and of the observer of the slips that it compensates.

    Attributes:
        controller: its memory.
        knowledge: of the slips of the period before, None where none are learnt.
        wheels: speeds (right, left) of the period before, within the limits, m/s.
    """

    controller: Memory
    knowledge: SlipKnowledge | None
    wheels: Float[Array, "1 2"]


class LearntSlip(NamedTuple):
    """What is known of the slips (right, left) of a period: the ends of the intervals that hold
    them, and whether the measurements before it contradicted what is assumed of them, so that
    nothing is known any more."""

    lower: Float[np.ndarray, "2"]
    upper: Float[np.ndarray, "2"]
    contradicted: bool


class Step(NamedTuple):
    """What one period is to do, and how it was found.

    Attributes:
        wheels: speeds asked of the wheels (right, left), m/s, not saturated.
        inputs: the virtual inputs that they realise (u1 m/s, u2 rad/s).
        status: of the QP: `qp.SOLVED`, `qp.INFEASIBLE` or `qp.UNSOLVED`.
        residual: of its optimality conditions.
        active: whether some row of it is active.
        backup: whether it gave no plan, so that the input is that of the backup.
    """

    wheels: Float[np.ndarray, "2"]
    inputs: Float[np.ndarray, "2"]
    status: int
    residual: float
    active: bool
    backup: bool

    @property
    def is_solved(self) -> bool:
        """Whether there is a plan."""
        return self.status == qp.SOLVED


class Stepper:
    """The controller of one robot along the reference of a design, asked once a period.

        stepper = jt.Stepper(design)
        step = stepper(errors)

    Errors are those that the controller acts on: (longitudinal m, lateral m, heading rad) in the
    frame of the robot, positive where the reference is ahead and to the left; measured, or
    estimated where the scenario's controller acts on an estimate. Commands are those of a batch of
    one in `jt.simulate`. Slips that the scenario has learnt (`slip.change_per_s`) are learnt from
    the errors of call after call.

    Attributes:
        periods: how many the reference has.
        next: the one that the next call is for, from 0.
    """

    @in_64_bits
    def __init__(self, design: Design, controller: ControllerChoice = "tube_mpc"):
        """Compile the controller for one robot.

        Args:
            design: a design.
            controller: as for `jt.simulate`.

        Raises:
            ValueError: for an unknown name, or a controller of other shapes.
        """
        require_design(design)
        problem = design.problem
        self.periods = problem.reference.steps
        self._slip = np.asarray(slip_bounds(problem.scenario.slip).nominal, float)
        learns = problem.scenario.slip.is_learnt
        programs = _Programs(
            choose_controller(design, controller),
            problem.schedule[: self.periods],
            make_slip_observer(problem) if learns else None,
            problem.robot,
        )
        self._begin = programs.compile_begin()
        self._nothing = self._begin(np.zeros(3))
        self._short = programs.compile_short(self._nothing)
        self._act = programs.compile_act(self._nothing)
        self.restart()

    def restart(self, period: int = 0) -> None:
        """Forget everything; the next call is for a period of the reference, the first one unless
        told.

        Raises:
            ValueError: where the reference has no such period.
        """
        first = find_whole(period)
        if first is None or not 0 <= first < self.periods:
            raise ValueError(f"period = {period}: the reference has 0 to {self.periods - 1}")
        self.next = first
        self._memory = None

    @in_64_bits
    def __call__(
        self, errors: Float[np.ndarray, "3"], slip: Float[np.ndarray, "2"] | None = None
    ) -> Step:
        """Return what the next period is to do.

        Args:
            errors: at its start (see the class).
            slip: what is measured of the slips (right, left); the nominal ones unless given, or
                what is learnt, where the scenario has them learnt.

        Raises:
            ValueError: beyond the end of the reference, for other shapes, or for slips that are
                learnt.
        """
        if self.next >= self.periods:
            raise ValueError(
                f"the reference ended after {self.periods} periods; call restart() for another lap"
            )
        if slip is not None and self.learnt_slip is not None:
            raise ValueError(f"slip = {slip}: is learnt here (slip.change_per_s); leave it out")
        errors = np.asarray(errors, float)
        slip = self._slip if slip is None else np.asarray(slip, float)
        if errors.shape != (3,) or slip.shape != (2,):
            raise ValueError(
                f"errors, slip: shapes {errors.shape} and {slip.shape}; give (3,) and (2,)"
            )
        memory = self._begin(errors) if self._memory is None else self._memory
        report, self._memory = self._run(np.int32(self.next), memory, errors, slip)
        self.next += 1
        return _read(np.array(report))

    @property
    def learnt_slip(self) -> LearntSlip | None:
        """What was known of the slips of the period that the last call was for; before the first
        one what the scenario says, and None where slips are not learnt."""
        memory = self._nothing if self._memory is None else self._memory
        known = memory.knowledge
        if known is None:
            return None
        lower = np.array(known.lower)[0]
        return LearntSlip(lower, np.array(known.upper)[0], bool(known.contradicted[0]))

    def _run(self, period, memory: Memory, errors, slip) -> tuple[Float[Array, " 9"], Memory]:
        """Run the short programs, and the long one where they do not do."""
        for program in self._short:
            report, following = program(period, memory, errors, slip)
            if np.asarray(report)[-1]:
                return report, following
        return self._act(period, memory, errors, slip)


class _Programs:
    """A controller's programs for one robot."""

    def __init__(
        self,
        controller: Controller,
        reference_wheels: Float[np.ndarray, "steps 2"],
        observer: SlipObserver | None,
        robot: Robot,
    ):
        self._controller = controller
        self._wheels = jnp.asarray(reference_wheels)
        self._observer = observer
        self._robot = robot

    def compile_begin(self) -> Callable[..., LearnerMemory]:
        """Compile what returns the memory before the first period, by its errors."""

        def begin(errors):
            memory = self._controller.initial(errors[None])
            observer = self._observer
            knowledge = None if observer is None else observer.initial(errors[None])
            return LearnerMemory(memory, knowledge, jnp.zeros((1, 2)))

        return _compile(begin, np.zeros(3))

    def compile_act(self, memory: LearnerMemory) -> Callable[..., Any]:
        """Compile what acts, (report, next memory) by period, memory, errors and slip."""

        def always(*arguments):
            return jnp.asarray(True), self._controller.act(*arguments)

        return _compile(self._describe(always), *_example(memory))

    def compile_short(self, memory: LearnerMemory) -> list[Callable[..., Any]]:
        """Compile the same without the solver of a tube-MPC, the shortest program first; none for
        other controllers."""
        controller = self._controller
        if not isinstance(controller, TubeMpc):
            return []
        ways = [controller.act_freely]
        if controller.qps.regions is not None:
            ways.append(controller.act_as_known)
        return [_compile(self._describe(way), *_example(memory)) for way in ways]

    def _describe(self, way: Callable) -> Callable:
        """Return what acts one way, and reports whether that is what `act` does."""

        def act(period, memory, errors, slip):
            measurement = Measurement(errors[None], slip[None])
            knowledge = self._learn(period, memory, measurement.errors)
            if knowledge is not None:
                measurement = measurement._replace(slip=knowledge.centre)
            fits, acted = way(period, memory.controller, measurement, self._wheels[period])
            command, following, diagnostics = acted
            wheels = saturate(command.wheels, self._robot)
            acted = (command, LearnerMemory(following, knowledge, wheels), diagnostics)
            return _report(acted, fits)

        return act

    def _learn(
        self, period, memory: LearnerMemory, errors: Float[Array, "1 3"]
    ) -> SlipKnowledge | None:
        """Return what is known of the slips of a period, None where none are learnt."""
        if self._observer is None or memory.knowledge is None:
            return None
        # The first period has none before it, and nothing is learnt from it then.
        before = self._wheels[jnp.maximum(period - 1, 0)]
        return self._observer.update(memory.knowledge, errors, memory.wheels, before)


def _example(memory: Memory) -> tuple:
    """Return arguments of the shapes of a period."""
    return np.int32(0), memory, np.zeros(3), np.zeros(2)


def _compile(function: Callable, *arguments) -> Callable:
    """Compile a function for arguments of these shapes alone: it is never traced again."""
    return jax.jit(function).lower(*arguments).compile()


def _report(acted: Acted, fits) -> tuple[Float[Array, " 9"], Memory]:
    """Return all that the host reads in one array, and the memory, which stays on the device."""
    command, memory, diagnostics = acted
    status, residual, active, backup = diagnostics
    numbers = [command.wheels[0], command.inputs[0], residual, status, active, backup]
    numbers.append(jnp.expand_dims(fits, 0))
    return jnp.concatenate([number.astype(float) for number in numbers]), memory


def _read(report: Float[np.ndarray, " 9"]) -> Step:
    """Return what a report says."""
    residual, status, active, backup, _ = report[4:].tolist()
    return Step(report[:2], report[2:4], int(status), residual, bool(active), bool(backup))
