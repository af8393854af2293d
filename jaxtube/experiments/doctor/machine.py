"""The machine: devices, 64-bit arithmetic, the folder of compiled programs, folders, and programs
of others."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path

from jaxtube.experiments.doctor.finding import Check, Finding

CACHE = "JAX_COMPILATION_CACHE_DIR"
"""Variable of the environment that names the folder of compiled programs."""
SMALL = 2.0**-40
"""Vanishes beside 1 in 32 bits, not in 64."""
OPTIONAL_PROGRAMS = {
    "C compiler": ("cc", "gcc", "clang"),
    "ffmpeg": ("ffmpeg",),
}

CHECKS = (
    Check(
        "devices",
        lambda: find_devices(),
        "pip install -U jax jaxlib; for a GPU pip install 'jaxtube[cuda]' and a driver of NVIDIA",
    ),
    Check(
        "float64",
        lambda: find_float64(),
        "unset JAX_ENABLE_X64, or take a device that computes in 64 bits: JAX_PLATFORMS=cpu",
    ),
    Check(
        "compiled programs",
        lambda: find_cache(),
        f"name a folder that you may write to: export {CACHE}=FOLDER; without one every run "
        "compiles anew",
    ),
    Check(
        "folder of runs",
        lambda: find_runs(),
        "start from a folder that you may write to, or give each command --out",
    ),
)


def find_devices() -> str:
    """Return the devices of JAX and their kinds."""
    import jax

    found = jax.devices()
    kinds = sorted({device.device_kind for device in found})
    return f"{len(found)} of platform {found[0].platform} ({', '.join(kinds)})"


def find_float64() -> str:
    """Return that every device keeps what only 64 bits hold.

    Raises:
        RuntimeError: where one does not.
    """
    import jax
    import jax.numpy as jnp

    for device in jax.devices():
        one = jax.device_put(jnp.ones(()), device)
        rest = float(jax.jit(lambda x: (x + SMALL) - 1.0)(one))
        if rest != SMALL:
            raise RuntimeError(f"1 + 2^-40 - 1 is {rest:g} on {device}")
    return "every device computes in 64 bits"


def find_cache() -> str:
    """Return where compiled programs are kept, and how much they take.

    Raises:
        OSError: where the folder cannot be written to.
        RuntimeError: where no folder is named.
    """
    name = os.environ.get(CACHE)
    if not name:
        raise RuntimeError("no folder is named")
    folder = Path(name)
    _write_into(folder)
    files = list_programs()
    size = sum(file.stat().st_size for file in files)
    return f"{len(files):,} files, {size / 2**20:,.0f} MiB in {folder}"


def list_programs() -> list[Path]:
    """Return the files of the compiled programs that are kept."""
    folder = Path(os.environ.get(CACHE) or "")
    return [file for file in folder.iterdir() if file.is_file()] if folder.is_dir() else []


def find_runs() -> str:
    """Return where runs are written.

    Raises:
        OSError: where that cannot be written to.
    """
    folder = Path("runs")
    _write_into(folder if folder.is_dir() else Path.cwd())
    return f"{folder.resolve()} can be written to"


def _write_into(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=folder) as file:
        file.write(b"0")


def find_programs() -> list[Finding]:
    """Return whether programs are there that jaxtube works without."""
    return [_find_program(name, commands) for name, commands in OPTIONAL_PROGRAMS.items()]


def _find_program(name: str, commands: tuple[str, ...]) -> Finding:
    places = [place for place in map(shutil.which, commands) if place]
    if places:
        return Finding(name, "ok", places[0], is_needed=False)
    cure = f"only where you want it: install {commands[0]} by the package manager of your system"
    return Finding(name, "missing", "is not on the PATH", cure, is_needed=False)
