"""`guarantee`: put a certified design to the test, and beside it another one that drives the same
robot.

Both designs get robot, slip, noise, path and start of the first scenario; sets, gains, model and
input map stay their own, and so do the wheel speeds each of them promises to cover. Every law's
blocks are recorded in a folder of their own, `records-DESIGN-LAW`, so that a killed run goes on
with nothing lost.
"""

from __future__ import annotations

import contextlib
import itertools
import re
import sys
import time
from collections.abc import Iterator
from typing import NamedTuple, NoReturn

import jax
import msgspec
import numpy as np

from jaxtube.atomic import write_atomically
from jaxtube.experiments.design.command import exit_code
from jaxtube.experiments.design.seen import disturbance_line
from jaxtube.experiments.guarantee import claims as guarantee_claims
from jaxtube.experiments.guarantee import report as guarantee_report
from jaxtube.experiments.guarantee.attack import (
    EDGE_SECONDS,
    LAWS,
    Law,
    laps_of_a_law,
    make_tasks,
    under,
)
from jaxtube.experiments.guarantee.claims import Tested
from jaxtube.experiments.montecarlo import command as blocks
from jaxtube.experiments.options import GuaranteeOptions, MontecarloOptions, title
from jaxtube.experiments.run import folder as run_folder
from jaxtube.experiments.run.folder import RunFolder
from jaxtube.experiments.run.metrics import COORDINATES, TO_DISPLAY
from jaxtube.experiments.run.progress import progress
from jaxtube.experiments.run.records import Records
from jaxtube.scenario import Scenario, ScenarioError, load, rules, to_toml
from jaxtube.scenario.refusal import refusal
from jaxtube.statistics import histogram
from jaxtube.statistics import run as montecarlo
from jaxtube.statistics.checks import OUTSIDE
from jaxtube.statistics.events import find_row
from jaxtube.statistics.montecarlo import name_law
from jaxtube.statistics.run import BLOCK, Run, Statistics
from jaxtube.statistics.summary import summarise
from jaxtube.synthesis.design import Design, EmptySetError
from jaxtube.synthesis.design import design as make_design


class Attack(NamedTuple):
    """One design under one law: its blocks and where they are recorded."""

    name: str
    law: Law
    run: Run
    records: Records


def run(scenario: Scenario, options: GuaranteeOptions) -> int:
    """Run the command; returns 3 where a certificate is required and the first design has none."""
    scenarios = {
        title(options.scenario): scenario,
        title(options.against): against(scenario, options),
    }
    blocks.use_devices(options.devices)
    designs = {name: certified(name, each) for name, each in scenarios.items()}
    with contextlib.ExitStack() as stack:
        attacks, notes = {}, {}
        for name, found in designs.items():
            attacks[name], notes[name] = attacked(stack, name, found, options)
        every = list(itertools.chain(*attacks.values()))
        missing = [each.records.missing(each.run.realisations) for each in every]
        print(announcement(every), file=sys.stderr)
        folder = run_folder.create(scenario, options)
        performance = compute(every, missing)
        statistics = {
            name: {each.law: each.records.merged() for each in attacks[name]} for name in designs
        }
    # The other design comes first, as what the first scenario is measured against.
    tested = [
        judged(name, designs[name], statistics[name], notes[name])
        for name in reversed(designs.keys())
    ]
    save(folder, tested, performance)
    certificate = designs[title(options.scenario)].certificate
    return exit_code(certificate, options.require_certificate)


def announcement(attacks: list[Attack]) -> str:
    """Return one line: how many laps are about to be run."""
    laps = sum(each.run.realisations for each in attacks)
    recorded = sum(each.records.laps for each in attacks)
    designs = len({each.name for each in attacks})
    return (
        f"{laps // designs:,} laps of each of {designs} designs, in whole blocks of {BLOCK:,} under "
        f"each of {len(LAWS)} laws; {recorded:,} of {laps:,} are recorded"
    )


def save(folder: RunFolder, tested: list[Tested], performance: dict) -> None:
    """Write metrics and tables, and print the report."""
    other = to_toml(tested[0].scenario).encode()
    markdown = guarantee_report.markdown(tested).encode()
    write_atomically(folder.path / "against.toml", lambda file: file.write(other))
    write_atomically(folder.path / "guarantee.md", lambda file: file.write(markdown))
    folder.save_metrics(guarantee_claims.metrics(tested))
    _draw(folder, tested)
    folder.report(guarantee_report.text(tested))
    if performance:
        folder.save_json("performance", performance)
        folder.report(
            f"\n{performance['laps']:,} laps computed in {performance['seconds']:.1f} s, with compilation"
        )
    print(f"\nguarantee.md, metrics.json, both scenarios and the records are in {folder.path}/")


def _draw(folder: RunFolder, tested: list[Tested]) -> None:
    from jaxtube.experiments.guarantee.figures import laws_figure

    folder.save_figure(laws_figure(tested), "laws")


def against(scenario: Scenario, options: GuaranteeOptions) -> Scenario:
    """Return the scenario to compare with, on the first one's robot.

    Raises: ScenarioError, one line, for the first scenario itself and where both do not go
    together.
    """
    if title(options.against) == title(options.scenario):
        problem, cure = "has the name of the scenario itself", "name another one"
        raise refusal("command line", "--against", options.against, problem, cure)
    return same_robot(load(options.against), scenario, options.against)


def same_robot(own: Scenario, first: Scenario, source: str) -> Scenario:
    """Give one scenario the robot, slip, noise, path and start of another; the wheel speeds it
    covers stay its own.

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
        own,
        robot=first.robot,
        slip=first.slip,
        noise=first.noise,
        initial=first.initial,
        reference=reference,
    )

    def refuse(key: str, problem: str, cure: str) -> NoReturn:
        section, name = key.split(".")
        raise refusal(
            f"--against {source}", key, getattr(getattr(joined, section), name), problem, cure
        )

    rules.check(joined, refuse)
    return joined


def certified(name: str, scenario: Scenario) -> Design:
    """Return a design with its certificate.

    Raises: ScenarioError, EmptySetError, one line that names the scenario.
    """
    try:
        return make_design(scenario)
    except (ScenarioError, EmptySetError) as error:
        raise type(error)(re.sub("^scenario:", f"{name}:", str(error))) from None


def attacked(
    stack: contextlib.ExitStack, name: str, found: Design, options: GuaranteeOptions
) -> tuple[list[Attack], str]:
    """Open the records of every law; return (attacks, why starts are not spread over the feasible
    set)."""
    tasks, why = make_tasks(found, options.seed)
    devices, laps = (
        tuple(jax.local_devices()[: options.devices or None]),
        laps_of_a_law(int(options.realisations), BLOCK),
    )
    attacks = []
    for law in LAWS:
        folder = options.folder / f"records-{name}-{law.name}"
        records = stack.enter_context(
            Records(folder, identity(found, law, options), montecarlo.merge, BLOCK)
        )
        for line in records.damaged:
            print(line, file=sys.stderr)
        attacks.append(Attack(name, law, Run(tasks[law], laps, 1, devices), records))
    return attacks, why


def identity(found: Design, law: Law, options: GuaranteeOptions) -> dict:
    """Return all that determines the statistics of a block."""
    scenario = under(found, law).problem.scenario
    known = blocks.identity(scenario, MontecarloOptions(seed=options.seed, starts=law.starts))
    return known | {"edge_seconds": EDGE_SECONDS} if law.edge else known


def compute(attacks: list[Attack], missing: list[Iterator[int]]) -> dict:
    """Compute and record the blocks that are missing; return what it took, nothing where none was."""
    before, started = sum(each.records.laps for each in attacks), time.perf_counter()
    with progress(
        sum(each.run.realisations for each in attacks), "attacking", "laps", before
    ) as bar:
        for each, wanted in zip(attacks, missing, strict=True):
            bar.set_postfix_str(f"{each.name}, {each.law.name}", refresh=False)
            for block, statistics in each.run.compute(wanted):
                each.records.add(block, int(statistics["laps"]), statistics)
                bar.update(BLOCK)
    laps = sum(each.records.laps for each in attacks) - before
    return {"laps": laps, "seconds": time.perf_counter() - started} if laps else {}


def judged(name: str, found: Design, statistics: dict[Law, Statistics], why: str) -> Tested:
    """Sum up a design that was attacked, with what its laps saw of w in W."""
    summaries = {}
    for law, counts in statistics.items():
        design = under(found, law)
        sampling = name_law(design, "tube_mpc", "robot", "scenario" if why else law.starts)
        summaries[law.name] = summarise(design, sampling, counts)
    seen = disturbance_line(found, disturbance(found, statistics), "the tube-MPC under all laws")
    notes = [f"{name}, {seen}"]
    if why:
        notes.append(f"starts of {name}: the scenario's, since {why.removeprefix('scenario: ')}")
    return Tested(name, found.problem.scenario, found.certificate, summaries, "\n".join(notes))


def disturbance(found: Design, statistics: dict[Law, Statistics]) -> dict:
    """Return how often and how far w left W, all laws together."""
    counts = [found["events"] for found in statistics.values()]
    steps = sum(
        int(found["laps"]) * (found["events"].shape[1] - 1) for found in statistics.values()
    )

    def share(event: str) -> float:
        return sum(int(row[find_row(event)] @ np.arange(row.shape[1])) for row in counts) / steps

    largest = histogram.quantile(
        np.sum([found["disturbance"] for found in statistics.values()], axis=0), 1.0
    )
    by_coordinate = [share(f"w_outside_{name}") for name in ("longitudinal", "lateral", "heading")]
    widths = found.problem.disturbance_set.support(np.eye(3))
    return {
        "steps": steps,
        "share_of_steps_outside": share("w_outside_W"),
        "share_of_steps_outside_by_coordinate": dict(zip(COORDINATES, by_coordinate, strict=True)),
        "largest": dict(zip(COORDINATES, largest * TO_DISPLAY, strict=True)),
        "allowed": dict(zip(COORDINATES, widths * TO_DISPLAY, strict=True)),
        "margin": OUTSIDE
        - max(float(np.max(found["excess/disturbance"])) for found in statistics.values()),
    }
