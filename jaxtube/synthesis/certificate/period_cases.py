"""What a period of the slipping robot depends on, for the witness of W.

Source: new.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

Numbers = Float[np.ndarray, " n"]


@dataclass(frozen=True, eq=False)
class PeriodCases:
    """What a period depends on, one row a case: measured errors (m, m, rad), inputs (m/s,
    rad/s), reference wheel speeds (right, left) in m/s, true and measured slips, the sideslip zeta,
    noise of the error that was measured, or how far the estimated one is off."""

    errors: Float[np.ndarray, "n 3"]
    inputs: Float[np.ndarray, "n 2"]
    wheels: Float[np.ndarray, "n 2"]
    slip: Float[np.ndarray, "n 2"]
    measured_slip: Float[np.ndarray, "n 2"]
    sideslip: Numbers
    noise: Float[np.ndarray, "n 3"]
