"""`bench gradient`: its table and its metrics.

Source: new.
"""

from __future__ import annotations

from jaxtube.experiments.bench import gradients
from jaxtube.experiments.bench.cases import name_scenarios
from jaxtube.experiments.bench.gradients import FULL, QUICK, GradientResult
from jaxtube.experiments.bench.pinned import run_pinned
from jaxtube.experiments.bench.rounds import Spread, spread, write_number
from jaxtube.experiments.bench.topic import Headline, Told, Topic, describe, say_verdict
from jaxtube.experiments.options import BenchOptions
from jaxtube.experiments.run.folder import RunFolder
from jaxtube.experiments.run.table import Column, format_table, left, wrap
from jaxtube.scenario.refusal import ScenarioError
from jaxtube.scenario.tree import Scenario

USUAL = ("certified", "tuned")
COLUMNS = [
    left("laps"),
    Column("value", "s"),
    Column("value and\ngradient", "s"),
    Column("ratio"),
    Column("memory of\nthe value", "MiB"),
    Column("with\ngradient", "MiB"),
]


def run(scenario: Scenario, options: BenchOptions, folder: RunFolder) -> Told:
    """Measure and print the table."""
    scenarios = name_scenarios(scenario, options, USUAL)
    refuse_gains_of_a_search(scenarios)
    extent = QUICK if options.quick else FULL
    results = run_pinned(1, gradients.measure, scenarios, options.seed, extent)
    told = headlines(results)
    folder.report(f"{say_verdict(told)}\n")
    folder.report(f"{write_table(results)}\n\n{write_notes(results)}")
    found = {result.scenario: metrics(result) for result in results}
    return Told(found, told)


TOPIC = Topic(
    "compiles the tuning objective of two scenarios and its gradient, and runs both in turn: about "
    "three minutes",
    run,
)


def refuse_gains_of_a_search(scenarios: list[tuple[str, Scenario]]) -> None:
    """Raise ScenarioError where the gains are no numbers of the scenario: nothing to tune."""
    for name, scenario in scenarios:
        settings = scenario.controller
        if not (len(settings.tracking_gains) or len(settings.vertex_gains)):
            raise ScenarioError(
                f"{name}: controller.tracking_gains is empty: the tuning objective needs gains; "
                "name a scenario that has them, such as certified"
            )


def write_table(results: list[GradientResult]) -> str:
    """Return times and memory as a table."""
    rows = []
    for result in results:
        memory = [f"{result.memory[kind] / 2**20:,.0f}" for kind in ("value", "both")]
        for start, ratio in ratios(result).items():
            value = spread(result.value[start])
            both = spread(result.both[start])
            numbers = [write_number(value.median), write_number(both.median), str(ratio)]
            rows.append([f"{result.scenario}, {start}", *numbers, *memory])
    return format_table(COLUMNS, rows)


def ratios(result: GradientResult) -> dict[str, Spread]:
    """Return value and gradient over the value, round by round, by starts."""
    return {start: spread(result.both[start] / result.value[start]) for start in result.value}


def write_notes(results: list[GradientResult]) -> str:
    """Say what the numbers are."""
    text = (
        f"The tuning objective of {results[0].laps:,} whole laps and its gradient in "
        f"{results[0].parameters} weights and gains, on one thread: medians of rounds in which "
        "all of a scenario's had their turn, in brackets quartiles. Laps start where the scenario "
        "does, or all over the edge of the feasible set. Memory: of a program beside its arguments."
    )
    return "\n".join(wrap(text))


def metrics(result: GradientResult) -> dict:
    """Return what was measured of an objective."""
    found: dict = {
        "laps": result.laps,
        "parameters": result.parameters,
        "memory_bytes": result.memory,
    }
    for start, ratio in ratios(result).items():
        found[f"from_{start}"] = {
            "value_s": describe(spread(result.value[start])),
            "value_and_gradient_s": describe(spread(result.both[start])),
            "value_and_gradient_over_value": describe(ratio),
        }
    return found


def headlines(results: list[GradientResult]) -> list[Headline]:
    """Return what the table of all topics shows."""
    lines = []
    for result in results:
        for start, ratio in ratios(result).items():
            lines.append(
                Headline(
                    what=f"gradient, {result.scenario} from {start}",
                    ours=f"{write_number(spread(result.both[start]).median)} s with gradient",
                    peer=f"{write_number(spread(result.value[start]).median)} s without",
                    ratio=str(ratio),
                )
            )
    return lines
