"""64-bit arithmetic for the functions of the library, whatever JAX is configured to.

A certificate is one for 64-bit arithmetic: constraints are backed off by what a solver in 64 bits
may miss them by. Functions of the library that run on the device do so in a context of their own
and leave JAX's configuration as they found it; what is built outside such a context is refused.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import jax

Parameters = ParamSpec("Parameters")
Answer = TypeVar("Answer")


def in_64_bits(function: Callable[Parameters, Answer]) -> Callable[Parameters, Answer]:
    """Return a function that computes in 64 bits and leaves JAX's configuration as it was."""

    @functools.wraps(function)
    def compute(*arguments: Parameters.args, **keywords: Parameters.kwargs) -> Answer:
        with jax.enable_x64(True):
            return function(*arguments, **keywords)

    return compute


def require_64_bits(what: str) -> None:
    """Refuse to build something on the device in 32 bits.

    Args:
        what: its name, for the message.

    Raises:
        RuntimeError: where JAX computes in 32 bits here.
    """
    if jax.dtypes.canonicalize_dtype(float).itemsize < 8:
        raise RuntimeError(
            f"{what}: JAX computes in 32 bits here, and certificates are for 64; use "
            "jaxtube.simulate, .montecarlo or .falsify, or call it inside "
            "`with jax.enable_x64(True):`"
        )
