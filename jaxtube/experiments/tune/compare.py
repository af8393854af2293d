"""`tune --compare`: the tuned design against other ways to spend evaluations, and on paths that
tuning never saw.

* Q and R alone, the gains alone: the same descent over fewer variables;
* random search and the adaptive simplex method over the same variables, a gradient counted as
  GRADIENT evaluations;
* static LQR gains, Q and R by random search;
* a full grid over diagonal Q and R, with the start's gains and with the tuned ones;
* a front: the descent again under other limits of effort and other weights of the tube, from the
  tuned design on.

Designs are compared on laps that none of them saw, pairs of laps under the same draws; a grid's
best is picked on such laps, in its favour, and the front shows the laps that chose its points.
Certificates of grids are not asked for.
"""

from __future__ import annotations

import dataclasses
import sys
from typing import NamedTuple

import msgspec
import numpy as np
from jaxtyping import Float
from scipy import stats

from jaxtube.experiments.options import Tune
from jaxtube.experiments.run.folder import RunFolder
from jaxtube.experiments.tune import baselines as tune_baselines
from jaxtube.experiments.tune.baselines import GRADIENT, Entry, Spots, spots_of, static_laps
from jaxtube.experiments.tune.front_figure import Group, Kind, comparison_figure, front_figure
from jaxtube.experiments.tune.log import Log
from jaxtube.experiments.tune.report import (
    COMPARED_LAPS,
    CONFIDENCE,
    Result,
    numbers_of,
    reduction,
    result,
)
from jaxtube.experiments.tune.run import Descent, Judgement, pooled
from jaxtube.plant.slipping import SlippingRobot
from jaxtube.scenario import Scenario, ScenarioError, experiments_folder
from jaxtube.scenario.tree import Reference
from jaxtube.simulation import closed_loop
from jaxtube.synthesis.disturbance import complete_problem
from jaxtube.synthesis.problem import Problem
from jaxtube.tuning.tuner import COMPARED, Tuner, certificate_lacks

PATH_LAPS = 512
RECORDED = experiments_folder() / "untuned" / "recorded.csv"
"""A drive with changes of speed and rounding, like what a positioning system records."""


def run(
    folder: RunFolder, tuner: Tuner, log: Log, options: Tune, descent: Descent, best: Judgement
) -> dict:
    """Compare, print, draw, and return the numbers."""
    budget = GRADIENT * descent.outcome.evaluations
    entries = [
        Entry(
            "start",
            tuner,
            tuner.parameters.vector,
            result(tuner, tuner.parameters.vector),
            0,
            "start",
        ),
        Entry("tuned", tuner, best.point, result(tuner, best.point), budget, "tuned"),
        *tune_baselines.alone(tuner, log, options),
        *tune_baselines.searched(tuner, log, budget, options.seed),
        tune_baselines.static_lqr(tuner, log, budget, options.seed),
    ]
    grids = {
        name: tune_baselines.grid(tuner, log, point, name)
        for name, point in tune_baselines.grid_gains(tuner, best.point).items()
    }
    front = tune_baselines.front(tuner, log, options, best.point)
    paths = _paths(tuner.problem.scenario, entries)
    print(
        "\n".join(
            ["", *table(entries), "", *grid_lines(entries[1].result, grids), "", *path_lines(paths)]
        )
    )
    groups = [_group(entry.name, entry.kind, spots_of([entry.result])) for entry in entries]
    groups += [_group(f"grid, {name}", "grid", spots) for name, spots in grids.items()]
    groups.append(_group("front", "front", front))
    folder.save_figure(front_figure(groups, tuner.aim.effort_limit), "front")
    rows = [
        (path, name, *rms_interval(found.errors[:, 1]))
        for path, designs in paths.items()
        for name, found in sorted(
            designs.items(), key=lambda item: item[0] == "tuned"
        )  # drawn last
    ]
    folder.save_figure(comparison_figure(rows), "comparison")
    tuned = entries[1].result
    return {
        "designs": {
            entry.name: numbers_of(entry.result)
            | {
                "evaluations": entry.evaluations,
                "cost_above_tuned": difference(entry.result.costs, tuned.costs),
            }
            for entry in entries
        },
        "grids": {name: spots._asdict() for name, spots in grids.items()},
        "front": front._asdict(),
        "paths": {
            path: {name: _numbers(found, designs["start"]) for name, found in designs.items()}
            for path, designs in paths.items()
        },
    }


class Drive(NamedTuple):
    """A design on one path: its laps, and what its certificate lacks there, None where nobody
    asked."""

    errors: Float[np.ndarray, "laps 3"]  # RMS once settled (m, m, rad)
    effort: Float[np.ndarray, " laps"]  # RMS, m/s
    failing: tuple[str, ...] | None


def _paths(scenario: Scenario, entries: list[Entry]) -> dict[str, dict[str, Drive]]:
    """Drive every design on the path of tuning and on those it never saw; start and tuned are
    certified for each."""
    found = {}
    for path, section in unseen_paths(scenario).items():
        try:
            problem = complete_problem(msgspec.structs.replace(scenario, reference=section))
        except ScenarioError as error:
            print(f"{path}: not driven ({error})", file=sys.stderr)
            continue
        robot = closed_loop.robot_of(problem)
        driven = {entry.name: _driven(entry, problem, robot) for entry in entries}
        designs = {name: drive for name, drive in driven.items() if drive is not None}
        if "start" in designs:
            found[path] = designs
    return found


def _driven(entry: Entry, problem: Problem, robot: SlippingRobot) -> Drive | None:
    tuner = dataclasses.replace(entry.tuner, problem=problem, plant=robot)
    if entry.static:
        laps, failing = static_laps(tuner, entry.point, COMPARED, PATH_LAPS), None
    else:
        played, ingredients = (
            tuner.played(entry.point, COMPARED, PATH_LAPS),
            tuner.designed(entry.point).ingredients,
        )
        if played is None or ingredients is None:
            return None  # an empty set on this path: no closed loop
        laps, failing = (
            played[1],
            certificate_lacks(ingredients) if entry.kind in ("start", "tuned") else None,
        )
    return Drive(laps.errors, laps.effort, failing)


def unseen_paths(scenario: Scenario) -> dict[str, Reference]:
    """Return the scenario's path, a lemniscate at its speed, and a recorded one, all within its box
    of wheel speeds."""
    own = scenario.reference
    lemniscate = msgspec.structs.replace(own, shape="lemniscate")
    recorded = msgspec.structs.replace(own, shape="file", file=str(RECORDED))
    return {"eight (tuned on)": own, "lemniscate": lemniscate, "recorded": recorded}


def table(entries: list[Entry]) -> list[str]:
    """Return the comparison as lines."""
    tuned = entries[1].result
    lines = [
        f"{COMPARED_LAPS} laps, the same draws for all; a lap's cost above the tuned one's, 95 % interval over pairs;",
        f"a gradient counts for {GRADIENT} evaluations",
        f"  {'design':<20}{'evaluations':>12}{'lateral':>10}{'effort':>10}{'tube e_y':>10}{'certified':>11}"
        f"{'objective':>12}{'cost above the tuned':>30}",
    ]
    for entry in entries:
        name, found, evaluations = entry.name, entry.result, entry.evaluations
        width = "-" if found.half_widths is None else f"{100 * found.half_widths[1]:.2f} cm"
        objective = "-" if entry.static else f"{found.objective:.4f}"
        above, low, high = difference(found.costs, tuned.costs).values()
        lines.append(
            f"  {name:<20}{evaluations:>12}{1e3 * found.rms(1):>7.3f} mm{found.overall_effort:>10.5f}{width:>10}"
            f"{'yes' if found.certified else 'no':>11}{objective:>12}{above:>12.4f} ({low:.4f} to {high:.4f})"
        )
    return lines


def grid_lines(tuned: Result, grids: dict[str, Spots]) -> list[str]:
    """Return the best of each grid at no more effort than the tuned design."""
    lines = []
    for name, spots in grids.items():
        allowed = np.where(spots.effort <= tuned.overall_effort, spots.lateral, np.inf)
        best = int(np.argmin(allowed))
        lines.append(
            f"grid of {len(spots.lateral)} diagonal Q, R with {name}: at no more effort the least lateral error is "
            f"{1e3 * allowed[best]:.3f} mm at {spots.effort[best]:.5f} m/s; tuned {1e3 * tuned.rms(1):.3f} mm at "
            f"{tuned.overall_effort:.5f} m/s"
        )
    return lines


def path_lines(paths: dict[str, dict[str, Drive]]) -> list[str]:
    """Return what the designs do on each path."""
    lines = [
        f"{PATH_LAPS} laps on each path: lateral error once settled, RMS, against the start's with 95 % interval"
    ]
    for path, designs in paths.items():
        lines.append(f"  {path}")
        for name, found in designs.items():
            fall, low, high = reduction(designs["start"].errors[:, 1], found.errors[:, 1])
            less = f"{fall:.1%} less ({low:.1%} to {high:.1%})" if name != "start" else ""
            state = {None: "", (): "certified"}.get(
                found.failing, f"not certified ({', '.join(found.failing or ())})"
            )
            lateral, effort = 1e3 * pooled(found.errors[:, 1]), pooled(found.effort)
            lines.append(f"    {name:<20}{lateral:>7.3f} mm{effort:>10.5f} m/s   {less:<32}{state}")
    return lines


def _numbers(found: Drive, start: Drive) -> dict:
    fall = reduction(start.errors[:, 1], found.errors[:, 1])
    return {
        "lateral_m": pooled(found.errors[:, 1]),
        "effort_mps": pooled(found.effort),
        "lateral_reduction": dict(zip(("share", "low", "high"), fall, strict=True)),
        "certified": None if found.failing is None else not found.failing,
        "failing": list(found.failing or ()),
    }


def difference(
    costs: Float[np.ndarray, " laps"], tuned: Float[np.ndarray, " laps"]
) -> dict[str, float]:
    """Return how much more a lap costs than with the tuned design, with the interval of the mean
    over pairs."""
    above = costs - tuned
    margin = (
        stats.sem(above) * stats.t.ppf((1 + CONFIDENCE) / 2, len(above) - 1) if above.any() else 0.0
    )
    return {
        "mean": float(above.mean()),
        "low": float(above.mean() - margin),
        "high": float(above.mean() + margin),
    }


def rms_interval(values: Float[np.ndarray, " laps"]) -> tuple[float, float, float]:
    """Return the RMS over laps with its 95 % interval."""
    squares = values**2
    margin = stats.sem(squares) * stats.t.ppf((1 + CONFIDENCE) / 2, len(squares) - 1)
    low, high = max(squares.mean() - margin, 0.0), squares.mean() + margin
    return float(np.sqrt(squares.mean())), float(np.sqrt(low)), float(np.sqrt(high))


def _group(name: str, kind: Kind, spots: Spots) -> Group:
    return Group(name, spots.lateral, spots.effort, spots.tube, spots.certified, kind)
