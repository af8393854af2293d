"""The margin of a proof that no invariant set exists."""

import numpy as np
from jaxtyping import Float

from sets.certificate import escape_excess
from sets.invariant import Escape


def escape_margin(
    escape: Escape | None,
    loops: Float[np.ndarray, "v 3 3"],
    disturbance: Float[np.ndarray, "w 3"],
) -> float:
    """Return minus what an escape passes its constraint by, -inf where none does: then nothing is
    proved."""
    if escape is None:
        return -np.inf
    excess, _ = escape_excess(loops, disturbance, escape.normal, escape.offset, escape.loops)
    return -excess if excess > 0 else -np.inf
