"""Numbers >= 0 as integers in the same order, with an index in their last bits: the extreme of a
batch and where it stands come from one reduction.

A processor's compiler makes a loop over the batch of it. The extreme of floats it hands to a
library that is many times slower here, and one that remembers its place it does not vectorise.

Source: new; that floats of one sign are ordered as their bits is IEEE 754's.
"""

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float


def as_integer(value: Array) -> Array:
    """Return the bits of numbers."""
    integer = jnp.int64 if value.dtype.itemsize == 8 else jnp.int32
    return jax.lax.bitcast_convert_type(value, integer)


def largest(values: Float[Array, "m batch"]) -> Float[Array, " batch"]:
    """Return the largest of numbers >= 0, NaN where one of them is.

    As integers, whose order is the same: a processor's compiler hands the maximum of floats over to
    a library that is many times slower.
    """
    greatest = jnp.max(as_integer(jnp.abs(values)), axis=0)
    return jax.lax.bitcast_convert_type(greatest, values.dtype)


def tag(value: Array, index: Array | int, count: int) -> Array:
    """Return max(value, 0) as an integer in the same order, whose last bits are an index below a
    count."""
    bits = as_integer(jnp.maximum(value, 0.0))
    spare = (1 << (count - 1).bit_length()) - 1
    return (bits & ~spare) | jnp.asarray(index, bits.dtype)


def untag(tagged: Array, dtype) -> Array:
    """Return the number, changed by as much as its tag takes of it."""
    return jax.lax.bitcast_convert_type(tagged, dtype)


def read_tag(tagged: Array, count: int) -> Array:
    """Return the index."""
    return (tagged & ((1 << (count - 1).bit_length()) - 1)).astype(jnp.int32)
