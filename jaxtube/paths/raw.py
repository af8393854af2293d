"""Stand-in for the reader's type."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


class RawPath(NamedTuple):
    """A path as its file has it."""

    path: str
    time: Float[np.ndarray, " n"] | None
    positions: Float[np.ndarray, "n 2"]
    headings: Float[np.ndarray, " n"] | None
    lines: Int[np.ndarray, " n"]
    origin: Float[np.ndarray, "2"]
