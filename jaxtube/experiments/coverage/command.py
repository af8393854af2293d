"""`coverage`: how much of what any controller could keep has a plan, by the horizon, and what a
step costs."""

from __future__ import annotations

from jaxtube.experiments.coverage import figures, report
from jaxtube.experiments.coverage.measure import Extent, measure
from jaxtube.experiments.options import CoverageOptions
from jaxtube.experiments.run import folder as run_folder
from jaxtube.experiments.run.value_log import open_log
from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.problem import make_problem


def run(scenario: Scenario, options: CoverageOptions) -> int:
    """Run the command; an interrupted run goes on from the horizons in its folder."""
    folder = run_folder.create(scenario, options)
    extent = Extent(options.horizon_values, options.seed)
    with open_log(folder, "horizons", {"seed": options.seed}, scenario) as log:
        sets = measure(scenario, extent, log)
    corners = make_problem(scenario).operating_set.vertices()
    folder.save_figure(figures.draw_coverage(sets, corners), "coverage")
    folder.report(report.write(sets))
    folder.save_metrics({"coverage": sets})
    folder.save_page(report.make_page(sets))
    print(f"\nwritten to {folder.path}/")
    return 0
