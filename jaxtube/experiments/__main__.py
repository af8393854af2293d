"""`python -m jaxtube.experiments`: sets what jax has to be told before it is imported, then runs the command line."""

import hashlib
import importlib.metadata
import os
import platform
import sys
from pathlib import Path

from .cli import main


def compilation_cache() -> Path:
    """Name the folder for compiled programs, which spares a command half a minute the next time.

    A program fits the processor it was compiled for, and homes are shared between machines: one folder for each kind.
    """
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    info = Path("/proc/cpuinfo")
    features = {line for line in info.read_text().splitlines() if line.startswith("flags")} if info.exists() else ()
    kind = hashlib.sha256(f"{platform.machine()} {sorted(features)}".encode()).hexdigest()[:16]
    return home / "jaxtube" / kind


if __name__ == "__main__":
    os.environ["JAX_ENABLE_X64"] = "1"
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(compilation_cache()))
    # XLA splits a program over 32 compilations, which doubles the time to compile on few cores. An unknown flag is
    # fatal, so it is passed only to the releases that were seen to know it.
    if importlib.metadata.version("jaxlib").startswith("0.10."):
        flags = os.environ.get("XLA_FLAGS", "")
        os.environ["XLA_FLAGS"] = f"{flags} --xla_cpu_parallel_codegen_split_count=1".strip()
    sys.exit(main())
