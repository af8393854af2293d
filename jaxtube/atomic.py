"""Files that appear complete or not at all: each is written under a temporary name, then
renamed."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO


def write_atomically(path: Path, write: Callable[[BinaryIO], Any]) -> None:
    """Write a file; where that fails, an earlier file of this name stays as it was.

    Only a process killed while it writes leaves the temporary file, `.NAME.PROCESS` beside the
    file.

    Args:
        write: is called once with the open temporary file.

    Raises:
        OSError: where the disk fails; and whatever `write` raises.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with temporary.open("wb") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
