"""`maps`: what can be guaranteed, over slip error and speed range, and over slip error and period.

The ratio of a design is the largest share of a cap that its tube fills at its widest: below 1 there
is a guarantee.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import NamedTuple

import numpy as np

from jaxtube.experiments.coverage import command as coverage
from jaxtube.experiments.maps import figures as maps_figures
from jaxtube.experiments.maps.figures import ratio_table
from jaxtube.experiments.maps.points import (
    Grid,
    GuaranteeByPoint,
    Point,
    compute,
    make_grid,
)
from jaxtube.experiments.options import CoverageOptions, MapsOptions
from jaxtube.experiments.run import folder as run_folder
from jaxtube.experiments.run.page_table import make_table
from jaxtube.experiments.run.table import Column, format_table, left
from jaxtube.experiments.run.value_log import open_log
from jaxtube.progress import announce
from jaxtube.reporting.page import Page, Section
from jaxtube.scenario.refusal import ScenarioError
from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.problem import make_problem
from jaxtube.synthesis.ratio import Guarantee, OperatingPoint, name_slip_error

TITLES = {
    "paper": "the paper's weights, model and map",
    "weighted": "LMI gains, weights (1, 3, 1), 0.3",
    "optimised": "optimised caps and gains",
}


RATIO = "ratio: largest share of a cap that the widest tube fills; a guarantee needs less than 1"


def run(scenario: Scenario, options: MapsOptions) -> int:
    """Run the command; an interrupted run goes on from the points in its folder.

    Raises:
        ScenarioError: where the scenario has no caps, which two of the three designs need, or caps
            by speed, which none of them knows.
    """
    if scenario.operating.bands:
        raise ScenarioError(
            "scenario: operating.bands: maps compares designs of one gain and one set of caps, not "
            "of several by speed; choose --scenario certified, or leave out the bands"
        )
    if scenario.operating.yaw_rate_deficit_radps is None:
        raise ScenarioError(
            "scenario: [operating] has no caps to compare designs under; choose --scenario "
            "certified, or copy what `design --optimise` prints"
        )
    announce("reading the path and its wheel speeds")
    problem = make_problem(scenario)
    grid = make_grid(scenario, float(problem.reference.wheels.min()), options.points)
    folder = run_folder.create(scenario, options)
    with open_log(folder, "points", {"grid": asdict(grid)}, scenario) as log:
        results = compute(scenario, grid, log)
    slip_error = name_slip_error(scenario)
    folder.save_figure(
        maps_figures.ratio_map(grid, results, "slowest_mps", slip_error), "ratio_speed"
    )
    folder.save_figure(maps_figures.ratio_map(grid, results, "dt_s", slip_error), "ratio_period")
    border = find_borders(grid, results)
    folder.report(report(grid, border, results, slip_error))
    metrics = {
        "grid": asdict(grid) | {"own": grid.own._asdict()},
        "slip_error_is": slip_error,
        "border": border,
        "points": [_point_metrics(*item) for item in sorted(results.items())],
    }
    folder.save_metrics(metrics)
    folder.save_page(make_page(grid, border, results, slip_error))
    print(f"\nwritten to {folder.path}/")
    if options.feasible:
        announce("--feasible is deprecated: use the command `coverage`, which runs now")
        return coverage.run(scenario, CoverageOptions(options.scenario, seed=options.seed))
    return 0


def _point_metrics(point: Point, result: Guarantee) -> dict:
    return {
        "design": point.design,
        **point.operating_point._asdict(),
        **asdict(result),
        "holds": result.holds,
    }


def find_borders(grid: Grid, results: GuaranteeByPoint) -> dict:
    """Return, by design, how far guarantees reach from the easy end of slip error and speed.

    `..._computed` is the last value of the grid with a guarantee, all easier ones having one too;
    `..._interpolated` where the ratio passes 1, linearly between grid values; None where not even
    the easiest value has one, and the end of the grid where all have one.
    """
    borders = {}
    errors = [grid.own._replace(slip_error=error) for error in grid.slip_errors]
    speeds = [grid.own._replace(slowest_mps=speed) for speed in reversed(grid.slowest_mps)]
    for design in TITLES:
        error = _find_border(design, errors, "slip_error", results)
        speed = _find_border(design, speeds, "slowest_mps", results)
        borders[design] = {
            "largest_slip_error_computed": error.computed,
            "largest_slip_error_interpolated": error.interpolated,
            "lowest_wheel_speed_mps_computed": speed.computed,
            "lowest_wheel_speed_mps_interpolated": speed.interpolated,
        }
    return borders


class Border(NamedTuple):
    """The last value with a guarantee, and where the ratio passes 1 beyond it; None where no value
    has one."""

    computed: float | None
    interpolated: float | None


def _find_border(
    design: str, operating_points: list[OperatingPoint], name: str, results: GuaranteeByPoint
) -> Border:
    """Return the border of a design along operating points, the easiest one first."""
    values = [getattr(point, name) for point in operating_points]
    return interpolate([results[Point(design, point)] for point in operating_points], values)


def interpolate(results: list[Guarantee], values: list[float]) -> Border:
    """Return the border of the guarantees among values, the easiest one first."""
    holding = [result.holds for result in results]
    count = holding.index(False) if False in holding else len(holding)
    if count == 0:
        return Border(None, None)
    last = values[count - 1]
    if count == len(values):
        return Border(last, last)
    before = results[count - 1].ratio
    after = results[count].ratio
    # The wheels or the search may give up before the ratio passes 1: then nothing is known beyond
    # the last value.
    if before is None or after is None or after < 1:
        return Border(last, last)
    return Border(last, float(np.interp(1.0, [before, after], [last, values[count]])))


def make_page(grid: Grid, borders: dict, results: GuaranteeByPoint, slip_error: str) -> Page:
    """Return the page of the maps."""
    rows = [_border_row(grid, borders[design], results, design) for design in TITLES]
    table = make_table(_border_columns(grid, slip_error), rows, note=f"{RATIO}.")
    section = Section("How far guarantees reach", [table])
    return Page(say_verdict(results), sections=[section])


def _border_columns(grid: Grid, slip_error: str) -> list[Column]:
    own = grid.own
    return [
        left("guaranteed"),
        left(f"largest {slip_error} from {own.slowest_mps:g} m/s on"),
        left(f"lowest wheel speed at {100 * own.slip_error:.4g}%"),
    ]


def report(grid: Grid, borders: dict, results: GuaranteeByPoint, slip_error: str) -> str:
    """Return the borders of the three designs, and the ratios of the optimised one."""
    columns = _border_columns(grid, slip_error)
    rows = [_border_row(grid, borders[design], results, design) for design in TITLES]
    failed = sum(result.ratio is None for result in results.values())
    lines = [
        say_verdict(results),
        "",
        format_table(columns, rows),
        f"points without any design: {failed}",
        RATIO,
    ]
    for axis, values in (("slowest_mps", grid.slowest_mps), ("dt_s", grid.periods_s)):
        lines += ["", _format_ratios(grid, results, axis, values, slip_error)]
    return "\n".join(lines)


def say_verdict(results: GuaranteeByPoint) -> str:
    """Return one line: at how many points each of the three designs has a guarantee."""
    names = {"optimised": "optimised", "weighted": "with LMI gains", "paper": "the paper's way"}
    counts = [f"{words}, {_count(results, design)}" for design, words in names.items()]
    return f"points with a guarantee: {'; '.join(counts)}"


def _border_row(grid: Grid, border: dict, results: GuaranteeByPoint, design: str) -> list[str]:
    error = Border(border["largest_slip_error_computed"], border["largest_slip_error_interpolated"])
    speed = Border(
        border["lowest_wheel_speed_mps_computed"], border["lowest_wheel_speed_mps_interpolated"]
    )
    largest = _say_where(error, 100, "%")
    without_error = grid.own._replace(slip_error=grid.slip_errors[0])
    easiest = results[Point(design, without_error)]
    if error.computed is None and easiest.ratio is not None:
        largest += f": ratio {easiest.ratio:.2f} without slip error"
    return [TITLES[design], largest, _say_where(speed, 1, "m/s")]


def _count(results: GuaranteeByPoint, design: str) -> str:
    of_design = [result for point, result in results.items() if point.design == design]
    return f"{sum(result.holds for result in of_design)} of {len(of_design)}"


def _say_where(border: Border, scale: float, unit: str) -> str:
    if border.computed is None or border.interpolated is None:
        return "none"
    return (
        f"{scale * border.computed:.4g} {unit} "
        f"(border about {scale * border.interpolated:.3g} {unit})"
    )


def _format_ratios(
    grid: Grid, results: GuaranteeByPoint, axis: str, values: Sequence[float], slip_error: str
) -> str:
    """Return the ratios of the optimised design, values downwards and slip errors across."""
    name = {"slowest_mps": "from [m/s]", "dt_s": "period [s]"}[axis]
    columns = [Column(name), *(Column(f"{error:.3%}") for error in grid.slip_errors)]
    rows = []
    for value, ratios in zip(values, ratio_table(grid, results, "optimised", axis), strict=True):
        words = ["none" if np.isnan(ratio) else f"{ratio:.3f}" for ratio in ratios]
        rows.append([f"{value:.4g}", *words])
    return f"{TITLES['optimised']}: ratio by {slip_error}\n{format_table(columns, rows)}"
