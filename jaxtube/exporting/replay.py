"""Recorded steps played by an exported controller, in NumPy, and in C where there is a compiler."""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np

SAME = 1e-9
"""By how much wheel speeds may differ, m/s."""
COMPILE = ("-std=c99", "-O2")
SOURCES = ("main.c", "controller.c", "constants.c")


class Replay(NamedTuple):
    """How recorded steps came out."""

    steps: int
    worst: float  # difference of a wheel speed, m/s
    wrong: int  # steps of another status, or that differ by more than `SAME`
    median_us: float  # of a step
    most_us: float  # of 99.9 % of the steps


def load_controller(folder: str | Path) -> ModuleType:
    """Return the module controller.py of an exported controller."""
    path = Path(folder) / "controller.py"
    spec = importlib.util.spec_from_file_location("exported_controller", path)
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    writes = sys.dont_write_bytecode
    sys.dont_write_bytecode = True  # which would be files that SHA256SUMS does not list
    try:
        spec.loader.exec_module(module)
    finally:
        sys.dont_write_bytecode = writes
    return module


def replay_in_numpy(folder: str | Path) -> Replay:
    """Play the steps of c/steps.csv by controller.py."""
    folder = Path(folder)
    controller = load_controller(folder).Controller(folder / "controller.npz")
    controller.restart(runs=True)
    differences = []
    wrong = 0
    durations = []
    for line in (folder / "c" / "steps.csv").read_text(encoding="utf-8").splitlines():
        if not line:
            controller.restart(runs=True)
            continue
        _, *pose, stamp, now, _, right, left, right_wheel, left_wheel, status = line.split(",")
        begun = time.perf_counter()
        output = controller.step(
            [float(number) for number in pose],
            float(stamp),
            float(now),
            [float(right), float(left)],
        )
        durations.append(1e6 * (time.perf_counter() - begun))
        wheels = np.array([float(right_wheel), float(left_wheel)])
        differences.append(float(np.max(np.abs(output.wheels - wheels))))
        wrong += output.status != int(status) or not differences[-1] <= SAME
    return Replay(
        len(differences),
        max(differences),
        wrong,
        float(np.median(durations)),
        float(np.quantile(durations, 0.999)),
    )


def find_compiler() -> str | None:
    """Return a C compiler, None where none is found."""
    return next((found for name in ("cc", "gcc", "clang") if (found := shutil.which(name))), None)


class ReplayInC(NamedTuple):
    """How recorded steps came out in C: whether all are as recorded, and what was printed."""

    is_compiled: bool
    is_same: bool
    printed: str


def replay_in_c(folder: str | Path, compiler: str) -> ReplayInC:
    """Compile main.c in a folder of its own, and play c/steps.csv."""
    source = Path(folder).resolve() / "c"
    with tempfile.TemporaryDirectory() as made:
        program = Path(made) / "replay"
        names = [str(source / name) for name in SOURCES]
        compiled = _run([compiler, *COMPILE, "-o", str(program), *names, "-lm"])
        if compiled.returncode != 0 or not program.exists():
            return ReplayInC(False, False, compiled.stderr.strip())
        played = _run([str(program), str(source / "steps.csv"), str(SAME)])
        return ReplayInC(True, played.returncode == 0, played.stdout + played.stderr)


def _run(command: list[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, check=False)
