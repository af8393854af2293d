"""JSON that an earlier run has written, read back: one line refuses what is no longer that."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from jaxtube.scenario.refusal import ScenarioError, refusal


def read_table(path: Path) -> dict[str, Any]:
    """Return the table in a file that a run has written.

    Raises:
        ScenarioError: one line, where it cannot be read or holds no table.
    """
    try:
        content = json.loads(path.read_bytes())
    except OSError as error:
        raise refuse_file(path, f"cannot be read ({error.strerror})") from None
    except (ValueError, RecursionError):
        content = None
    if not isinstance(content, dict):
        raise refuse_file(path, "is damaged: it is no table of JSON")
    return content


def refuse_file(path: Path, problem: str) -> ScenarioError:
    """Return the one line that refuses a file of an earlier run."""
    cure = "run the command again into another folder, or delete this one"
    return refusal("run", path.name, str(path.parent), problem, cure)
