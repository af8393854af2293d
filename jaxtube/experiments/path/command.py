"""`path`: missions of a recorded or planned path, each a table and a scenario that drives it.

What is cut, changed and refused is told with time and place; the wheel speeds of every mission are
checked period by period before they are written.
"""

from __future__ import annotations

import sys
from pathlib import Path

import msgspec

from jaxtube.atomic import write_atomically
from jaxtube.experiments.options import PathOptions
from jaxtube.experiments.path import figures
from jaxtube.experiments.path.report import make_page, metrics, report
from jaxtube.experiments.run import folder as run_folder
from jaxtube.experiments.run.exit_codes import ExitCode
from jaxtube.experiments.run.folder import RunFolder
from jaxtube.paths.driving import Drive
from jaxtube.paths.mission_file import write_mission
from jaxtube.paths.missions import PathPlan, plan_path
from jaxtube.paths.reference import drive_of
from jaxtube.progress import announce
from jaxtube.recordings.hints import Hints, parse_pairs
from jaxtube.recordings.path import RawPath
from jaxtube.recordings.reading import read_path
from jaxtube.scenario.refusal import ScenarioError
from jaxtube.scenario.tree import Scenario, to_toml


def run(scenario: Scenario, options: PathOptions) -> int:
    """Run the command; returns the code of bad input where no mission is left."""
    raw, plan, drive = make_plan(scenario, options)
    folder = run_folder.create(scenario, options)
    folder.report(report(raw, plan, drive, name_missions(plan)))
    announce("drawing")
    folder.save_figure(figures.plan_figure(raw, plan, drive), "path")
    for name, mission in zip(name_missions(plan), plan.missions, strict=True):
        _save(folder, f"{name}.csv", write_mission(mission.reference, raw.origin))
        _save(folder, f"{name}.toml", _write_scenario(scenario, drive, name, options))
    folder.save_metrics(metrics(plan, drive))
    folder.save_page(make_page(raw, plan, name_missions(plan)))
    print(f"\nwritten to {folder.path}/")
    if not plan.missions:
        print(
            f"{options.file}: no mission is left; the report says why: drive slower (--speed), "
            "allow more --deviation, or take a robot that turns as sharply",
            file=sys.stderr,
        )
        return ExitCode.BAD_INPUT
    first = folder.path / f"{name_missions(plan)[0]}.toml"
    print(f"next: python -m jaxtube.experiments design --scenario {first}")
    return ExitCode.DONE


def make_plan(scenario: Scenario, options: PathOptions) -> tuple[RawPath, PathPlan, Drive]:
    """Read a path, and return it with what becomes of it.

    Raises:
        ScenarioError: one line.
    """
    drive = drive_of(scenario)
    drive = drive._replace(
        speed=options.speed or drive.speed,
        recorded_timing=options.recorded_timing,
        largest_deviation=options.deviation or drive.largest_deviation,
        through_stops=options.through_stops,
        duration=None,
    )
    try:
        hints = Hints(
            columns=parse_pairs("--columns", options.columns),
            units=parse_pairs("--units", options.units),
            topics=parse_pairs("--topics", options.topics),
        )
        raw = read_path(options.file, hints)
        return raw, plan_path(raw, drive), drive
    except ValueError as error:
        raise ScenarioError(str(error)) from None


def name_missions(plan: PathPlan) -> list[str]:
    """Return the names of the files of missions."""
    digits = len(str(len(plan.missions)))
    return [f"mission-{number:0{digits}}" for number in range(1, len(plan.missions) + 1)]


def _write_scenario(scenario: Scenario, drive: Drive, name: str, options: PathOptions) -> str:
    """Return a scenario that drives a mission, as text; its file stands beside it."""
    reference = msgspec.structs.replace(
        scenario.reference,
        shape="file",
        file=f"{name}.csv",
        speed_mps=drive.speed,
        duration_s=None,
    )
    head = f"# {name} of {Path(options.file).name}, as `path` made it for scenario {options.label}"
    return f"{head}\n\n{to_toml(msgspec.structs.replace(scenario, reference=reference))}"


def _save(folder: RunFolder, name: str, text: str) -> None:
    write_atomically(folder.path / name, lambda file: file.write(text.encode()))
