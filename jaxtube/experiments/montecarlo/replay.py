"""`montecarlo --replay LAP`: simulate one lap of a run again, draw it, save it, and say what it
used of E, W and the wheels."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxtube import qp
from jaxtube.coordinates import COORDINATES
from jaxtube.experiments.options import MontecarloOptions
from jaxtube.experiments.run.folder import RunFolder, unwritable
from jaxtube.experiments.run.json_file import read_table, refuse_file
from jaxtube.experiments.run.limits import describe_error_set
from jaxtube.experiments.run.record_file import differences
from jaxtube.experiments.run.table import Column, format_table, left
from jaxtube.plant.robot import is_saturated
from jaxtube.scenario.refusal import refusal
from jaxtube.statistics.events import find_event
from jaxtube.statistics.lap import Lap, Usage, lap
from jaxtube.statistics.montecarlo import make_closed_loop_task, name_law
from jaxtube.synthesis.parts import Design
from jaxtube.synthesis.problem import Problem
from sets.polytope import Polytope

WHEELS = ("right", "left")
QP_STATUS = {"solved": qp.SOLVED, "infeasible": qp.INFEASIBLE, "unsolved": qp.UNSOLVED}


def run(design: Design, options: MontecarloOptions, identity: dict[str, Any]) -> int:
    """Draw lap `options.replay` into the run's folder, beside what is there, and print what it
    used.

    Raises:
        ScenarioError: where the folder holds a run of another identity, or cannot be made or
            written to.
    """
    from jaxtube.experiments.montecarlo import lap_figure

    number = options.replay
    assert number is not None
    folder = RunFolder(options.folder)
    name = f"replay-{number}"
    choice = (options.controller, options.plant, options.starts)
    refuse_another_run(folder.path, number, identity)
    try:
        folder.path.mkdir(parents=True, exist_ok=True)
        task = make_closed_loop_task(design, *choice, None, options.seed)
        replayed = lap(design, task, options.seed, number)
        folder.save_arrays(name, **_make_arrays(replayed))
        folder.save_figure(lap_figure.draw(design.problem, replayed), name)
    except OSError as error:
        raise unwritable(folder.path, error) from None
    law = name_law(design, *choice).describe(design.problem.scenario)
    title = f"lap {number:,}; seed {options.seed}; drawn from {law}"
    folder.report(f"{title}\n\n{text(design, replayed)}", name)
    laps = read_laps(folder.path)
    if laps is not None and number >= laps:
        print(f"\nlap {number:,} is beyond the run in {folder.path}/, which has {laps:,} laps")
    print(f"\n{name}.png, {name}.pdf, {name}.npz and {name}.txt are in {folder.path}/")
    return 0


def refuse_another_run(folder: Path, number: int, identity: dict[str, Any]) -> None:
    """Raise ScenarioError where the folder holds a run of another identity."""
    recorded = folder / "identity.json"
    if not os.path.exists(recorded):
        return
    plain = json.loads(json.dumps(identity))
    difference = differences(read_table(recorded), plain)
    if difference:
        problem = f"{folder} holds another run: {difference}"
        cure = "give its options, or name another --out"
        raise refusal("command line", "--replay", number, problem, cure)


def read_laps(folder: Path) -> int | None:
    """Return the laps of the run in a folder, None where no run was completed there.

    Raises:
        ScenarioError: one line, for a damaged file.
    """
    path = folder / "metrics.json"
    if not os.path.exists(path) or not os.path.exists(folder / "identity.json"):
        return None
    laps = read_table(path).get("laps")
    if type(laps) is not int or laps < 0:
        raise refuse_file(path, "is damaged: it tells no number of laps")
    return laps


def _make_arrays(replayed: Lap) -> dict[str, Any]:
    """Return what NAME.npz holds."""
    trajectory = replayed.trajectory
    arrays = {
        "errors": trajectory.errors,
        "measured": trajectory.measured,
        "inputs": trajectory.inputs,
        "wheels": trajectory.wheels,
        "demanded": trajectory.demanded,
        "qp_status": trajectory.diagnostics.status,
        "disturbance": replayed.disturbance,
        "usage_of_E": replayed.of_error_set.share,
        "usage_of_W": replayed.of_disturbance_set.share,
    }
    if replayed.slips is not None:
        arrays["slip_deviations"] = replayed.slips
    return arrays


def text(design: Design, replayed: Lap) -> str:
    """Return what a lap used of E, W and the wheels, where, and how its QPs ended."""
    problem = design.problem
    errors = np.asarray(replayed.trajectory.errors)[1:]
    columns = [left(""), Column("largest"), Column("limit"), Column("used"), Column("at")]
    rows = [
        *_rows("e", problem.error_set, errors, problem),
        _whole_row("E", replayed.of_error_set, problem),
        *_rows("w", problem.disturbance_set, replayed.disturbance, problem),
        _whole_row("W", replayed.of_disturbance_set, problem),
    ]
    lines = [
        format_table(columns, rows),
        "",
        describe_error_set(problem),
        _say_how_often("E", replayed.of_error_set),
        _say_how_often("W", replayed.of_disturbance_set),
        *_say_wheels(problem, replayed),
        *_say_qps(replayed),
    ]
    return "\n".join(lines)


def _rows(
    letter: str, limits: Polytope, values: Float[np.ndarray, "steps 3"], problem: Problem
) -> list[list[str]]:
    """Return one row a coordinate: its largest value, its limit, the share used, and when."""
    widths = limits.support(np.eye(3))
    sizes = np.abs(values)
    rows = []
    for i, coordinate in enumerate(COORDINATES):
        step = int(np.argmax(sizes[:, i]))
        largest = sizes[step, i]
        rows.append(
            [
                f"{letter}_{coordinate.plain} [{coordinate.unit}]",
                f"{largest * coordinate.to_display:.5g}",
                f"{widths[i] * coordinate.to_display:.5g}",
                f"{largest / widths[i]:.2%}" if widths[i] else "-",
                _say_when(problem, step),
            ]
        )
    return rows


def _whole_row(name: str, usage: Usage, problem: Problem) -> list[str]:
    """Return the row of a set: by the facet that is used most."""
    step = int(np.argmax(usage.share))
    return [f"{name}, whole", "", "", f"{usage.share[step]:.2%}", _say_when(problem, step)]


def _say_when(problem: Problem, step: int) -> str:
    """Return the time at the end of a period, at which its error and its disturbance show."""
    return f"{(step + 1) * problem.reference.dt:.4g} s"


def _say_how_often(name: str, usage: Usage) -> str:
    return f"{name}: left in {np.sum(usage.outside)} of {len(usage.outside)} periods"


def _say_wheels(problem: Problem, replayed: Lap) -> list[str]:
    """Return one line on the wheels of a robot; none of a linear plant, which has none."""
    if replayed.slips is None:
        return []
    robot = problem.robot
    wheels = replayed.trajectory.wheels
    ranges = [
        f"{side} {wheels[:, i].min():.4g} to {wheels[:, i].max():.4g} m/s"
        for i, side in enumerate(WHEELS)
    ]
    saturated = int(np.sum(is_saturated(replayed.trajectory.demanded, wheels)))
    limits = f"{robot.wheel_speed_min:.4g} to {robot.wheel_speed_max:.4g} m/s"
    return [
        f"wheels: {', '.join(ranges)}; limits {limits}, reached in {saturated} of {len(wheels)} "
        "periods"
    ]


def _say_qps(replayed: Lap) -> list[str]:
    """Return one line on the QPs; none of a controller without."""
    if not replayed.plans:
        return []
    diagnostics = replayed.trajectory.diagnostics
    counts = [
        f"{int(np.sum(diagnostics.status == status))} {name}" for name, status in QP_STATUS.items()
    ]
    active = find_event("row_active").meaning
    backup = find_event("backup").meaning
    return [
        f"QPs: {', '.join(counts)}",
        f"periods in which {active}: {np.sum(diagnostics.active)}; in backup ({backup}): "
        f"{np.sum(diagnostics.backup)}",
    ]
