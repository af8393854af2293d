"""`montecarlo --replay LAP`: one lap of a run again, drawn, saved, and what it used of E, W and the
wheels in words."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from jaxtube import qp
from jaxtube.experiments.options import MontecarloOptions
from jaxtube.experiments.run.folder import RunFolder, unwritable
from jaxtube.experiments.run.metrics import TO_DISPLAY
from jaxtube.experiments.run.record_file import differences
from jaxtube.scenario.refusal import refusal
from jaxtube.statistics.lap import Lap, lap
from jaxtube.statistics.montecarlo import make_closed_loop_task, name_law
from jaxtube.synthesis.design import Design
from jaxtube.synthesis.problem import Problem

WHEELS = ("right", "left")


def run(design: Design, options: MontecarloOptions, identity: dict[str, Any]) -> int:
    """Draw lap `options.replay` into the run's folder, beside what is there, and print what it
    used.

    Raises: ScenarioError where the number is none of a lap, the folder holds a run of another
        identity, or it cannot be made or written to.
    """
    from jaxtube.experiments.montecarlo import lap_figure

    number = options.replay
    assert number is not None
    folder = RunFolder(options.folder)
    name = f"replay-{number}"
    refuse_another_run(folder.path, number, identity)
    try:
        folder.path.mkdir(parents=True, exist_ok=True)
        task = make_closed_loop_task(
            design, options.controller, options.plant, options.starts, None, options.seed
        )
        found = lap(design, task, options.seed, number)
        folder.save_arrays(name, **_arrays(found))
        folder.save_figure(lap_figure.draw(design.problem, found), name)
    except OSError as error:
        raise unwritable(folder.path, error) from None
    law = name_law(design, options.controller, options.plant, options.starts)
    words = law.describe(design.problem.scenario)
    title = f"lap {number:,}; law: {words}; seed {options.seed}"
    folder.report(f"{title}\n\n{text(design, found)}", name)
    laps = recorded_laps(folder.path)
    if laps is not None and number >= laps:
        print(f"\nlap {number:,} is beyond the run in {folder.path}/, which has {laps:,} laps")
    print(f"\n{name}.png, {name}.pdf, {name}.npz and {name}.txt are in {folder.path}/")
    return 0


def refuse_another_run(folder: Path, number: int, identity: dict[str, Any]) -> None:
    """Raise ScenarioError where the folder holds a run of another identity."""
    recorded = folder / "identity.json"
    if not recorded.exists():
        return
    difference = differences(json.loads(recorded.read_text()), json.loads(json.dumps(identity)))
    if difference:
        problem = f"{folder} holds another run: {difference}"
        cure = "give its options, or name another --out"
        raise refusal("command line", "--replay", number, problem, cure)


def recorded_laps(folder: Path) -> int | None:
    """Return the laps of the run in a folder, None where no run was completed there."""
    path = folder / "metrics.json"
    if not path.exists() or not (folder / "identity.json").exists():
        return None
    return json.loads(path.read_text())["laps"]


def _arrays(found: Lap) -> dict[str, Any]:
    trajectory = found.trajectory
    names = ("errors", "measured", "inputs", "wheels", "demanded")
    arrays = {name: getattr(trajectory, name) for name in names} | {
        "qp_status": trajectory.diagnostics.status
    }
    arrays |= {"disturbance": found.disturbance}
    arrays |= {"usage_of_E": found.of_error_set.share, "usage_of_W": found.of_disturbance_set.share}
    return arrays if found.slips is None else arrays | {"slip_deviations": found.slips}


def text(design: Design, found: Lap) -> str:
    """Return what a lap used of E, W and the wheels, where, and how its QPs ended."""
    problem = design.problem
    lines = [f"{'':<12}{'largest':>12}{'limit':>12}{'used':>11}{'at':>10}"]
    for letter, limits, values, usage in (
        ("e", problem.error_set, found.trajectory.errors[1:], found.of_error_set),
        ("w", problem.disturbance_set, found.disturbance, found.of_disturbance_set),
    ):
        widths, sizes = limits.support(np.eye(3)), np.abs(values)
        for i, name in enumerate(("x [m]", "y [m]", "th [deg]")):
            step, scale = int(np.argmax(sizes[:, i])), TO_DISPLAY[i]
            used = f"{sizes[step, i] / widths[i]:.2%}" if widths[i] else "-"
            numbers = f"{sizes[step, i] * scale:>12.5g}{widths[i] * scale:>12.5g}{used:>11}"
            lines.append(f"{f'{letter}_{name}':<12}{numbers}{_seconds(problem, step):>10}")
        name, step = {"e": "E", "w": "W"}[letter], int(np.argmax(usage.share))
        left = f"left in {np.sum(usage.outside)} of {len(usage.outside)} periods"
        lines.append(
            f"{name + ', whole':<12}{'':>24}{usage.share[step]:>11.2%}{_seconds(problem, step):>10}   {left}"
        )
    return "\n".join([*lines, "", *_wheels(problem, found), *_planning(found)])


def _seconds(problem: Problem, step: int) -> str:
    """Return the time at the end of a period, at which its error and its disturbance show."""
    return f"{(step + 1) * problem.reference.dt:.4g} s"


def _wheels(problem: Problem, found: Lap) -> list[str]:
    if found.slips is None:
        return []
    wheels, robot = found.trajectory.wheels, problem.robot
    ranges = [
        f"{side} {wheels[:, i].min():.4g} to {wheels[:, i].max():.4g} m/s"
        for i, side in enumerate(WHEELS)
    ]
    saturated = int(np.sum(np.any(found.trajectory.demanded != wheels, axis=1)))
    limits = f"{robot.wheel_speed_min:.4g} to {robot.wheel_speed_max:.4g} m/s"
    return [
        f"wheels: {', '.join(ranges)}; limits {limits}, reached in {saturated} of {len(wheels)} periods"
    ]


def _planning(found: Lap) -> list[str]:
    if not found.plans:
        return []
    diagnostics = found.trajectory.diagnostics
    kinds = {"solved": qp.SOLVED, "infeasible": qp.INFEASIBLE, "unsolved": qp.UNSOLVED}
    counts = [f"{int(np.sum(diagnostics.status == kind))} {name}" for name, kind in kinds.items()]
    others = f"some row active in {np.sum(diagnostics.active)}, backup in use in {np.sum(diagnostics.backup)}"
    return [f"QPs: {', '.join(counts)}; {others}"]
