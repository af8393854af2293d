"""`bench`: how fast programs, laps, gradients, designs and single steps are, beside their peers; or
laps on one GPU."""

from __future__ import annotations

from collections.abc import Sequence

from jaxtube.experiments.bench import (
    design_topic,
    gpu,
    gradient_topic,
    latency_topic,
    loop_topic,
    qp_topic,
    scale_topic,
)
from jaxtube.experiments.bench.topic import Headline, Topic, say_verdict
from jaxtube.experiments.options import BenchOptions
from jaxtube.experiments.run import folder as run_folder
from jaxtube.experiments.run.page_table import make_table
from jaxtube.experiments.run.table import Column, format_table, left
from jaxtube.progress import announce
from jaxtube.reporting.page import Page, Section
from jaxtube.scenario.tree import Scenario

TOPICS: dict[str, Topic] = {
    "qp": qp_topic.TOPIC,
    "loop": loop_topic.TOPIC,
    "design": design_topic.TOPIC,
    "gradient": gradient_topic.TOPIC,
    "scale": scale_topic.TOPIC,
    "latency": latency_topic.TOPIC,
}
CLOSING = [
    left("measured"),
    left("ours"),
    left("beside it"),
    Column("ratio"),
    Column("largest\nresidual"),
]


def run(scenario: Scenario, options: BenchOptions) -> int:
    """Run the command."""
    if options.topic == "gpu":
        return gpu.run(scenario, options)
    folder = run_folder.create(scenario, options)
    metrics = {}
    headlines: list[Headline] = []
    for name in TOPICS if options.topic == "all" else [options.topic]:
        announce(f"{name}: {TOPICS[name].waits}")
        told = TOPICS[name].run(scenario, options, folder)
        metrics[name] = told.metrics
        headlines += told.headlines
        folder.save_metrics(metrics)
    if options.topic == "all":
        folder.report(f"\n{write_closing_table(headlines)}")
    section = Section("Measured", [make_table(CLOSING, headlines)])
    folder.save_page(Page(say_verdict(headlines), sections=[section]))
    print(f"\nwritten to {folder.path}/")
    return 0


def write_closing_table(headlines: Sequence[Headline]) -> str:
    """Return the lines of all topics as one table."""
    return format_table(CLOSING, headlines)
