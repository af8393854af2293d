"""`bench`: laps a second of the tube-MPC, checks included, by devices and by workers of a cluster,
side by side.

And what the gradient of a tuning objective costs, in the time of its value.
"""

from __future__ import annotations

import resource
import time

import jax
import jax.numpy as jnp

from jaxtube.experiments.montecarlo import command as montecarlo
from jaxtube.experiments.options import Bench
from jaxtube.experiments.run import folder as run_folder
from jaxtube.experiments.run.cluster import Cluster
from jaxtube.plant.reference import settled_step
from jaxtube.scenario import Scenario
from jaxtube.simulation import closed_loop
from jaxtube.simulation.rollout import realisation_keys
from jaxtube.statistics import task as validation
from jaxtube.statistics.run import BLOCK, Run
from jaxtube.synthesis.design import Design, design
from jaxtube.synthesis.feasible import boundary, spread_starts
from jaxtube.tuning.objective import Conditions, make_aim, objective
from jaxtube.tuning.parameters import make_parameters
from jaxtube.tuning.tuner import freeze


def run(scenario: Scenario, options: Bench) -> int:
    """Run the command."""
    montecarlo.use_devices(0)
    found, folder = design(scenario), run_folder.create(scenario, options)
    task, devices = (
        validation.make_task(found, "tube_mpc", "robot", "scenario", options.seed),
        jax.local_devices(),
    )
    # First, for the peak of its memory is that of the process.
    numbers: dict = {"gradient": gradient_cost(found)} if len(found.problem.given_gains) else {}
    laps = 10**12
    speeds = {}
    for count in sorted({1, len(devices)}):
        speeds["devices", count] = laps_per_second(
            Run(task, laps, 1, tuple(devices[:count])), options.blocks
        )
    for count in (1, 2):
        with Cluster(f"local:{count}", Run(task, laps, 1, tuple(devices[:1]))) as cluster:
            speeds["workers", count] = laps_per_second(cluster, options.blocks)
    print(f"{'':<12}{'laps a second':>16}{'against one':>14}")
    for (kind, count), speed in speeds.items():
        print(f"{kind}: {count:<3}{speed:>16,.0f}{speed / speeds[kind, 1]:>13.2f}x")
    numbers["laps_per_second"] = {
        f"{kind}_{count}": speed for (kind, count), speed in speeds.items()
    }
    folder.save_metrics(numbers)
    return 0


ROUNDS = 3


def laps_per_second(source, blocks: int) -> float:
    """Time blocks on a run or a cluster after as many that compile; the fastest round is the least
    disturbed."""
    first, seconds = 2 * source.at_once, []
    for _ in source.compute(range(first)):
        pass
    for begin in range(first, first + ROUNDS * blocks, blocks):
        start = time.perf_counter()
        for _ in source.compute(range(begin, begin + blocks)):
            pass
        seconds.append(time.perf_counter() - start)
    return blocks * BLOCK / min(seconds)


LAPS = 1024


def gradient_cost(found: Design) -> dict[str, dict[str, float]]:
    """Time the tuning objective of whole laps against its value and gradient; print and return
    times and memory.

    From the scenario's start, where hardly a row is active, and from the edge of the feasible set.
    """
    problem = found.problem
    parameters = make_parameters(problem)
    frozen = freeze(found)
    assert frozen is not None, "the tube of a design is bounded"
    plant = closed_loop.slipping_robot(found)
    aim = make_aim(problem.scenario, settled_step(problem.reference))

    def value(vector, starts):
        conditions = Conditions(plant, realisation_keys(0, 0, LAPS), starts)
        return objective(parameters.weights(vector), frozen, conditions, aim)

    points = boundary(found.tube_window, int(found.windows.index[0]), problem.operating_set, 100)
    vector = jnp.asarray(parameters.vector)
    numbers = {}
    starts = {
        "scenario": jnp.tile(jnp.asarray(problem.initial_error), (LAPS, 1)),
        "edge": jnp.asarray(spread_starts(points, LAPS, 0, edge_share=1.0)),
    }
    programs = [
        jax.jit(of).lower(vector, starts["edge"]).compile()
        for of in (value, jax.value_and_grad(value))
    ]
    analysis = programs[1].memory_analysis()
    assert analysis is not None
    memory = analysis.temp_size_in_bytes / 2**20
    print(f"{'starts':<12}{'value, s':>16}{'with gradient, s':>18}{'ratio':>8}{'memory, MiB':>14}")
    for name, each in starts.items():
        alone, both = (_least_seconds(program, vector, each) for program in programs)
        print(f"{name:<12}{alone:>16.3f}{both:>18.3f}{both / alone:>8.2f}{memory:>14.0f}")
        numbers[name] = {"value_s": alone, "with_gradient_s": both, "memory_mib": memory}
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10
    print(
        "memory: of the gradient's program beside its arguments; "
        f"of the whole process {peak:.0f} MiB at most"
    )
    return numbers


def _least_seconds(program, *arguments) -> float:
    seconds = []
    for _ in range(ROUNDS + 1):
        start = time.perf_counter()
        jax.block_until_ready(program(*arguments))
        seconds.append(time.perf_counter() - start)
    return min(seconds)
