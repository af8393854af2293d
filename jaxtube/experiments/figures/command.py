"""`figures RUN`: the figures of a run drawn again in another style, from the data in its folder.

Sets are designed again from the scenario of the run, and the worst lap of `montecarlo` is simulated
again; all other data are read.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

from jaxtube.experiments.design.command import draw_sets
from jaxtube.experiments.montecarlo import figures as montecarlo_figures
from jaxtube.experiments.montecarlo.command import make_task
from jaxtube.experiments.options import FiguresOptions, MontecarloOptions, title
from jaxtube.experiments.paper import drawings as paper_drawings
from jaxtube.experiments.run.folder import RunFolder, unwritable
from jaxtube.experiments.run.past_run import PastRun, read_run
from jaxtube.figures.style import read_style, use_style
from jaxtube.numpy_archive import read_archive
from jaxtube.scenario.folders import SCENARIO
from jaxtube.scenario.reading import load
from jaxtube.scenario.refusal import refusal
from jaxtube.simulation.promise import limit_true_errors
from jaxtube.statistics.montecarlo import MonteCarlo, name_law
from jaxtube.synthesis.design import design as make_design
from jaxtube.synthesis.parts import Design


def run(scenario: None, options: FiguresOptions) -> int:
    """Run the command.

    Raises:
        ScenarioError: one line, for a folder without a run, a run of another command or without its
            data, an unknown style, and a folder that cannot be written to.
    """
    if options.overrides:
        cure = "leave it out: a run is drawn as it was"
        raise refusal("command line", "override", options.overrides[0], "is of no use here", cure)
    past = read_run(options.run)
    redraw = REDRAWN.get(past.options.command)
    if redraw is None:
        problem = f"is a run of {past.options.command}"
        cure = f"figures can be drawn again of {', '.join(REDRAWN)}"
        raise refusal("command line", "RUN", options.run, problem, cure)
    try:
        style = read_style(options.style)
    except OSError:
        cure = "name a file that ends in .mplstyle, or one of matplotlib.style.available"
        raise refusal(
            "command line", "--style", options.style, "is no style of matplotlib", cure
        ) from None
    made = make_design(load(str(past.folder / SCENARIO)))
    folder = RunFolder(options.folder)
    try:
        folder.path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable(folder.path, error) from None
    try:
        with use_style(style):
            redraw(past, made, folder)
    except (FileNotFoundError, KeyError, ValueError) as error:
        problem = f"lacks data of its figures ({error})"
        raise refusal("command line", "RUN", options.run, problem, "run it again") from None
    print(f"figures in the style {options.style} are in {folder.path}/")
    return 0


def _redraw_paper(past: PastRun, made: Design, folder: RunFolder) -> None:
    drawn = paper_drawings.read_drawn(past.folder)
    own = paper_drawings.DesignOfRun(title(past.options.scenario), made)
    stressed = paper_drawings.find_stressed(own)
    drawings = paper_drawings.make_drawings(own, stressed, past.options.label, drawn)
    paper_drawings.draw(drawings, folder)


def _redraw_design(past: PastRun, made: Design, folder: RunFolder) -> None:
    draw_sets(made, past.options.label, folder)


def _redraw_montecarlo(past: PastRun, made: Design, folder: RunFolder) -> None:
    options = cast(MontecarloOptions, past.options)
    statistics = read_archive((past.folder / "statistics.npz").read_bytes())
    judged = limit_true_errors(made, options.plant)
    law = name_law(judged, options.controller, options.plant, options.starts)
    summary = MonteCarlo(judged, law, options.seed, statistics).summary
    task = make_task(judged, options)
    montecarlo_figures.draw(judged, task, options.seed, statistics, summary, folder)


REDRAWN: dict[str, Callable[[PastRun, Design, RunFolder], None]] = {
    "paper": _redraw_paper,
    "design": _redraw_design,
    "montecarlo": _redraw_montecarlo,
}
"""By command, what draws the figures of its runs again."""
