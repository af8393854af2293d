"""`animate RUN`: a lap of a run as GIF or MP4, from the laps that its folder holds."""

from __future__ import annotations

from pathlib import Path

from jaxtube.experiments.options import AnimateOptions
from jaxtube.experiments.run.folder import unwritable
from jaxtube.reporting import laps as kept_laps
from jaxtube.reporting.laps import StoredLaps
from jaxtube.reporting.moving_pictures import save_animation
from jaxtube.scenario.refusal import refusal


def run(scenario: None, options: AnimateOptions) -> int:
    """Run the command.

    Raises:
        ScenarioError: one line, for a folder without laps, a controller or a lap that it does not
            hold, and a file that cannot be written.
    """
    if options.overrides:
        cure = "leave it out: a run is drawn as it was"
        raise refusal("command line", "override", options.overrides[0], "is of no use here", cure)
    stored = read_laps(options.run)
    names = options.controller.split(",") if options.controller else [list(stored.laps)[-1]]
    places = {names[0]: find_place(stored, names[0], options.lap)}
    number = str(stored.laps[names[0]].numbers[places[names[0]]])
    # The same draws for all.
    places |= {name: find_place(stored, name, number) for name in names[1:]}
    path = Path(options.to or Path(options.run) / "lap.gif")
    try:
        save_animation(stored, places, options.frames, path)
    except OSError as error:
        raise unwritable(path, error, "--to") from None
    except ValueError as error:
        problem, _, cure = str(error).partition("; ")
        raise refusal("command line", "--to", str(path), problem, cure) from None
    size = path.stat().st_size / 1e6
    print(f"{path}: lap {number} of {', '.join(names)}; {options.frames} pictures, {size:.2f} MB")
    return 0


def read_laps(run_folder: str) -> StoredLaps:
    """Return the laps of a run folder.

    Raises:
        ScenarioError: one line, where it holds none.
    """
    try:
        return kept_laps.read(Path(run_folder))
    except (OSError, KeyError, ValueError):
        problem = f"holds no {kept_laps.FILE} that can be played"
        cure = "name a run of paper, design, montecarlo or guarantee, or run it again"
        raise refusal("command line", "RUN", run_folder, problem, cure) from None


def find_place(stored: StoredLaps, name: str, which: str) -> int:
    """Return the place of a lap among those that were kept of a controller.

    Raises:
        ScenarioError: one line, for an unknown controller or lap.
    """
    if name not in stored.laps:
        cure = f"give one of {', '.join(stored.laps)}, or several with commas between"
        raise refusal("command line", "--controller", name, "is not in the run", cure)
    try:
        return stored.laps[name].find(which)
    except ValueError as error:
        problem, _, cure = str(error).partition("; ")
        raise refusal("command line", "--lap", which, problem, f"{cure}, median or worst") from None
