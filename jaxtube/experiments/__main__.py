"""`python -m jaxtube.experiments`: the process computes in float64, which jax has to be told before it is imported."""

import os
import sys

from .cli import main

if __name__ == "__main__":
    os.environ["JAX_ENABLE_X64"] = "1"
    sys.exit(main())
