"""`python -m jaxtube.experiments`: sets what jax has to be told before it is imported, then runs the command line."""

import importlib.metadata
import os
import sys

from .cli import main

if __name__ == "__main__":
    os.environ["JAX_ENABLE_X64"] = "1"
    # XLA splits a program over 32 compilations, which doubles the time to compile on few cores. An unknown flag is
    # fatal, so it is passed only to the releases that were seen to know it.
    if importlib.metadata.version("jaxlib").startswith("0.10."):
        flags = os.environ.get("XLA_FLAGS", "")
        os.environ["XLA_FLAGS"] = f"{flags} --xla_cpu_parallel_codegen_split_count=1".strip()
    sys.exit(main())
