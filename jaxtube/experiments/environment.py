"""What jax has to be told by the environment before it is imported."""

import hashlib
import importlib.metadata
import os
import platform
from pathlib import Path


def use_float64() -> None:
    """Compute in float64."""
    os.environ["JAX_ENABLE_X64"] = "1"


def compile_in_one_piece() -> None:
    """Let XLA compile a program as a whole: it splits it over 32 compilations, which doubles the
    time on few cores."""
    # An unknown flag is fatal, so it is passed only to the releases that were seen to know it.
    if importlib.metadata.version("jaxlib").startswith("0.10."):
        flags = os.environ.get("XLA_FLAGS", "")
        os.environ["XLA_FLAGS"] = f"{flags} --xla_cpu_parallel_codegen_split_count=1".strip()


def keep_compiled_programs() -> None:
    """Keep compiled programs in a folder, which spares a command half a minute the next time.

    A program fits the processor it was compiled for, and homes are shared between machines: one
    folder for each kind.
    """
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    info = Path("/proc/cpuinfo")
    features = (
        {line for line in info.read_text().splitlines() if line.startswith("flags")}
        if info.exists()
        else ()
    )
    kind = hashlib.sha256(f"{platform.machine()} {sorted(features)}".encode()).hexdigest()[:16]
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(home / "jaxtube" / kind))
