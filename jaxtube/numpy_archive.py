"""Archives of arrays, NAME.npz, read from files that may be damaged or made by someone else."""

from __future__ import annotations

import io

import numpy as np


def read_archive(data: bytes) -> dict[str, np.ndarray]:
    """Return the arrays of an archive by name; their bytes are copied, no object is built of them.

    Raises:
        ValueError: a clause, for anything but an archive of arrays of numbers and texts.
    """
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            arrays = dict(file)
    except Exception:
        # NumPy and the zip reader name no errors for bytes that they have not written, and raise a
        # dozen kinds: of the archive, of its compression, of the syntax of an array's header.
        raise ValueError("is no archive of arrays") from None
    if not all(isinstance(array, np.ndarray) for array in arrays.values()):
        raise ValueError("holds other files than arrays")
    return arrays
