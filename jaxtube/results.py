"""`read`: results back from the folders that their `save` has written."""

from __future__ import annotations

from pathlib import Path

from jaxtube.simulation.simulate import Laps
from jaxtube.statistics.montecarlo import MonteCarlo
from jaxtube.storage import read_result, refuse_differences, refuse_folder
from jaxtube.synthesis.design import design
from jaxtube.synthesis.parts import Design

RESTORERS = {"laps": Laps.restore, "montecarlo": MonteCarlo.restore}
"""By kind of result, how it is made of its design and of what was read."""


def read(folder: str | Path) -> Design | Laps | MonteCarlo:
    """Read what the `save` of a design, of laps or of a Monte Carlo run has written.

    A design is made again from its scenario, and so is that of laps and runs; its arrays must equal
    those that were saved.

    Raises:
        ScenarioError: one line, for a folder that holds no result, is damaged or of another
            version, or whose design comes out differently here.
    """
    stored = read_result(folder)
    made = design(stored.scenario)
    if stored.kind == "design":
        refuse_differences(stored.arrays, made.arrays())
        return made
    if stored.kind not in RESTORERS:
        raise refuse_folder(folder, f"holds a {stored.kind!r}, which is unknown")
    try:
        return RESTORERS[stored.kind](made, stored)
    except KeyError as error:
        raise refuse_folder(folder, f"is damaged: {error.args[0]} is missing") from None
