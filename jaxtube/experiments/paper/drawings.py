"""The figures of `paper`, and the data behind them: kept in the run's folder, read again to redraw
them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxtube.experiments.run.folder import RunFolder
from jaxtube.figures.stress import Runs, StressedCase
from jaxtube.numpy_archive import read_archive
from jaxtube.progress import announce, progress
from jaxtube.reporting import laps as kept_laps
from jaxtube.reporting.laps import StoredLaps
from jaxtube.scenario.reading import load
from jaxtube.synthesis.design import design as make_design
from jaxtube.synthesis.parts import Design

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Drawings = dict[str, Callable[[], "Figure"]]
"""What draws each figure, by name."""

STRESSED_FOR_PAPER = "robust"
"""The scenario whose design is put under stress for the scenario `paper`."""


class DesignOfRun(NamedTuple):
    """A design and its name."""

    name: str
    design: Design


class Drawn(NamedTuple):
    """What the figures show.

    Attributes:
        kept: laps of every controller.
        deviations: from plans that were followed to their end, m, m, rad.
        cases: runs under stress, by case.
        boundary: corners of the set of their starts.
    """

    kept: StoredLaps
    deviations: Float[np.ndarray, "horizon samples 3"]
    cases: dict[str, StressedCase]
    boundary: Float[np.ndarray, "corners 3"]

    def save(self, folder: RunFolder) -> None:
        """Write laps.npz, deviations.npz and stress.npz."""
        folder.save_arrays("laps", **self.kept.arrays())
        folder.save_arrays("deviations", deviations=np.asarray(self.deviations, np.float32))
        arrays: dict[str, Any] = {"cases": np.array(list(self.cases)), "boundary": self.boundary}
        for name, case in self.cases.items():
            arrays[f"{name}/title"] = case.title
            arrays[f"{name}/starts"] = np.asarray(case.starts, np.float32)
            for kind, runs in case.runs.items():
                arrays |= {f"{name}/{kind}/{key}": entry for key, entry in runs._asdict().items()}
        folder.save_arrays("stress", **arrays)


def read_drawn(folder: Path) -> Drawn:
    """Return what the figures of a run show, from its folder.

    Raises:
        OSError, KeyError: where files or parts of them are missing.
        ValueError: where they are damaged.
    """
    kept = kept_laps.read(folder)
    deviations = read_archive((folder / "deviations.npz").read_bytes())["deviations"].astype(float)
    stressed = read_archive((folder / "stress.npz").read_bytes())
    cases = {str(name): _read_case(stressed, str(name)) for name in stressed["cases"]}
    return Drawn(kept, deviations, cases, stressed["boundary"])


def _read_case(arrays: Mapping[str, np.ndarray], name: str) -> StressedCase:
    runs = {
        kind: Runs._make(arrays[f"{name}/{kind}/{key}"] for key in Runs._fields)
        for kind in ("plain", "tube")
    }
    return StressedCase(str(arrays[f"{name}/title"]), arrays[f"{name}/starts"], runs)


def find_stressed(own: DesignOfRun) -> DesignOfRun:
    """Return the design under stress: that of the run, for `paper` another one."""
    if own.name != "paper":
        return own
    announce(f"designing `{STRESSED_FOR_PAPER}`, which is put under stress")
    return DesignOfRun(STRESSED_FOR_PAPER, make_design(load(STRESSED_FOR_PAPER)))


def make_drawings(own: DesignOfRun, stressed: DesignOfRun, label: str, drawn: Drawn) -> Drawings:
    """Return what draws each figure, by name.

    Args:
        own: design of the run.
        stressed: that under stress.
        label: of the own design in titles.
        drawn: what the figures show.
    """
    from jaxtube.figures import laps as lap_figures
    from jaxtube.figures.paths import trajectories
    from jaxtube.figures.realisations import realisations_in_tube
    from jaxtube.figures.sets import terminal_set, tube_sections
    from jaxtube.figures.stress import stress
    from jaxtube.figures.tightened import tightened_sets

    design = own.design
    problem = design.problem
    laps = {name: kept.in_double_precision() for name, kept in drawn.kept.laps.items()}
    drawings: Drawings = {
        "trajectories": partial(trajectories, problem, laps),
        "errors": partial(lap_figures.errors, problem, laps),
        "wheel_speeds": partial(lap_figures.wheel_speeds, problem, laps),
        "margins": partial(lap_figures.margins, problem, laps),
        "tube_sections": partial(tube_sections, design, label),
        "tightened_sets": partial(tightened_sets, design, label),
        "terminal_set": partial(terminal_set, design, label),
        "realisations_in_tube": partial(realisations_in_tube, design, drawn.deviations),
        "stress": partial(
            stress, stressed.design.problem, list(drawn.cases.values()), drawn.boundary
        ),
    }
    if stressed is not own:
        drawings["stress_terminal_set"] = partial(terminal_set, stressed.design, stressed.name)
    return drawings


def draw(drawings: Drawings, folder: RunFolder) -> None:
    """Draw the figures into a folder."""
    with progress(len(drawings), "drawing", "figures", starting="starting") as bar:
        for name, make_figure in drawings.items():
            folder.save_figure(make_figure(), name)
            bar.update()
