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

import numpy as np
from jaxtyping import Float
from scipy import stats

from jaxtube.experiments.run.folder import RunFolder
from jaxtube.experiments.tune import baselines as tune_baselines
from jaxtube.experiments.tune.baselines import GRADIENT, ComparedDesign, Spots, result_spot
from jaxtube.experiments.tune.comparison_figure import comparison_figure
from jaxtube.experiments.tune.front_figure import Group, Kind, front_figure
from jaxtube.experiments.tune.paths import Drives, drive_numbers, drive_paths, path_lines
from jaxtube.experiments.tune.result import (
    COMPARED_LAPS,
    Result,
    result_numbers,
    run_comparison,
)
from jaxtube.statistics.intervals import CONFIDENCE
from jaxtube.tuning.run import Log, Settings
from jaxtube.tuning.tune import Tuned


def run(folder: RunFolder, tuned: Tuned, log: Log, settings: Settings) -> dict:
    """Compare, print, draw, and return the numbers."""
    tuner = tuned.tuner
    assert tuned.best is not None
    best = tuned.best.point
    entries = make_entries(tuned, log, settings)
    grids = {
        name: tune_baselines.run_grid(tuner, log, kappa, name)
        for name, kappa in tune_baselines.grid_gains(tuner, best).items()
    }
    front = tune_baselines.tune_front(tuner, log, settings, best)
    paths = drive_paths(tuner.problem.scenario, entries)
    tuned_result = entries[1].result
    parts = [table(entries), grid_lines(tuned_result, grids), path_lines(paths)]
    folder.report("\n" + "\n\n".join("\n".join(lines) for lines in parts))
    groups = _groups(entries, grids, front)
    folder.save_figure(front_figure(groups, tuner.aim.effort_limit), "front")
    folder.save_figure(comparison_figure(_comparison_rows(paths)), "comparison")
    return {
        "designs": {entry.name: _entry_numbers(entry, tuned_result) for entry in entries},
        "grids": {name: spots._asdict() for name, spots in grids.items()},
        "front": front._asdict(),
        "paths": {path: drive_numbers(drives) for path, drives in paths.items()},
    }


def make_entries(tuned: Tuned, log: Log, settings: Settings) -> list[ComparedDesign]:
    """Return the designs of the comparison: start, tuned, and the baselines."""
    tuner = tuned.tuner
    assert tuned.best is not None
    start = tuner.parameters.vector
    best = tuned.best.point
    budget = GRADIENT * tuned.descent.outcome.evaluations
    return [
        ComparedDesign("start", tuner, start, run_comparison(tuner, start), 0, "start"),
        ComparedDesign("tuned", tuner, best, run_comparison(tuner, best), budget, "tuned"),
        *tune_baselines.tune_parts(tuner, log, settings),
        *tune_baselines.search_without_gradients(tuner, log, budget, tuner.seed),
        tune_baselines.search_static_lqr(tuner, log, budget, tuner.seed),
    ]


def table(entries: list[ComparedDesign]) -> list[str]:
    """Return the comparison as lines."""
    tuned = entries[1].result
    lines = [
        f"{COMPARED_LAPS} laps, the same draws for all; a lap's cost above the tuned one's, "
        "95 % interval over pairs;",
        f"a gradient counts for {GRADIENT} evaluations",
        f"  {'design':<20}{'evaluations':>12}{'lateral':>10}{'effort':>10}{'tube e_y':>10}"
        f"{'certified':>11}{'objective':>12}{'cost above the tuned':>30}",
    ]
    return [*lines, *(_table_line(entry, tuned) for entry in entries)]


def _table_line(entry: ComparedDesign, tuned: Result) -> str:
    result = entry.result
    width = "-" if result.half_widths is None else f"{100 * result.half_widths[1]:.2f} cm"
    objective = "-" if entry.static else f"{result.objective:.4f}"
    certified = "yes" if result.certified else "no"
    above = difference(result.costs, tuned.costs)
    return (
        f"  {entry.name:<20}{entry.evaluations:>12}{1e3 * result.rms(1):>7.3f} mm"
        f"{result.overall_effort:>10.5f}{width:>10}{certified:>11}{objective:>12}"
        f"{above['mean']:>12.4f} ({above['low']:.4f} to {above['high']:.4f})"
    )


def grid_lines(tuned: Result, grids: dict[str, Spots]) -> list[str]:
    """Return the best of each grid at no more effort than the tuned design."""
    lines = []
    for name, spots in grids.items():
        allowed = np.where(spots.effort <= tuned.overall_effort, spots.lateral, np.inf)
        best = int(np.argmin(allowed))
        lines.append(
            f"grid of {len(spots.lateral)} diagonal Q, R with {name}: at no more effort the least "
            f"lateral error is {1e3 * allowed[best]:.3f} mm at {spots.effort[best]:.5f} m/s; tuned "
            f"{1e3 * tuned.rms(1):.3f} mm at {tuned.overall_effort:.5f} m/s"
        )
    return lines


def _entry_numbers(entry: ComparedDesign, tuned: Result) -> dict:
    return {
        **result_numbers(entry.result),
        "evaluations": entry.evaluations,
        "cost_above_tuned": difference(entry.result.costs, tuned.costs),
    }


def _groups(entries: list[ComparedDesign], grids: dict[str, Spots], front: Spots) -> list[Group]:
    groups = [_group(entry.name, entry.kind, result_spot(entry.result)) for entry in entries]
    groups += [_group(f"grid, {name}", "grid", spots) for name, spots in grids.items()]
    return [*groups, _group("front", "front", front)]


def _group(name: str, kind: Kind, spots: Spots) -> Group:
    return Group(name, spots.lateral, spots.effort, spots.tube, spots.certified, kind)


def _comparison_rows(paths: dict[str, Drives]) -> list[tuple[str, str, float, float, float]]:
    """Return path, design and lateral RMS with its interval; the tuned design is drawn last."""
    rows = []
    for path, drives in paths.items():
        names = sorted(drives, key=lambda name: name == "tuned")
        rows += [(path, name, *rms_interval(drives[name].errors[:, 1])) for name in names]
    return rows


def difference(
    costs: Float[np.ndarray, " laps"], tuned: Float[np.ndarray, " laps"]
) -> dict[str, float]:
    """Return how much more a lap costs than with the tuned design, with the interval of the mean
    over pairs."""
    above = costs - tuned
    margin = _margin_of_mean(above) if above.any() else 0.0
    mean = above.mean()
    return {"mean": float(mean), "low": float(mean - margin), "high": float(mean + margin)}


def rms_interval(values: Float[np.ndarray, " laps"]) -> tuple[float, float, float]:
    """Return the RMS over laps with its 95 % interval."""
    squares = values**2
    mean = squares.mean()
    margin = _margin_of_mean(squares)
    low = max(mean - margin, 0.0)
    return float(np.sqrt(mean)), float(np.sqrt(low)), float(np.sqrt(mean + margin))


def _margin_of_mean(values: Float[np.ndarray, " laps"]) -> float:
    """Return the half width of the interval of a mean (Student)."""
    return stats.sem(values) * stats.t.ppf((1 + CONFIDENCE) / 2, len(values) - 1)
