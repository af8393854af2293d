"""Archives of arrays, NAME.npz, read from files that may be damaged or made by someone else."""

from __future__ import annotations

import io
import struct
import zipfile
import zlib

import numpy as np

DAMAGE = (
    ValueError,
    EOFError,
    KeyError,
    NotImplementedError,
    OSError,
    OverflowError,
    RuntimeError,
    MemoryError,
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
)
"""What NumPy and the zip reader raise for bytes that no program of theirs has written."""


def read_archive(data: bytes) -> dict[str, np.ndarray]:
    """Return the arrays of an archive by name; their bytes are copied, no object is built of them.

    Raises:
        ValueError: a clause, for anything but an archive of arrays of numbers and texts.
    """
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            arrays = dict(file)
    except (*DAMAGE, TypeError, AttributeError):
        # The last two are of a single array, which NumPy returns without an archive around it.
        raise ValueError("is no archive of arrays") from None
    if not all(isinstance(array, np.ndarray) for array in arrays.values()):
        raise ValueError("holds other files than arrays")
    return arrays
