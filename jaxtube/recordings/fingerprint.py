"""What tells a file from another of the same name.

Source: NIST FIPS 180-4, SHA-256.
"""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

DIGITS = 16
"""Of the hash, in base 16."""


def find_fingerprint(path: str | Path) -> str | None:
    """Return the first digits of the hash of a file; None for a folder, such as a bag."""
    file = Path(path)
    if not os.path.isfile(file):
        return None
    return hashlib.sha256(file.read_bytes()).hexdigest()[:DIGITS]
