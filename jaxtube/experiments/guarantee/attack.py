"""The closed loops that put a guarantee to the test: one sampling law for each slip process and
kind of start.

    whole laps       the whole reference, starts uniform in the feasible set
    from the edge    its first second, starts on the edge of that set, where constraints bind

All laws of one kind share one compiled program: the process that draws the slips is data. A lap
meets the draws that the command `montecarlo` gives the lap of its number under that process and
those starts.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import partial
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int, Key

from jaxtube.plant.protocol import Advance, Command, Measurement
from jaxtube.plant.slip_processes import TEST_PROCESSES
from jaxtube.plant.slipping import EXTREME, SlipMemory, SlippingRobot
from jaxtube.scenario.reading import replace
from jaxtube.simulation import components
from jaxtube.statistics.montecarlo import make_closed_loop_task
from jaxtube.statistics.run import Task
from jaxtube.synthesis.parts import Design

PROCESSES = (*TEST_PROCESSES, "patches")
EDGE_PROCESSES = ("vertex", "adversarial")
EDGE_SECONDS = 1.0


class Law(NamedTuple):
    """How laps are drawn: the process of the slips, and whether they start on the edge of the
    feasible set."""

    process: str
    edge: bool = False

    @property
    def name(self) -> str:
        """Its name in tables and folders."""
        return f"edge-{self.process}" if self.edge else self.process

    @property
    def starts(self) -> Literal["feasible", "edge"]:
        """Its starts as the command `montecarlo` names them."""
        return "edge" if self.edge else "feasible"


WHOLE_LAPS = tuple(Law(process) for process in PROCESSES)
FROM_THE_EDGE = tuple(Law(process, edge=True) for process in EDGE_PROCESSES)
LAWS = WHOLE_LAPS + FROM_THE_EDGE


def count_laps(realisations: int, block: int) -> int:
    """Return the laps of each law: an equal share of those asked for over the processes, rounded up
    to whole blocks."""
    return -(-realisations // (len(PROCESSES) * block)) * block


@partial(jax.tree_util.register_dataclass, data_fields=["ideal", "number"], meta_fields=[])
@dataclass(frozen=True)
class AnySlipRobot:
    """The slipping robot whose slip process is data: its number in PROCESSES."""

    ideal: SlippingRobot
    number: Int[Array, ""]

    has_wheels = True

    @property
    def draws_extremes(self) -> Bool[Array, ""]:
        """Whether the process draws deviations of -1 or 1 only."""
        return jnp.asarray([name in EXTREME for name in PROCESSES])[self.number]

    @property
    def reference_wheels(self) -> Float[Array, "steps 2"]:
        """The reference, m/s."""
        return self.ideal.reference_wheels

    def initial(self, keys: Key[Array, " batch"], errors: Float[Array, "batch 3"]) -> SlipMemory:
        """Return the memories of all processes."""
        robots = [dataclasses.replace(self.ideal, process=name) for name in PROCESSES]
        memories = [robot.initial(keys, errors) for robot in robots]
        return memories[0]._replace(process=tuple(memory.process for memory in memories))

    def sense(
        self, keys: Key[Array, " batch"], step, memory: SlipMemory, errors: Float[Array, "batch 3"]
    ) -> tuple[Measurement, SlipMemory]:
        """Draw the pose noise of an instant and the slips of the period that begins there."""
        memory = self.draw_slips(keys, step, memory, errors)
        measured_errors = self.measure_errors(keys, step, errors)
        return Measurement(measured_errors, self.ideal.measured_slip(memory)), memory

    def measure_errors(
        self, keys: Key[Array, " batch"], step, errors: Float[Array, "batch 3"]
    ) -> Float[Array, "batch 3"]:
        """Return the tracking errors with the noise of an instant."""
        return self.ideal.measure_errors(keys, step, errors)

    def draw_slips(
        self, keys: Key[Array, " batch"], step, memory: SlipMemory, errors: Float[Array, "batch 3"]
    ) -> SlipMemory:
        """Draw the deviations of the slips of one period."""
        branches = [partial(self._draw, number, keys, step) for number in range(len(PROCESSES))]
        return jax.lax.switch(self.number, branches, memory, errors)

    def _draw(
        self, number: int, keys, step, memory: SlipMemory, errors: Float[Array, "batch 3"]
    ) -> SlipMemory:
        """Draw the slips of one process; the memories of the others stay as they were."""
        robot = dataclasses.replace(self.ideal, process=PROCESSES[number])
        mine = memory._replace(process=memory.process[number])
        drawn = robot.draw_slips(keys, step, mine, errors)
        before = memory.process[:number]
        after = memory.process[number + 1 :]
        return drawn._replace(process=(*before, drawn.process, *after))

    def true_slip(self, memory: SlipMemory) -> Float[Array, "batch 2"]:
        """Return the true slips of the period that has begun."""
        return self.ideal.true_slip(memory)

    def advance(
        self,
        keys: Key[Array, " batch"],
        step,
        memory: SlipMemory,
        errors: Float[Array, "batch 3"],
        command: Command,
    ) -> Advance:
        """Move through one period under the slips that were drawn for it."""
        return self.ideal.advance(keys, step, memory, errors, command)


def apply_law(design: Design, law: Law) -> Design:
    """Return a design whose scenario has the law's slip process and, for laps from the edge, whose
    reference ends after EDGE_SECONDS."""
    problem = design.problem
    reference = problem.reference
    windows = design.windows
    scenario = replace(problem.scenario, {"slip.process": law.process})
    if law.edge:
        steps = min(round(EDGE_SECONDS / reference.dt), reference.steps)
        reference = dataclasses.replace(reference, steps=steps)
        windows = dataclasses.replace(windows, index=windows.index[:steps])
    problem = dataclasses.replace(problem, scenario=scenario, reference=reference)
    return dataclasses.replace(design, problem=problem, windows=windows)


def make_tasks(design: Design, seed: int) -> tuple[dict[Law, Task], str]:
    """Return what the blocks of every law need.

    Returns:
        The tasks in the order of LAWS; and why starts are not spread over the feasible set, ""
        where they are.
    """
    tasks = {}
    why = ""
    for laws in (WHOLE_LAPS, FROM_THE_EDGE):
        limited = apply_law(design, laws[0])
        task, why = _make_task(limited, laws[0].starts, seed)
        # The name of a process is part of a program: it is one name for all.
        ideal = components.bare_robot(limited.problem, PROCESSES[0])
        for law in laws:
            number = jnp.asarray(PROCESSES.index(law.process), jnp.int32)
            robot = components.with_lag(limited.problem, ideal, AnySlipRobot(ideal, number))
            robot = components.with_estimate(limited.problem, robot)
            tasks[law] = dataclasses.replace(task, plant=robot)
    return tasks, why


def _make_task(design: Design, starts: str, seed: int) -> tuple[Task, str]:
    try:
        return make_closed_loop_task(design, "tube_mpc", "robot", starts, None, seed), ""
    except ValueError as error:
        task = make_closed_loop_task(design, "tube_mpc", "robot", "scenario", None, seed)
        return task, str(error)
