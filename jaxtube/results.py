"""`save` and `read`: results into folders and back."""

from __future__ import annotations

from pathlib import Path

from jaxtube.arguments import describe_type
from jaxtube.falsification.falsify import Falsification
from jaxtube.precision import in_64_bits
from jaxtube.scenario.folders import refuse_folder
from jaxtube.simulation.simulate import Laps
from jaxtube.statistics.montecarlo import MonteCarlo
from jaxtube.storage import StoredResult, read_result
from jaxtube.synthesis.design import EmptySetError, design, restore_design
from jaxtube.synthesis.parts import Design
from jaxtube.synthesis.stored_certificate import refuse_another_certificate
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

    A design commands as it did when it was saved, to the bit: its condensed QPs, gains, windows,
    reference and W are those of the folder. All the rest is designed again from the scenario, which
    takes about as long as it did at first; the arrays that come out must be those of the folder, to
    1e-9, and the design is certified anew on those of the folder. The design of any other result is
    made again.

    Raises:
        ScenarioError: one line, for a folder that holds no result, is damaged or of another
            version, or whose design comes out or is judged differently here.
    """
    stored = read_result(folder)
    if stored.kind not in KINDS:
        raise refuse_folder(folder, f"holds a {stored.kind!r}, which is unknown")
    try:
        return _restore(stored)
    except EmptySetError as error:
        raise refuse_folder(folder, f"holds no scenario of a design ({error})") from None
    except (KeyError, TypeError) as error:
        raise refuse_folder(folder, f"is damaged: it lacks a part ({error})") from error


def save(result: Result, folder: str | Path) -> Path:
    """Save a result in a new or empty folder, for `read`, or in place of a result of its kind;
    return the folder.

    Raises:
        ScenarioError: one line, for a folder with anything else, or one that cannot be written.
        ValueError: one line, for anything but a result.
    """
    if isinstance(result, Result):
        return result.save(folder)
    raise ValueError(
        f"result: is {describe_type(result)}; give what design, simulate, montecarlo, falsify or "
        "tune returns"
    )


def _restore(stored: StoredResult) -> Result:
    if stored.kind == "tuned":
        return Tuned.restore(stored)
    if stored.kind == "design":
        made = restore_design(stored.scenario, stored.arrays)
        refuse_another_certificate(stored.facts["certificate"], made.certificate)
        return made
    return OF_A_DESIGN[stored.kind](design(stored.scenario), stored)
