"""A result as it lies in its folder, and the names of what lies there."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from jaxtube.scenario.folders import FACTS, SCENARIO
from jaxtube.scenario.tree import Scenario

ARRAYS = "arrays.npz"
FILES = (FACTS, SCENARIO, ARRAYS)
ADDED = ("kind", "schema", "files")
"""What result.json holds beside the facts of a result."""


class StoredResult(NamedTuple):
    """A result as it lies in its folder."""

    kind: str
    scenario: Scenario
    facts: dict[str, Any]
    arrays: dict[str, np.ndarray]


def reads_file(scenario: Scenario, key: str) -> bool:
    """Tell whether a scenario reads the file that a key names."""
    return key != "slip.recording" or scenario.slip.process == "recorded"
