"""The spread of measurements that a few outliers do not change.

Source: the median absolute deviation of Hampel, The influence curve and its role in robust
estimation, JASA 1974.
"""

from __future__ import annotations

from typing import overload

import numpy as np
from jaxtyping import Float

TO_DEVIATION = 1.4826
"""From the median of absolute values of a normal variable to its standard deviation."""


@overload
def find_spread(misses: np.ndarray, axis: None = None) -> float: ...
@overload
def find_spread(misses: np.ndarray, axis: int) -> Float[np.ndarray, "..."]: ...
def find_spread(misses: np.ndarray, axis: int | None = None) -> float | Float[np.ndarray, "..."]:
    """Return a robust standard deviation of values about zero, in their unit.

    Args:
        misses: by which values miss their centre, any shape.
        axis: to go along; all by default.
    """
    spread = TO_DEVIATION * np.median(np.abs(misses), axis=axis)
    return float(spread) if axis is None else spread
