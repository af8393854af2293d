"""`bench devices`: laps a second of the tube-MPC, checks included, by devices and by workers of a
cluster, side by side.

And what the gradient of a tuning objective costs, in the time of its value.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from jaxtube.experiments.options import BenchOptions
from jaxtube.experiments.run import folder as run_folder
from jaxtube.experiments.run.blocks import use_devices
from jaxtube.experiments.run.cluster import Cluster, import_distributed
from jaxtube.experiments.run.table import Column, format_table, left
from jaxtube.plant.reference import settled_step
from jaxtube.scenario.tree import Scenario
from jaxtube.simulation import components
from jaxtube.simulation.rollout import realisation_keys
from jaxtube.statistics.montecarlo import make_closed_loop_task
from jaxtube.statistics.run import BLOCK, Run
from jaxtube.synthesis.design import design
from jaxtube.synthesis.feasible import boundary, spread_starts
from jaxtube.synthesis.parts import Design
from jaxtube.tuning.objective import LapInputs, make_aim, objective
from jaxtube.tuning.parameters import make_parameters
from jaxtube.tuning.tuner import make_evaluation_constants

ROUNDS = 3
LAPS = 1024
"""Laps of the tuning objective."""
UNLIMITED = 10**12
"""Laps of a run that is timed: more than it will do."""


def run(scenario: Scenario, options: BenchOptions) -> int:
    """Run the command; what was measured is printed at once."""
    import_distributed("local:1")
    use_devices(0)
    found = design(scenario)
    folder = run_folder.create(scenario, options)
    numbers: dict = {}
    # First, for the peak of its memory is that of the process.
    if found.problem.given_gains:
        numbers["gradient"], text = gradient_cost(found)
        folder.report(text)
    task = make_closed_loop_task(found, "tube_mpc", "robot", "scenario", None, options.seed)
    devices = tuple(jax.local_devices())
    speeds = {}
    for count in sorted({1, len(devices)}):
        source = Run(task, UNLIMITED, 1, devices[:count])
        speeds["devices", count] = laps_per_second(source, options.blocks)
    folder.report(speed_table(speeds, "devices"))
    for count in (1, 2):
        with Cluster(f"local:{count}", Run(task, UNLIMITED, 1, devices[:1])) as cluster:
            speeds["workers", count] = laps_per_second(cluster, options.blocks)
    folder.report(speed_table(speeds, "workers"))
    numbers["laps_per_second"] = {
        f"{kind}_{count}": speed for (kind, count), speed in speeds.items()
    }
    folder.save_metrics(numbers)
    return 0


def speed_table(speeds: dict[tuple[str, int], float], kind: str) -> str:
    """Return the speeds of devices, or of workers, as a table."""
    rows = [
        [f"{kind}: {count}", f"{speed:,.0f}", f"{speed / speeds[kind, 1]:.2f}x"]
        for (other, count), speed in speeds.items()
        if other == kind
    ]
    return format_table([left(""), Column("laps a second"), Column("against one")], rows)


def laps_per_second(source: Run | Cluster, blocks: int) -> float:
    """Time blocks on a run or a cluster after as many that compile; the fastest round is the least
    disturbed."""
    first = 2 * source.at_once
    _compute(source, range(first))
    seconds = []
    for begin in range(first, first + ROUNDS * blocks, blocks):
        start = time.perf_counter()
        _compute(source, range(begin, begin + blocks))
        seconds.append(time.perf_counter() - start)
    return blocks * BLOCK / min(seconds)


def _compute(source: Run | Cluster, blocks: range) -> None:
    for _ in source.compute(blocks):
        pass


def gradient_cost(found: Design) -> tuple[dict[str, dict[str, float]], str]:
    """Time the tuning objective of whole laps against its value and gradient.

    From the scenario's start, where hardly a row is active, and from the edge of the feasible set.

    Returns:
        Times (s) and memory (MiB) by start, and the same as text.
    """
    value = make_objective(found)
    vector = jnp.asarray(make_parameters(found.problem).vector)
    starts = make_starts(found)
    alone = _compile(value, vector, starts["edge"])
    both = _compile(jax.value_and_grad(value), vector, starts["edge"])
    analysis = both.memory_analysis()
    assert analysis is not None
    memory = analysis.temp_size_in_bytes / 2**20
    numbers = {}
    rows = []
    for name, errors in starts.items():
        seconds = _least_seconds(alone, vector, errors)
        with_gradient = _least_seconds(both, vector, errors)
        numbers[name] = {
            "value_s": seconds,
            "with_gradient_s": with_gradient,
            "memory_mib": memory,
        }
        ratio = f"{with_gradient / seconds:.2f}"
        rows.append([name, f"{seconds:.3f}", f"{with_gradient:.3f}", ratio, f"{memory:.0f}"])
    columns = [
        left("starts"),
        Column("value, s"),
        Column("with gradient, s"),
        Column("ratio"),
        Column("memory, MiB"),
    ]
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10
    note = (
        "memory: of the gradient's program beside its arguments; of the whole process "
        f"{peak:.0f} MiB at most"
    )
    return numbers, f"{format_table(columns, rows)}\n{note}"


def make_objective(found: Design) -> Callable:
    """Return the tuning objective of a design as a function of parameters and starts."""
    problem = found.problem
    parameters = make_parameters(problem)
    constants = make_evaluation_constants(found)
    assert constants is not None, "the tube of a design is bounded"
    plant = components.slipping_robot(found)
    aim = make_aim(problem.scenario, settled_step(problem.reference))

    def value(vector, starts):
        lap_inputs = LapInputs(plant, realisation_keys(0, 0, LAPS), starts)
        return objective(parameters.weights(vector), constants, lap_inputs, aim)

    return value


def make_starts(found: Design) -> dict[str, Float[Array, "laps 3"]]:
    """Return the scenario's start for all laps, and starts on the edge of the feasible set."""
    problem = found.problem
    window = int(found.windows.index[0])
    points = boundary(found.tube_qps, window, problem.operating_set, 100)
    return {
        "scenario": jnp.tile(jnp.asarray(problem.initial_error), (LAPS, 1)),
        "edge": jnp.asarray(spread_starts(points, LAPS, 0, edge_share=1.0)),
    }


def _compile(function: Callable, *arguments):
    return jax.jit(function).lower(*arguments).compile()


def _least_seconds(program, *arguments) -> float:
    seconds = []
    for _ in range(ROUNDS + 1):
        start = time.perf_counter()
        jax.block_until_ready(program(*arguments))
        seconds.append(time.perf_counter() - start)
    return min(seconds)
