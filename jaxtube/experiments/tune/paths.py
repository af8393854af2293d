"""Designs of the comparison on the path of tuning and on paths that tuning never saw."""

from __future__ import annotations

import dataclasses
import sys
from typing import NamedTuple

import msgspec
import numpy as np
from jaxtyping import Float

from jaxtube.experiments.tune.baselines import ComparedDesign, run_static_lqr
from jaxtube.experiments.tune.result import compute_reduction
from jaxtube.scenario.reading import experiments_folder
from jaxtube.scenario.refusal import ScenarioError
from jaxtube.scenario.tree import ReferenceTable, Scenario
from jaxtube.simulation import components
from jaxtube.synthesis.disturbance import complete_problem
from jaxtube.synthesis.problem import Problem
from jaxtube.tuning.judgement import pool
from jaxtube.tuning.tuner import COMPARED, find_failing

PATH_LAPS = 512
RECORDED = experiments_folder() / "untuned" / "recorded.csv"
"""A drive with changes of speed and rounding, like what a positioning system records."""


class Drive(NamedTuple):
    """A design on one path: its laps, and what its certificate lacks there, None where nobody
    asked."""

    errors: Float[np.ndarray, "laps 3"]  # RMS once settled (m, m, rad)
    effort: Float[np.ndarray, " laps"]  # RMS, m/s
    failing: tuple[str, ...] | None


Drives = dict[str, Drive]
"""The designs on one path, by their names."""


def unseen_paths(scenario: Scenario) -> dict[str, ReferenceTable]:
    """Return the scenario's path, a lemniscate at its speed, and a recorded one, all within its box
    of wheel speeds."""
    own = scenario.reference
    lemniscate = msgspec.structs.replace(own, shape="lemniscate")
    recorded = msgspec.structs.replace(own, shape="file", file=str(RECORDED))
    return {"eight (tuned on)": own, "lemniscate": lemniscate, "recorded": recorded}


def drive_paths(scenario: Scenario, entries: list[ComparedDesign]) -> dict[str, Drives]:
    """Drive every design on every path; start and tuned are certified for each.

    A path that cannot be driven is named on the standard error; one on which the start has no
    closed loop is left out, for there is nothing to compare with.
    """
    paths = {}
    for path, section in unseen_paths(scenario).items():
        try:
            problem = complete_problem(msgspec.structs.replace(scenario, reference=section))
        except ScenarioError as error:
            print(f"{path}: not driven ({error})", file=sys.stderr)
            continue
        drives = {}
        for entry in entries:
            drive = _drive(entry, problem)
            if drive is not None:
                drives[entry.name] = drive
        if "start" in drives:
            paths[path] = drives
    return paths


def _drive(entry: ComparedDesign, problem: Problem) -> Drive | None:
    """Return a design on the path of a problem, None where an empty set leaves no closed loop."""
    robot = components.robot_of(problem)
    tuner = dataclasses.replace(entry.tuner, problem=problem, plant=robot)
    if entry.static:
        laps = run_static_lqr(tuner, entry.point, COMPARED, PATH_LAPS)
        return Drive(laps.errors, laps.effort, None)
    played = tuner.play(entry.point, COMPARED, PATH_LAPS)
    prepared = tuner.candidate(entry.point).prepared
    if played is None or prepared is None:
        return None
    laps, _ = played
    is_certified_here = entry.kind in ("start", "tuned")
    failing = find_failing(prepared) if is_certified_here else None
    return Drive(laps.errors, laps.effort, failing)


def path_lines(paths: dict[str, Drives]) -> list[str]:
    """Return what the designs do on each path."""
    lines = [
        f"{PATH_LAPS} laps on each path: lateral error once settled, RMS, against the start's with "
        "95 % interval"
    ]
    for path, drives in paths.items():
        lines.append(f"  {path}")
        lines += [_drive_line(name, drive, drives["start"]) for name, drive in drives.items()]
    return lines


def _drive_line(name: str, drive: Drive, start: Drive) -> str:
    less = ""
    if name != "start":
        reduction = compute_reduction(start.errors[:, 1], drive.errors[:, 1])
        less = f"{reduction.share:.1%} less ({reduction.low:.1%} to {reduction.high:.1%})"
    lateral = 1e3 * pool(drive.errors[:, 1])
    effort = pool(drive.effort)
    return (
        f"    {name:<20}{lateral:>7.3f} mm{effort:>10.5f} m/s   {less:<32}{_state(drive.failing)}"
    )


def _state(failing: tuple[str, ...] | None) -> str:
    if failing is None:
        return ""
    return f"not certified ({', '.join(failing)})" if failing else "certified"


def drive_numbers(drives: Drives) -> dict[str, dict]:
    """Return the designs on one path as plain numbers, by their names."""
    start = drives["start"]
    return {name: _numbers(drive, start) for name, drive in drives.items()}


def _numbers(drive: Drive, start: Drive) -> dict:
    reduction = compute_reduction(start.errors[:, 1], drive.errors[:, 1])
    return {
        "lateral_m": pool(drive.errors[:, 1]),
        "effort_mps": pool(drive.effort),
        "lateral_reduction": reduction._asdict(),
        "certified": None if drive.failing is None else not drive.failing,
        "failing": list(drive.failing or ()),
    }
