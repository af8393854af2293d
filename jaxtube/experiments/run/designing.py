"""The design of a command: that of a folder, where `--scenario` names one, else made anew."""

from __future__ import annotations

import hashlib
from pathlib import Path

from jaxtube.experiments.options import Options
from jaxtube.results import read
from jaxtube.scenario.folders import holds_design
from jaxtube.scenario.reading import find
from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.design import design
from jaxtube.synthesis.parts import Design, StoredQps


def make_design(scenario: Scenario, options: Options | None = None) -> Design:
    """Return the design of a command's scenario: that which was saved where `--scenario` names its
    folder and no key is overridden, to the bit.

    Args:
        scenario: to design.
        options: of the command; none for a scenario that is not the one they name.

    Raises:
        ScenarioError, EmptySetError: one line, as `jaxtube.design` and `jaxtube.read`.
    """
    if options is None or options.scenario_overrides or not _names_design(options.scenario):
        return design(scenario)
    saved = read(options.scenario)
    assert isinstance(saved, Design)
    return saved


def _names_design(name: str) -> bool:
    """Tell whether `--scenario` names a saved design; a scenario that comes with the project goes
    before a folder of its name."""
    return find(name).parent == Path(name) and holds_design(name)


def identify_restored(design: Design) -> dict[str, str]:
    """Return the SHA-256 of the numbers of a design that was read from a folder: they determine
    what its laps are, to the bit. Nothing for a design that its scenario determines."""
    if not isinstance(design.condensed, StoredQps):
        return {}
    digest = hashlib.sha256()
    for name, array in sorted(design.arrays().items()):
        digest.update(f"{name} {array.dtype} {array.shape}\0".encode())
        digest.update(array.tobytes())
    return {"saved_design_sha256": digest.hexdigest()}
