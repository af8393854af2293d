"""`bench`: how fast programs, laps, gradients, designs and single steps are, beside their peers; or
laps on one GPU."""

from __future__ import annotations

from jaxtube.experiments.bench import gpu, loop_topic, qp_topic
from jaxtube.experiments.bench.topic import Topic
from jaxtube.experiments.options import BenchOptions
from jaxtube.experiments.run import folder as run_folder
from jaxtube.experiments.run.table import Column, format_table, left
from jaxtube.scenario.tree import Scenario

TOPICS: dict[str, Topic] = {"qp": qp_topic.TOPIC, "loop": loop_topic.TOPIC}


def run(scenario: Scenario, options: BenchOptions) -> int:
    """Run the command."""
    if options.topic == "gpu":
        return gpu.run(scenario, options)
    folder = run_folder.create(scenario, options)
    metrics = {}
    headlines: list[tuple[str, str]] = []
    for name in TOPICS if options.topic == "all" else [options.topic]:
        print(f"{name}: {TOPICS[name].waits}", flush=True)
        told = TOPICS[name].run(scenario, options, folder)
        metrics[name] = told.metrics
        headlines += told.headlines
        folder.save_metrics(metrics)
    if options.topic == "all":
        folder.report(format_table([left("measured"), Column("median [quartiles]")], headlines))
    print(f"\nwritten to {folder.path}/")
    return 0
