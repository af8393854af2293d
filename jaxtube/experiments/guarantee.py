"""`guarantee`: put a certified design to the test, and beside it another one that drives the same robot.

Both designs get robot, slip, noise, path and start of the first scenario; sets, gains, model and input map stay their
own, and so do the wheel speeds each of them promises to cover. Every law's blocks are recorded in a folder of their
own, `records/DESIGN/LAW`, so that a killed run goes on with nothing lost.
"""

from __future__ import annotations

import contextlib
import re
import sys
import time
from typing import NamedTuple, NoReturn

import jax
import msgspec
import numpy as np

from jaxtube import histogram, montecarlo
from jaxtube.checks import OUTSIDE
from jaxtube.design import Design, EmptySetError
from jaxtube.design import design as make_design
from jaxtube.experiments import guarantee_report, montecarlo_report, run_folder
from jaxtube.experiments import montecarlo as blocks
from jaxtube.experiments.atomic import write_atomically
from jaxtube.experiments.design import add_disturbance_condition, add_exact_condition, exit_code
from jaxtube.experiments.guarantee_attack import EDGE_SECONDS, LAWS, Law, laps_of_a_law, make_tasks, under
from jaxtube.experiments.guarantee_report import Tested
from jaxtube.experiments.metrics import COORDINATES, TO_DISPLAY
from jaxtube.experiments.options import Guarantee, Montecarlo, title
from jaxtube.experiments.progress import progress
from jaxtube.experiments.records import Records
from jaxtube.montecarlo import BLOCK, Run, Statistics
from jaxtube.scenario import Scenario, ScenarioError, load, rules, to_toml
from jaxtube.scenario.refusal import refusal
from jaxtube.tally import EVENTS


class Attack(NamedTuple):
    """One design under one law: its blocks and where they are recorded."""

    name: str
    design: Design
    law: Law
    run: Run
    records: Records


def run(scenario: Scenario, options: Guarantee) -> int:
    """Run the command; returns 3 where a certificate is required and the first design has none."""
    blocks.use_devices(options.devices)
    scenarios = {title(options.scenario): scenario, title(options.against): against(scenario, options)}
    designs = {name: certified(name, each) for name, each in scenarios.items()}
    laps = laps_of_a_law(int(options.realisations), BLOCK)
    folder = run_folder.create(scenario, options)
    write_atomically(
        folder.path / "against.toml", lambda file: file.write(to_toml(list(scenarios.values())[1]).encode())
    )
    started = time.perf_counter()
    with contextlib.ExitStack() as stack:
        attacks, notes = [], {}
        for name, found in designs.items():
            opened, notes[name] = attacked(stack, name, found, laps, options)
            attacks += opened
        computed = compute(attacks, laps)
        statistics = {(each.name, each.law): each.records.merged() for each in attacks}
    seconds = time.perf_counter() - started
    tested = [
        judged(name, found, {law: statistics[name, law] for law in LAWS}, notes[name], options.seed)
        for name, found in designs.items()
    ]
    folder.save_metrics(guarantee_report.metrics(tested))
    if computed:
        folder.save_json("performance", {"laps": computed, "seconds": seconds})
    markdown = guarantee_report.markdown(tested)
    write_atomically(folder.path / "guarantee.md", lambda file: file.write(markdown.encode()))
    print(guarantee_report.text(tested))
    print(f"\n{computed:,} laps computed in {seconds:.1f} s; guarantee.md, metrics.json and records in {folder.path}/")
    return exit_code(designs[title(options.scenario)], options.require_certificate)


def against(scenario: Scenario, options: Guarantee) -> Scenario:
    """Return the scenario to compare with, on the first one's robot.

    Raises: ScenarioError, one line, for the first scenario itself and where both do not go together.
    """
    if title(options.against) == title(options.scenario):
        problem, cure = "has the name of the scenario itself", "name another one"
        raise refusal("command line", "--against", options.against, problem, cure)
    return same_robot(load(options.against), scenario, options.against)


def same_robot(own: Scenario, first: Scenario, source: str) -> Scenario:
    """Give one scenario the robot, slip, noise, path and start of another; the wheel speeds it covers stay its own.

    Raises: ScenarioError, one line, where both do not go together.
    """
    covered = own.reference
    reference = msgspec.structs.replace(
        first.reference,
        wheel_speed_min_mps=covered.wheel_speed_min_mps,
        wheel_speed_max_mps=covered.wheel_speed_max_mps,
        certified_for=covered.certified_for,
    )
    joined = msgspec.structs.replace(
        own, robot=first.robot, slip=first.slip, noise=first.noise, initial=first.initial, reference=reference
    )

    def refuse(key: str, problem: str, cure: str) -> NoReturn:
        section, name = key.split(".")
        raise refusal(f"--against {source}", key, getattr(getattr(joined, section), name), problem, cure)

    rules.check(joined, refuse)
    return joined


def certified(name: str, scenario: Scenario) -> Design:
    """Return a design with its certificate, re-checked in rational arithmetic where that applies.

    Raises: ScenarioError, EmptySetError, one line that names the scenario.
    """
    try:
        found = make_design(scenario)
    except (ScenarioError, EmptySetError) as error:
        raise type(error)(re.sub("^scenario:", f"{name}:", str(error))) from None
    settings = scenario.controller
    if settings.tracking_gains and settings.terminal == "T-A" and settings.tube == "sequence":
        if found.terminal.invariant is not None and not found.terminal.fallback:
            add_exact_condition(found)
    return found


def attacked(stack: contextlib.ExitStack, name: str, found: Design, laps: int, options: Guarantee):
    """Open the records of every law; return (attacks, why starts are not spread)."""
    tasks, why = make_tasks(found, options.seed)
    devices, opened = tuple(jax.local_devices()[: options.devices or None]), []
    for law in LAWS:
        records = Records(
            options.folder / "records" / name / law.name, identity(found, law, options), montecarlo.merge, BLOCK
        )
        stack.enter_context(records)
        for line in records.damaged:
            print(line, file=sys.stderr)
        opened.append(Attack(name, under(found, law), law, Run(tasks[law], laps, 1, devices), records))
    return opened, why


def identity(found: Design, law: Law, options: Guarantee) -> dict:
    """Return all that determines the statistics of a block."""
    scenario = under(found, law).problem.scenario
    known = blocks.identity(scenario, Montecarlo(seed=options.seed, starts=law.starts))
    return known | {"edge_seconds": EDGE_SECONDS} if law.edge else known


def compute(attacks: list[Attack], laps: int) -> int:
    """Compute and record the blocks that are missing; return how many laps that were."""
    missing = [each.records.missing(laps) for each in attacks]
    before = sum(each.records.laps for each in attacks)
    with progress(laps * len(attacks), "attacking", "laps", before) as bar:
        for each, wanted in zip(attacks, missing, strict=True):
            bar.set_postfix_str(f"{each.name}, {each.law.name}", refresh=False)
            for block, statistics in each.run.computed(wanted):
                each.records.add(block, int(statistics["laps"]), statistics)
                bar.update(BLOCK)
    return sum(each.records.laps for each in attacks) - before


def judged(name: str, found: Design, statistics: dict[Law, Statistics], why: str, seed: int) -> Tested:
    """Sum up a design that was attacked; its certificate is told of every w outside W."""
    summaries = {}
    for law, counts in statistics.items():
        options = Montecarlo(seed=seed, starts="scenario" if why else law.starts)
        summaries[law.name] = montecarlo_report.summary(under(found, law), options, counts)
    add_disturbance_condition(found.certificate, disturbance(found, statistics), "the tube-MPC under all laws")
    note = f"starts of {name}: the scenario's, since {why.removeprefix('scenario: ')}" if why else ""
    return Tested(name, found.problem.scenario, found.certificate, summaries, note)


def disturbance(found: Design, statistics: dict[Law, Statistics]) -> dict:
    """Return how often and how far w left W, all laws together, as the certificate is told."""
    counts = [found["events"] for found in statistics.values()]
    steps = sum(int(found["laps"]) * (found["events"].shape[1] - 1) for found in statistics.values())

    def share(event: str) -> float:
        return sum(int(row[EVENTS.index(event)] @ np.arange(row.shape[1])) for row in counts) / steps

    largest = histogram.quantile(sum(found["disturbance"] for found in statistics.values()), 1.0)
    by_coordinate = [share(f"w_outside_{name}") for name in ("longitudinal", "lateral", "heading")]
    widths = found.problem.disturbance_set.support(np.eye(3))
    return {
        "steps": steps,
        "share_of_steps_outside": share("w_outside_W"),
        "share_of_steps_outside_by_coordinate": dict(zip(COORDINATES, by_coordinate, strict=True)),
        "largest": dict(zip(COORDINATES, largest * TO_DISPLAY, strict=True)),
        "allowed": dict(zip(COORDINATES, widths * TO_DISPLAY, strict=True)),
        "margin": OUTSIDE - max(float(np.max(found["excess/disturbance"])) for found in statistics.values()),
    }
