"""`bench`: laps a second of the tube-MPC, checks included, by devices and by workers of a cluster, side by side."""

from __future__ import annotations

import time

import jax

from jaxtube.design import design
from jaxtube.experiments import montecarlo, run_folder, validation
from jaxtube.experiments.cluster import Cluster
from jaxtube.experiments.options import Bench
from jaxtube.montecarlo import BLOCK, Run
from jaxtube.scenario import Scenario


def run(scenario: Scenario, options: Bench) -> int:
    """Run the command."""
    montecarlo.use_devices(0)
    found, folder = design(scenario), run_folder.create(scenario, options)
    task, devices = validation.make_task(found, "tube_mpc", "robot", "scenario", options.seed), jax.local_devices()
    laps = 10**12
    speeds = {}
    for count in sorted({1, len(devices)}):
        speeds["devices", count] = laps_per_second(Run(task, laps, 1, tuple(devices[:count])), options.blocks)
    for count in (1, 2):
        with Cluster(f"local:{count}", Run(task, laps, 1, tuple(devices[:1]))) as cluster:
            speeds["workers", count] = laps_per_second(cluster, options.blocks)
    print(f"{'':<12}{'laps a second':>16}{'against one':>14}")
    for (kind, count), speed in speeds.items():
        print(f"{kind}: {count:<3}{speed:>16,.0f}{speed / speeds[kind, 1]:>13.2f}x")
    folder.save_metrics({"laps_per_second": {f"{kind}_{count}": speed for (kind, count), speed in speeds.items()}})
    return 0


ROUNDS = 3


def laps_per_second(source, blocks: int) -> float:
    """Time blocks on a run or a cluster after as many that compile; the fastest round is the least disturbed."""
    first, seconds = 2 * source.at_once, []
    for _ in source.computed(range(first)):
        pass
    for begin in range(first, first + ROUNDS * blocks, blocks):
        start = time.perf_counter()
        for _ in source.computed(range(begin, begin + blocks)):
            pass
        seconds.append(time.perf_counter() - start)
    return blocks * BLOCK / min(seconds)
