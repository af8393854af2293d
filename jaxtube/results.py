"""`read`: results back from the folders that their `save` has written."""

from __future__ import annotations

from pathlib import Path

from jaxtube.falsification.falsify import Falsification
from jaxtube.precision import in_64_bits
from jaxtube.simulation.simulate import Laps
from jaxtube.statistics.montecarlo import MonteCarlo
from jaxtube.storage import StoredResult, read_result, refuse_differences, refuse_folder
from jaxtube.synthesis.design import design
from jaxtube.synthesis.parts import Design
from jaxtube.tuning.tune import Tuned

Result = Design | Laps | MonteCarlo | Falsification | Tuned

OF_A_DESIGN = {
    "laps": Laps.restore,
    "montecarlo": MonteCarlo.restore,
    "falsification": Falsification.restore,
}
"""By kind of result, how it is made of its design and of what was read."""
KINDS = ("design", "tuned", *OF_A_DESIGN)


@in_64_bits
def read(folder: str | Path) -> Result:
    """Read what the `save` of a result has written.

    A design is made again from its scenario, and so is that of any other result; its arrays must
    equal those that were saved.

    Raises:
        ScenarioError: one line, for a folder that holds no result, is damaged or of another
            version, or whose design comes out differently here.
    """
    stored = read_result(folder)
    if stored.kind not in KINDS:
        raise refuse_folder(folder, f"holds a {stored.kind!r}, which is unknown")
    try:
        return _restore(stored)
    except (KeyError, TypeError) as error:
        raise refuse_folder(folder, f"is damaged: it lacks a part ({error})") from error


def _restore(stored: StoredResult) -> Result:
    if stored.kind == "tuned":
        return Tuned.restore(stored)
    made = design(stored.scenario)
    if stored.kind == "design":
        refuse_differences(stored.arrays, made.arrays())
        return made
    return OF_A_DESIGN[stored.kind](made, stored)
