"""Memory that simulated laps take, and what this machine has of it."""

from __future__ import annotations

import math
import os
from pathlib import Path

CGROUP = Path("/sys/fs/cgroup/memory.max")
"""The limit of a container on Linux, bytes, or the word "max"."""

BYTES_A_PERIOD = 114
"""That a lap keeps: 12 numbers of 8 bytes (true and measured errors, inputs, wheel speeds run and
demanded), and 18 bytes of diagnostics."""

COPIES = 2
"""Of all laps while blocks of them are joined."""

GIGABYTE = 1e9


def refuse_laps_beyond_memory(laps: int, periods: int) -> None:
    """Raise ValueError, one line, for laps that this machine has no memory to keep.

    Args:
        laps: asked for.
        periods: of a lap.
    """
    bytes_a_lap = COPIES * BYTES_A_PERIOD * (periods + 1)
    memory = find_memory()
    needed = laps * bytes_a_lap
    if needed <= memory:
        return
    raise ValueError(
        f"laps = {laps}: the laps kept need about {needed / GIGABYTE:,.0f} GB of the "
        f"{memory / GIGABYTE:,.0f} GB here; take at most {int(memory / bytes_a_lap):,}, or "
        "jt.montecarlo, which keeps counts alone"
    )


def find_memory() -> float:
    """Return the memory of this machine or of its container, bytes; infinite where the system does
    not say."""
    try:
        installed = float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, OSError, ValueError):
        return math.inf
    try:
        return min(installed, float(CGROUP.read_text()))
    except (OSError, ValueError):
        return installed
