"""`maps`: what can be guaranteed, over slip error and speed range, over slip error and period, and
by the horizon."""

from __future__ import annotations

import hashlib
import json
import sys
from dataclasses import asdict

import numpy as np

from jaxtube.experiments.maps import feasible as maps_feasible
from jaxtube.experiments.maps import figures as maps_figures
from jaxtube.experiments.maps.figures import ratio_table
from jaxtube.experiments.maps.points import Found, Grid, Log, Point, compute, make_grid
from jaxtube.experiments.options import MapsOptions
from jaxtube.experiments.run import folder as run_folder
from jaxtube.experiments.run.folder import RunFolder
from jaxtube.experiments.run.table import Column, format_table, left
from jaxtube.scenario import Scenario, ScenarioError, to_toml
from jaxtube.synthesis.problem import make_problem
from jaxtube.synthesis.ratio import Guarantee

TITLES = {
    "paper": "the paper's weights, model and map",
    "weighted": "LMI gains, weights (1, 3, 1), 0.3",
    "optimised": "optimised caps and gains",
}


def run(scenario: Scenario, options: MapsOptions) -> int:
    """Run the command; an interrupted run goes on from the points in its folder.

    Raises: ScenarioError where the scenario has no caps, which two of the three designs need.
    """
    if scenario.operating.yaw_rate_deficit_radps is None:
        raise ScenarioError(
            "scenario: [operating] has no caps to compare designs under; choose --scenario certified, or copy what "
            "`design --optimise` prints"
        )
    problem = make_problem(scenario)
    grid = make_grid(scenario, float(problem.reference.wheels.min()), options.points)
    folder = run_folder.create(scenario, options)
    with open_log(folder, "points", {"grid": asdict(grid)}, scenario) as log:
        found = compute(scenario, grid, log)
    folder.save_figure(maps_figures.ratio_map(grid, found, "slowest_mps"), "ratio_speed")
    folder.save_figure(maps_figures.ratio_map(grid, found, "dt_s"), "ratio_period")
    metrics = {"grid": asdict(grid) | {"own": grid.own._asdict()}, "border": borders(grid, found)}
    metrics["points"] = [
        {
            "design": point.design,
            **point.condition._asdict(),
            **asdict(result),
            "holds": result.holds,
        }
        for point, result in sorted(found.items())
    ]
    folder.report(report(grid, metrics["border"], found))
    if options.feasible:
        with open_log(folder, "feasible", {}, scenario) as log:
            metrics["feasible"] = maps_feasible.feasible_sets(scenario, log)
        figure = maps_figures.feasible_figure(metrics["feasible"], problem.operating_set.vertices())
        folder.save_figure(figure, "feasible_set")
        folder.report(feasible_report(metrics["feasible"]))
    folder.save_metrics(metrics)
    print(f"\nwritten to {folder.path}/")
    return 0


def open_log(folder: RunFolder, name: str, settings: dict, scenario: Scenario) -> Log:
    """Open a log of results in a folder of its own for each scenario, settings and code."""
    identity = {
        "scenario": to_toml(scenario),
        "settings": settings,
        "source_sha256": run_folder.source_hashes(),
    }
    digest = hashlib.sha256(json.dumps(identity).encode()).hexdigest()[:12]
    log = Log(folder.path / f"{name}-{digest}", identity)
    for line in log.damaged:
        print(line, file=sys.stderr)
    return log


def borders(grid: Grid, found: Found) -> dict:
    """Return, by design, how far guarantees reach from the easy end of slip error, speed and
    period.

    `..._computed` is the last value of the grid with a guarantee, all easier ones having one too;
    `..._interpolated` where the ratio passes 1, linearly between grid values; None where not even
    the easiest value has one, and the end of the grid where all have one.
    """
    summary = {}
    for design in TITLES:
        at = grid.own
        errors = [found[Point(design, at._replace(slip_error=value))] for value in grid.slip_errors]
        speeds = [
            found[Point(design, at._replace(slowest_mps=value))] for value in grid.slowest_mps
        ]
        summary[design] = {}
        for name, values, results in (
            ("largest_slip_error", grid.slip_errors, errors),
            ("lowest_wheel_speed_mps", grid.slowest_mps[::-1], speeds[::-1]),
        ):
            computed, interpolated = _reach(values, results)
            summary[design] |= {f"{name}_computed": computed, f"{name}_interpolated": interpolated}
    return summary


def _reach(values, results: list[Guarantee]) -> tuple[float | None, float | None]:
    """Return the last value with a guarantee, and where the ratio passes 1 beyond it."""
    holding = [result.holds for result in results]
    count = holding.index(False) if False in holding else len(holding)
    if count == 0:
        return None, None
    last = values[count - 1]
    if count == len(values):
        return last, last
    before, after = results[count - 1].ratio, results[count].ratio
    # The wheels or the search may give up before the ratio passes 1: then nothing is known beyond
    # the last value.
    if after is None or after < 1:
        return last, last
    assert before is not None
    return last, float(np.interp(1.0, [before, after], [last, values[count]]))


def report(grid: Grid, border: dict, found: Found) -> str:
    """Return the borders of the three designs as a table."""
    own = grid.own
    columns = [
        left("guaranteed"),
        left(f"largest slip error from {own.slowest_mps:g} m/s on"),
        left(f"lowest wheel speed at {own.slip_error:.0%}"),
    ]
    rows = [_border_row(grid, border, found, design) for design in TITLES]
    counts = ", ".join(_count(found, design) for design in TITLES)
    failed = sum(result.ratio is None for result in found.values())
    lines = [
        format_table(columns, rows),
        f"points with a guarantee: {counts}; without any design: {failed}",
    ]
    for axis, values in (("slowest_mps", grid.slowest_mps), ("dt_s", grid.periods_s)):
        lines += ["", _ratios(grid, found, axis, values)]
    return "\n".join(lines)


def _border_row(grid: Grid, border: dict, found: Found, design: str) -> list[str]:
    row = border[design]
    error = _words(
        row["largest_slip_error_computed"], row["largest_slip_error_interpolated"], 100, "%"
    )
    slowest = _words(
        row["lowest_wheel_speed_mps_computed"], row["lowest_wheel_speed_mps_interpolated"], 1, "m/s"
    )
    condition = grid.own._replace(slip_error=grid.slip_errors[0])
    easiest = found[Point(design, condition)]
    if error == "none" and easiest.ratio is not None:
        error += f": ratio {easiest.ratio:.2f} without slip error"
    return [TITLES[design], error, slowest]


def _count(found: Found, design: str) -> str:
    results = [result for point, result in found.items() if point.design == design]
    return f"{sum(result.holds for result in results)} of {len(results)}"


def _words(computed: float | None, interpolated: float | None, scale: float, unit: str) -> str:
    if computed is None or interpolated is None:
        return "none"
    return f"{scale * computed:.4g} {unit} (border about {scale * interpolated:.3g} {unit})"


def _ratios(grid: Grid, found: Found, axis: str, values) -> str:
    """Return the ratios of the optimised design, values downwards and slip errors across."""
    name = {"slowest_mps": "from [m/s]", "dt_s": "period [s]"}[axis]
    columns = [Column(name), *(Column(f"{error:.3%}") for error in grid.slip_errors)]
    rows = []
    for value, ratios in zip(values, ratio_table(grid, found, "optimised", axis), strict=True):
        words = ["none" if np.isnan(ratio) else f"{ratio:.3f}" for ratio in ratios]
        rows.append([f"{value:.4g}", *words])
    return f"optimised: ratio by slip error\n{format_table(columns, rows)}"


def feasible_report(sets: dict) -> str:
    """Return the volumes of feasible sets as a table."""
    largest = sets["control_invariant"]
    whole = sets["operating_volume"]
    state = "settled" if largest["settled"] else "NOT settled"
    columns = [
        Column("horizon"),
        Column("of the caps"),
        Column("of the invariant set"),
        left("certified"),
    ]
    rows = [_feasible_row(record, largest["volume"], whole) for record in sets["horizons"]]
    return (
        f"\nlargest control invariant set: {largest['volume'] / whole:.1%} of the caps (bound from "
        f"outside, {state} after {largest['steps']} steps)\n{format_table(columns, rows)}"
    )


def _feasible_row(record: dict, largest: float, whole: float) -> list[str]:
    horizon = str(record["horizon"])
    if record["volume"] is None:
        return [horizon, "none", "", record["reason"]]
    of_largest = f"{record['volume'] / largest:.1%}" if largest else "-"
    certified = f"no: {', '.join(record['failing'])}" if record["failing"] else "yes"
    return [horizon, f"{record['volume'] / whole:.1%}", of_largest, certified]
