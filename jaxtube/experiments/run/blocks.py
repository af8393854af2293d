"""Blocks of laps: the devices that compute them, and what determines their statistics."""

from __future__ import annotations

import contextlib
import os

import jax

from jaxtube.experiments.options import MontecarloOptions
from jaxtube.experiments.run import folder as run_folder
from jaxtube.scenario.refusal import refusal
from jaxtube.scenario.tree import Scenario
from jaxtube.statistics.run import TILE


def use_devices(count: int) -> None:
    """Let every processor of this machine be a device of its own, unless JAX has already settled
    that.

    Args:
        count: devices wanted, 0 for all.

    Raises:
        ScenarioError: where there are fewer.
    """
    processors = len(os.sched_getaffinity(0))
    # JAX refuses once its devices are settled.
    with contextlib.suppress(RuntimeError):
        jax.config.update("jax_num_cpu_devices", min(count or processors, processors))
    present = jax.local_device_count()
    if count > present:
        problem = f"this machine has {present}"
        cure = f"give 1 to {present}, or 0 for all"
        raise refusal("command line", "--devices", count, problem, cure)


def identity(scenario: Scenario, options: MontecarloOptions) -> dict:
    """Return all that determines the statistics of a block."""
    known = run_folder.identity(scenario, options, ("controller", "plant", "starts"))
    return known | {"tile_size": TILE}
