"""Logarithmic axes that read as plain numbers."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from matplotlib.axis import Axis
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

DECADE = 10.0
"""Ratio of the greatest to the least value from which an axis is logarithmic."""
COARSE = (1, 2, 5)
FINE = (1, 1.5, 2, 3, 4, 5, 7)
"""Multiples of powers of ten that are ticks, beyond a decade and within one."""


def spans_decade(values: Float[np.ndarray, " n"]) -> bool:
    """Tell whether the finite values are all positive and span more than a decade."""
    finite = values[np.isfinite(values)]
    return finite.size > 0 and bool(finite.min() > 0 and finite.max() > DECADE * finite.min())


def plain_ticks(axis: Axis) -> None:
    """Let a logarithmic axis, whose limits are known, count 1, 2, 5, 10 and so on, finer within a
    decade."""
    low, high = axis.get_view_interval()
    multiples = COARSE if high > DECADE * low else FINE
    axis.set_major_locator(LogLocator(subs=multiples))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
