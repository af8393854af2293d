"""JSON that tells whether it is whole: it holds the SHA-256 of its own content, and has one
spelling."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

SEAL = "sha256"
"""Key of the hash of all other content."""


def seal(content: Mapping[str, Any]) -> bytes:
    """Return plain JSON values as bytes that `unseal` reads; equal content gives equal bytes.

    Raises:
        ValueError: for numbers that are not finite, which JSON cannot hold.
    """
    return _dump({**content, SEAL: hash_bytes(_dump(content))})


def unseal(data: bytes) -> dict[str, Any]:
    """Return the content of sealed bytes, without the seal.

    Raises:
        ValueError: where any byte differs from what `seal` has written.
    """
    try:
        content = json.loads(data)
    except (ValueError, RecursionError):
        content = None
    if not isinstance(content, dict):
        raise ValueError("is no table of JSON")
    plain = {name: value for name, value in content.items() if name != SEAL}
    # A different spelling of the same content is refused, too: no byte of the file is free.
    if seal(plain) != data:
        raise ValueError("differs from what was written")
    return plain


def hash_bytes(data: bytes) -> str:
    """Return the SHA-256 of bytes, in hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()


def _dump(content: Mapping[str, Any]) -> bytes:
    return f"{json.dumps(content, indent=2, sort_keys=True, allow_nan=False)}\n".encode()
