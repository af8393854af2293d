"""The C controller of an exported folder, called from Python."""

import ctypes
import shutil
import subprocess
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="there is no C compiler here")
WARNINGS = ("-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-pedantic", "-Werror")
LARGEST = 1 << 16
"""Bytes of the largest controller."""


class Input(ctypes.Structure):
    _fields_ = [
        ("pose", ctypes.c_double * 3),
        ("stamp_s", ctypes.c_double),
        ("now_s", ctypes.c_double),
        ("slip", ctypes.c_double * 2),
        ("has_pose", ctypes.c_int),
        ("has_times", ctypes.c_int),
        ("has_slip", ctypes.c_int),
    ]


class Output(ctypes.Structure):
    _fields_ = [
        ("wheels", ctypes.c_double * 2),
        ("inputs", ctypes.c_double * 2),
        ("errors", ctypes.c_double * 3),
        ("margins", ctypes.c_double * 3),
        ("status", ctypes.c_int),
        ("pose", ctypes.c_int),
        ("in_time", ctypes.c_int),
        ("guaranteed", ctypes.c_int),
        ("plan_left", ctypes.c_int),
        ("exchanges", ctypes.c_int),
    ]


class Step(NamedTuple):
    """As the controller in NumPy returns it."""

    wheels: np.ndarray
    inputs: np.ndarray
    errors: np.ndarray
    margins: np.ndarray
    status: int
    pose: int
    in_time: bool
    guaranteed: bool
    plan_left: int
    exchanges: int


def compile_c(folder: Path, made: Path, *flags: str, main: bool = False) -> Path:
    """Compile the C of an exported folder; return the program, or the library without main.c."""
    assert COMPILER
    names = ["controller.c", "constants.c", *(["main.c"] if main else [])]
    shared = [] if main else ["-shared", "-fPIC"]
    sources = [str(folder / "c" / name) for name in names]
    command = [COMPILER, "-std=c99", "-O2", *flags, *shared, *sources, "-lm", "-o", str(made)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return made


class CController:
    """One controller of a library."""

    def __init__(self, library: Path):
        self._library = ctypes.CDLL(str(library))
        self._memory = ctypes.create_string_buffer(LARGEST)
        self.is_sound = self._library.jaxtube_begin(self._memory, 1) == 0

    def restart(self, runs: bool = False) -> None:
        self._library.jaxtube_restart(self._memory, int(runs))

    def step(self, pose=None, stamp=None, now=None, slip=None) -> Step:
        given = Input(
            has_pose=pose is not None, has_times=now is not None, has_slip=slip is not None
        )
        if pose is not None:
            given.pose[:] = pose
        if now is not None:
            given.now_s = now
            given.stamp_s = np.nan if stamp is None else stamp
        if slip is not None:
            given.slip[:] = slip
        found = Output()
        self._library.jaxtube_step(self._memory, ctypes.byref(given), ctypes.byref(found))
        arrays = (np.array(list(getattr(found, name))) for name in Step._fields[:4])
        return Step(*arrays, *(getattr(found, name) for name in Step._fields[4:]))
