"""Histograms over logarithmic buckets: whole numbers only, so that they add up in any order and on
any machine.

Each octave [2^p, 2^(p+1)) is cut into 8 buckets of equal width, read off the bits of the number.
Between the edges a value is known to an eighth. What is smaller than the first edge counts in the
first bucket, what is larger than the last, is infinite or NaN, in the last.

The buckets are those of a floating-point number's exponent and leading bits (Tene, HdrHistogram,
2012).
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from jaxtube.qp.blocks import on_accelerator

CUTS = 8
"""Buckets an octave."""
LEAST = -12
GREATEST = 1
"""Exponents of the first and the last edge: 0.24 mm to 2 m, or the same in rad."""
BUCKETS = CUTS * (GREATEST - LEAST)
OCTAVES = np.repeat(2.0 ** np.arange(LEAST, GREATEST), CUTS)
EDGES = OCTAVES * np.tile(1 + np.arange(CUTS) / CUTS, GREATEST - LEAST)
"""Lower edges of the buckets."""
COPIES = 256
"""Of counters on an accelerator, one for each stretch of neighbouring laps: laps are in the same
few cells, and threads that add to one number wait for each other."""
BITS = {4: (jnp.int32, 23, 127), 8: (jnp.int64, 52, 1023)}
"""Integer type, bits of the mantissa and bias of the exponent, by the bytes of a float."""


def bucket(values: Float[Array, "*shape"]) -> Int[Array, "*shape"]:
    """Return the number of the bucket of |value|, 0 .. BUCKETS - 1."""
    kind, mantissa, bias = BITS[values.dtype.itemsize]
    bits = jax.lax.bitcast_convert_type(jnp.abs(values), kind)
    leading = bits >> (mantissa - 3)
    number = leading - (bias + LEAST) * CUTS
    return jnp.clip(number, 0, BUCKETS - 1).astype(jnp.int32)


def begin_counts(size: int) -> Int[Array, "copies size"]:
    """Return counters at zero."""
    copies = COPIES if on_accelerator() else 1
    return jnp.zeros((copies, size), jnp.int32)


def add_counts(
    counts: Int[Array, "copies size"],
    cells: Sequence[Int[Array, "*rows batch"]],
    weights: Int[Array, " batch"],
) -> Int[Array, "copies size"]:
    """Return counters with the laps' weights added in their cells, for each array of cells; cells
    that are none are left out."""
    copies, size = counts.shape
    batch = len(weights)
    copy = jnp.arange(batch, dtype=jnp.int32) // -(-batch // copies)
    flat = counts.reshape(-1)
    # A processor makes each array on its way; an accelerator would start a kernel for each.
    for several in [jnp.stack(cells)] if on_accelerator() else cells:
        valid = (several >= 0) & (several < size)
        place = jnp.where(valid, copy * size + several, copies * size)
        flat = flat.at[place].add(weights, mode="drop")
    return flat.reshape(copies, size)


def end_counts(counts: Int[Array, "copies size"], shape: tuple[int, ...]) -> Int[Array, "*shape"]:
    """Return what was counted."""
    return jnp.sum(counts, axis=0, dtype=jnp.int32).reshape(shape)


def quantile(
    counts: Int[np.ndarray, "*shape buckets"], share: float
) -> Float[np.ndarray, "*shape"]:
    """Return the value below which a share of the counted ones lies, interpolated inside its
    bucket; NaN for none.

    The last bucket is open: a quantile in it is infinite.
    """
    counts = np.asarray(counts)
    cumulative = np.cumsum(counts, axis=-1, dtype=np.int64)
    total = cumulative[..., -1:]
    wanted = share * total
    index = np.sum(cumulative < wanted, axis=-1, keepdims=True)
    before = np.take_along_axis(cumulative - counts, index, axis=-1)
    inside = (wanted - before) / np.maximum(np.take_along_axis(counts, index, axis=-1), 1)
    lower = np.append(0.0, EDGES[1:])[index]
    upper = np.append(EDGES[1:], np.inf)[index]
    is_open = np.isinf(upper)
    width = np.where(is_open, 0.0, upper) - np.where(is_open, 0.0, lower)
    values = np.where(is_open, np.inf, lower + inside * width)
    return np.where(total > 0, values, np.nan)[..., 0]
