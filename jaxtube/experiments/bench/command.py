"""`bench`: how fast laps are, on the devices and workers of a machine, or on one GPU."""

from __future__ import annotations

from jaxtube.experiments.bench import devices, gpu
from jaxtube.experiments.options import BenchOptions
from jaxtube.scenario.tree import Scenario

TOPICS = {"devices": devices.run, "gpu": gpu.run}


def run(scenario: Scenario, options: BenchOptions) -> int:
    """Run the command."""
    return TOPICS[options.topic](scenario, options)
