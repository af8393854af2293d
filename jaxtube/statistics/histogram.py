"""Histograms over logarithmic buckets: whole numbers only, so that they add up in any order and on
any machine.

Each octave [2^p, 2^(p+1)) is cut into 8 buckets of equal width, read off the bits of the number. A
value is known to 12 % at worst. What is smaller than the first edge counts in the first bucket,
what is larger than the last, is infinite or no number, in the last.

The buckets are those of a floating-point number's exponent and leading bits (Tene, HdrHistogram,
2012).
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

CUTS = 8  # buckets an octave
LEAST, GREATEST = (
    -12,
    1,
)  # exponents of the first and the last edge: 0.24 mm to 2 m, or the same in rad
BUCKETS = CUTS * (GREATEST - LEAST)
EDGES = 2.0 ** np.repeat(np.arange(LEAST, GREATEST), CUTS) * np.tile(
    1 + np.arange(CUTS) / CUTS, GREATEST - LEAST
)
"""Lower edges of the buckets."""


def bucket(values: Float[Array, "*shape"]) -> Int[Array, "*shape"]:
    """Return the number of the bucket of |value|, 0 .. BUCKETS - 1."""
    kind, mantissa, bias = {4: (jnp.int32, 23, 127), 8: (jnp.int64, 52, 1023)}[
        values.dtype.itemsize
    ]
    leading = jax.lax.bitcast_convert_type(jnp.abs(values), kind) >> (mantissa - 3)
    return jnp.clip(leading - (bias + LEAST) * CUTS, 0, BUCKETS - 1).astype(jnp.int32)


def quantile(
    counts: Int[np.ndarray, "*shape buckets"], share: float
) -> Float[np.ndarray, "*shape"]:
    """Return the value below which a share of the counted ones lies, interpolated inside its
    bucket; NaN for none.

    The last bucket is open: a quantile in it is infinite.
    """
    cumulative = np.cumsum(counts, axis=-1, dtype=np.int64)
    total = cumulative[..., -1:]
    wanted = share * total
    index = np.sum(cumulative < wanted, axis=-1, keepdims=True)
    before = np.take_along_axis(cumulative - counts, index, axis=-1)
    inside = (wanted - before) / np.maximum(
        np.take_along_axis(np.asarray(counts), index, axis=-1), 1
    )
    lower, upper = np.append(0.0, EDGES[1:])[index], np.append(EDGES[1:], np.inf)[index]
    with np.errstate(invalid="ignore"):
        found = np.where(
            np.isinf(upper), np.inf, lower + inside * np.where(np.isinf(upper), 0.0, upper - lower)
        )
    return np.where(total > 0, found, np.nan)[..., 0]
