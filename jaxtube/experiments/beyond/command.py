"""`beyond`: how far a robot may be from what its certificate assumes before W, and before the
limits, are left.

For each imperfection of `jaxtube.plant.imperfect` the level is doubled until a lap fails, then
halved towards the first level at which one does; the same for the first w outside W. Every level
meets the same draws: laps under four slip processes, from the scenario's start. A lap that fails is
a fact; that none fails at a level proves nothing.
"""

from __future__ import annotations

import numpy as np

from jaxtube.experiments.beyond import figures as beyond_figures
from jaxtube.experiments.beyond.laps import ImperfectLaps, LapUsage
from jaxtube.experiments.beyond.search import (
    IMPERFECTIONS,
    Imperfection,
    LevelSearch,
    levels,
    most_tried,
    search,
)
from jaxtube.experiments.options import BeyondOptions
from jaxtube.experiments.run import folder as run_folder
from jaxtube.experiments.run.design_page import certificate_section
from jaxtube.experiments.run.designing import make_design
from jaxtube.experiments.run.page_table import make_table
from jaxtube.experiments.run.table import Column, format_table, left, wrap
from jaxtube.plant.slip_processes import TEST_PROCESSES
from jaxtube.progress import announce, progress
from jaxtube.reporting.page import Page, Section
from jaxtube.scenario.refusal import ScenarioError
from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.design import refuse_infeasible_start
from jaxtube.synthesis.parts import Design

COLUMNS = (
    left("imperfection"),
    Column("first w outside W"),
    Column("first violation"),
    left("unit"),
    left("violated"),
)


def run(scenario: Scenario, options: BeyondOptions) -> int:
    """Run the command.

    Raises:
        ScenarioError: where the robot's own wheels lag, whose controller is not asked what another
            lag would do to it.
    """
    _refuse_lag(scenario)
    announce("designing: sets, gains and certificate")
    design = make_design(scenario, options)
    refuse_infeasible_start(design)
    folder = run_folder.create(scenario, options)
    laps = ImperfectLaps(design, options.realisations, options.seed)
    searches = search_all(laps, design.problem.horizon)
    folder.save_metrics(metrics(searches, options.realisations))
    folder.save_figure(beyond_figures.usages(panels(searches)), "beyond")
    folder.report(table(searches, options.realisations))
    folder.save_page(make_page(searches, options.realisations, design))
    print(f"\nwritten to {folder.path}/")
    return 0


def _refuse_lag(scenario: Scenario) -> None:
    for key in ("wheel_lag_s", "command_delay_s"):
        interval = getattr(scenario.robot, key)
        if interval[1] > 0:
            raise ScenarioError(
                f"scenario: robot.{key} = {list(interval)}: `beyond` adds lag and delay to a robot "
                "that is certified without; widen the interval and `design` it, or leave it out"
            )


def search_all(laps: ImperfectLaps, horizon: int) -> dict[str, LevelSearch]:
    """Search the first levels of every imperfection."""
    planned = {name: levels(kind, horizon) for name, kind in IMPERFECTIONS.items()}
    most = {name: most_tried(planned[name], kind.whole) for name, kind in IMPERFECTIONS.items()}
    searches = {}
    with progress(sum(most.values()), "driving", "levels") as bar:
        for name, kind in IMPERFECTIONS.items():
            searches[name] = search(laps.at(name, bar.update), planned[name], kind.whole)
            bar.total -= most[name] - len(searches[name].usages)
    return searches


def metrics(searches: dict[str, LevelSearch], realisations: int) -> dict:
    """Return what was found, by imperfection; a level that was not found is null."""
    by_imperfection = {name: _metrics(IMPERFECTIONS[name], searches[name]) for name in searches}
    return {
        "laps_at_a_level": realisations * len(TEST_PROCESSES),
        "processes": TEST_PROCESSES,
        **by_imperfection,
    }


def _metrics(imperfection: Imperfection, search: LevelSearch) -> dict:
    key = imperfection.key
    return {
        f"first_w_outside_W_{key}": search.disturbance,
        f"first_violation_{key}": search.violation,
        "violated": _violations(search),
        f"greatest_tried_{key}": max(search.usages),
        "levels": [{key: level} | _largest(usage) for level, usage in search.usages.items()],
    }


def _violations(search: LevelSearch) -> list[str]:
    """Return what was violated at the first level with a violation."""
    return [] if search.violation is None else search.usages[search.violation].violations


def _largest(usage: LapUsage) -> dict:
    """Return the largest usage over the slip processes."""
    return {
        "usage_of_E": usage.error.max(axis=0),
        "usage_of_W": usage.disturbance.max(),
        "usage_of_wheel_speeds": usage.wheels.max(),
        "periods_without_plan": usage.without_plan.max(),
    }


def panels(searches: dict[str, LevelSearch]) -> list[beyond_figures.Panel]:
    """Return what the figure shows of the searches."""
    return [_make_panel(name, search) for name, search in searches.items()]


def _make_panel(name: str, search: LevelSearch) -> beyond_figures.Panel:
    imperfection = IMPERFECTIONS[name]
    usages = search.usages.values()
    return beyond_figures.Panel(
        name=name,
        title=imperfection.title,
        whole=imperfection.whole,
        levels=np.array(list(search.usages)),
        error=np.array([usage.error.max(axis=0) for usage in usages]),
        disturbance=np.array([usage.disturbance.max() for usage in usages]),
        violation=search.violation,
    )


def table(searches: dict[str, LevelSearch], realisations: int) -> str:
    """Return what was found as a table."""
    note = wrap(
        "Violation: a limit of errors, inputs or wheels is left, or there is no plan. First: the "
        f"least level at which a lap did. {realisations:,} laps of each slip process: "
        f"{', '.join(TEST_PROCESSES)}; in parentheses: those under which a limit is violated at "
        "that level. A limit of acceleration is 1 / level."
    )
    cells = format_table(COLUMNS, _rows(searches))
    return "\n".join([say_verdict(searches), "", cells, "", *note])


def say_verdict(searches: dict[str, LevelSearch]) -> str:
    """Return one line: how many imperfections were too much."""
    violated = sum(search.violation is not None for search in searches.values())
    left_w = sum(search.disturbance is not None for search in searches.values())
    return (
        f"of {len(searches)} imperfections {violated} violate a limit as far as tried; {left_w} "
        "drive w out of W"
    )


def make_page(searches: dict[str, LevelSearch], realisations: int, design: Design) -> Page:
    """Return the page of the searches."""
    violated = [
        IMPERFECTIONS[name].title for name in searches if searches[name].violation is not None
    ]
    note = (
        f"{realisations:,} laps of each slip process at each level: {', '.join(TEST_PROCESSES)}; "
        "in parentheses those under which a limit is violated. A limit of acceleration is "
        "1 / level. No violation in laps is no proof."
    )
    lead = ["The certificate covers none of these imperfections."]
    if violated:
        lead.append(f"A limit is violated by: {'; '.join(violated)}.")
    return Page(
        say_verdict(searches),
        lead=lead,
        sections=[
            Section("First levels", [make_table(COLUMNS, _rows(searches), note=note)]),
            certificate_section(design.certificate),
        ],
        not_covered=design.certificate.assumptions,
    )


def _rows(searches: dict[str, LevelSearch]) -> list[list[str]]:
    return [_row(IMPERFECTIONS[name], search) for name, search in searches.items()]


def _row(imperfection: Imperfection, search: LevelSearch) -> list[str]:
    return [
        imperfection.title,
        _say_level(search.disturbance, search.most),
        _say_level(search.violation, search.most),
        imperfection.unit,
        "; ".join(_violations(search)) or "nothing",
    ]


def _say_level(level: float | None, most: float) -> str:
    return f"none to {most:g}" if level is None else f"{level:.3g}"
