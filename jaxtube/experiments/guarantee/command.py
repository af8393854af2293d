"""`guarantee`: put a certified design to the test, and beside it another one that drives the same
robot.

Both designs get robot, slip, noise, path and start of the first scenario; sets, gains, model and
input map stay their own, and so do the wheel speeds each of them promises to cover. The blocks of
each law are recorded in a folder of their own, `records-DESIGN-LAW`, so that a killed run continues
with nothing lost.
"""

from __future__ import annotations

import contextlib
import re
import sys
import time
from collections.abc import Collection, Iterator
from typing import NamedTuple

import jax
import numpy as np

from jaxtube.atomic import write_atomically
from jaxtube.coordinates import NAMES, TO_DISPLAY
from jaxtube.experiments.guarantee import claims as guarantee_claims
from jaxtube.experiments.guarantee import page as guarantee_page
from jaxtube.experiments.guarantee import report as guarantee_report
from jaxtube.experiments.guarantee.attack import (
    EDGE_SECONDS,
    LAWS,
    Law,
    apply_law,
    count_laps,
    make_tasks,
)
from jaxtube.experiments.guarantee.claims import DesignUnderTest
from jaxtube.experiments.options import GuaranteeOptions, MontecarloOptions, title
from jaxtube.experiments.run import blocks
from jaxtube.experiments.run import folder as run_folder
from jaxtube.experiments.run.designing import identify_restored, make_design
from jaxtube.experiments.run.disturbance_line import disturbance_line
from jaxtube.experiments.run.exit_codes import exit_code
from jaxtube.experiments.run.folder import RunFolder
from jaxtube.experiments.run.limits import describe_error_set, describe_pose
from jaxtube.experiments.run.metrics import by_coordinate
from jaxtube.experiments.run.records import Records
from jaxtube.progress import announce, progress
from jaxtube.reporting.laps import collect
from jaxtube.reporting.player import make_player
from jaxtube.scenario.reading import load, replace
from jaxtube.scenario.refusal import ScenarioError, refusal
from jaxtube.scenario.tree import Scenario, to_toml
from jaxtube.simulation.promise import limit_true_errors
from jaxtube.statistics import histogram
from jaxtube.statistics import run as montecarlo
from jaxtube.statistics.checks import OUTSIDE
from jaxtube.statistics.events import find_row
from jaxtube.statistics.lap import choose_numbers, run_numbered
from jaxtube.statistics.montecarlo import name_law
from jaxtube.statistics.run import BLOCK, Run, Statistics
from jaxtube.statistics.summary import summarise
from jaxtube.synthesis.design import EmptySetError
from jaxtube.synthesis.parts import Design

SHARED = ("robot", "slip", "noise", "initial", "reference")
"""Sections that both designs take from the first scenario."""
COVERED = ("wheel_speed_min_mps", "wheel_speed_max_mps", "certified_for")
"""Keys of [reference] that a design keeps: the wheel speeds that it promises to cover."""
KEPT = 12
"""Laps of each law that are kept, to be played."""


class LawRun(NamedTuple):
    """One design under one law: its blocks and where they are recorded."""

    name: str  # of the design
    law: Law
    run: Run
    records: Records


def run(scenario: Scenario, options: GuaranteeOptions) -> int:
    """Run the command; returns 3 where a certificate is required and the first design has none."""
    first = title(options.scenario)
    other = title(options.against)
    scenarios = {first: scenario, other: load_other(scenario, options)}
    blocks.use_devices(options.devices)
    designs = make_designs(scenarios, options)
    announce("searching the feasible sets that laps start from")
    attacks = []
    reasons = {}
    with contextlib.ExitStack() as stack:
        for name, design in designs.items():
            opened, reasons[name] = open_attacks(stack, name, design, options)
            attacks += opened
        missing = [attack.records.missing(attack.run.realisations) for attack in attacks]
        print(describe_laps(attacks), file=sys.stderr)
        folder = run_folder.create(scenario, options)
        performance = compute(attacks, missing)
        statistics = merge_records(attacks)
    announce("summarising the laps")
    # The other design comes first, as what the first scenario is measured against.
    tested = [
        summarise_attacks(name, designs[name], statistics[name], reasons[name])
        for name in (other, first)
    ]
    save(folder, tested, performance)
    save_page(folder, designs, tested, attacks, options.seed)
    print(f"\nreport.html, guarantee.md, laps.npz and the records are in {folder.path}/")
    return exit_code(designs[first].certificate, options.require_certificate)


def load_other(scenario: Scenario, options: GuaranteeOptions) -> Scenario:
    """Return the scenario to compare with, on the robot of the first one.

    Raises:
        ScenarioError: one line, for the first scenario itself and where both do not go together.
    """
    if title(options.against) == title(options.scenario):
        problem = "has the name of the scenario itself"
        raise refusal("command line", "--against", options.against, problem, "name another one")
    return put_on_robot(load(options.against), scenario, options.against)


def put_on_robot(own: Scenario, first: Scenario, source: str) -> Scenario:
    """Return a scenario with robot, slip, noise, path and start of another one; the wheel speeds it
    covers stay its own.

    Args:
        own: the scenario.
        first: gives the robot.
        source: what the user calls `own`.

    Raises:
        ScenarioError: one line, where both do not go together.
    """
    shared = {section: getattr(first, section) for section in SHARED}
    covered = {f"reference.{key}": getattr(own.reference, key) for key in COVERED}
    try:
        return replace(own, shared | covered)
    except ScenarioError as error:
        raise _name_source(error, f"--against {source}") from None


def make_designs(scenarios: dict[str, Scenario], options: GuaranteeOptions) -> dict[str, Design]:
    """Return designs with their certificates, by the name of the scenario; only the first may have
    been saved, the other one is put on its robot.

    Raises:
        ScenarioError, EmptySetError: one line that names the scenario.
    """
    designs = {}
    for name, scenario in scenarios.items():
        announce(f"designing `{name}`")
        try:
            is_first = name == title(options.scenario)
            designs[name] = make_design(scenario, options if is_first else None)
        except (ScenarioError, EmptySetError) as error:
            raise _name_source(error, name) from None
    return designs


def _name_source(error: ValueError, source: str) -> ValueError:
    """Return the same error about a source that the user knows."""
    return type(error)(re.sub("^(scenario|override):", f"{source}:", str(error)))


def open_attacks(
    stack: contextlib.ExitStack, name: str, design: Design, options: GuaranteeOptions
) -> tuple[list[LawRun], str]:
    """Open the records of every law.

    Returns:
        The attacks; and why starts are not spread over the feasible set, "" where they are.
    """
    tasks, reason = make_tasks(design, options.seed)
    devices = tuple(jax.local_devices()[: options.devices or None])
    laps = count_laps(int(options.realisations), BLOCK)
    attacks = []
    for law in LAWS:
        folder = options.folder / f"records-{name}-{law.name}"
        opened = Records(folder, identity(design, law, options), montecarlo.merge, BLOCK)
        records = stack.enter_context(opened)
        for line in records.damaged:
            print(line, file=sys.stderr)
        attacks.append(LawRun(name, law, Run(tasks[law], laps, 1, devices), records))
    return attacks, reason


def identity(design: Design, law: Law, options: GuaranteeOptions) -> dict:
    """Return all that determines the statistics of a block."""
    scenario = apply_law(design, law).problem.scenario
    known = blocks.identity(scenario, MontecarloOptions(seed=options.seed, starts=law.starts))
    known |= identify_restored(design)
    return known | {"edge_seconds": EDGE_SECONDS} if law.edge else known


def describe_laps(attacks: list[LawRun]) -> str:
    """Return one line: how many laps are about to be run."""
    laps = sum(attack.run.realisations for attack in attacks)
    recorded = sum(attack.records.laps for attack in attacks)
    designs = len({attack.name for attack in attacks})
    return (
        f"{laps // designs:,} laps of each of {designs} designs, in whole blocks of {BLOCK:,} "
        f"under each of {len(LAWS)} laws; {recorded:,} of {laps:,} are recorded"
    )


def compute(attacks: list[LawRun], missing: list[Iterator[int]]) -> dict:
    """Compute and record the missing blocks; return what it took, {} where none was missing."""
    laps = sum(attack.run.realisations for attack in attacks)
    before = sum(attack.records.laps for attack in attacks)
    start = time.perf_counter()
    with progress(laps, "attacking", "laps", before) as bar:
        for attack, wanted in zip(attacks, missing, strict=True):
            bar.set_postfix_str(f"{attack.name}, {attack.law.name}", refresh=False)
            for block, statistics in attack.run.compute(wanted):
                attack.records.add(block, int(statistics["laps"]), statistics)
                bar.update(BLOCK)
    computed = sum(attack.records.laps for attack in attacks) - before
    return {"laps": computed, "seconds": time.perf_counter() - start} if computed else {}


def merge_records(attacks: list[LawRun]) -> dict[str, dict[Law, Statistics]]:
    """Return the statistics of all blocks, by design and law."""
    statistics: dict[str, dict[Law, Statistics]] = {attack.name: {} for attack in attacks}
    for attack in attacks:
        statistics[attack.name][attack.law] = attack.records.merge()
    return statistics


def summarise_attacks(
    name: str, design: Design, statistics: dict[Law, Statistics], reason: str
) -> DesignUnderTest:
    """Return what became of a design that was attacked, with what its laps saw of w in W.

    Args:
        name: of the design.
        design: the attacked design.
        statistics: by law.
        reason: why starts are not spread over the feasible set, "" where they are.
    """
    summaries = {}
    for law, counts in statistics.items():
        limited = apply_law(design, law)
        sampling = name_law(limited, "tube_mpc", "robot", "scenario" if reason else law.starts)
        summaries[law.name] = summarise(limited, sampling, counts)
    disturbance = sum_up_disturbances(design, statistics.values())
    seen = disturbance_line(design, disturbance, "the tube-MPC under all laws")
    notes = [f"{name}, {describe_error_set(design.problem)}", f"{name}, {seen}"]
    if reason:
        because = reason.removeprefix("scenario: ")
        notes.append(f"starts of {name}: the scenario's, since {because}")
    return DesignUnderTest(
        name, design.problem.scenario, design.certificate, summaries, "\n".join(notes)
    )


def sum_up_disturbances(design: Design, statistics: Collection[Statistics]) -> dict:
    """Return how often and how far w left W, all laws together."""
    steps = sum(int(law["laps"]) * (law["events"].shape[1] - 1) for law in statistics)

    def find_share(event: str) -> float:
        return sum(_count_steps(law, event) for law in statistics) / steps

    outside = [find_share(f"w_outside_{name}") for name in NAMES]
    sizes = np.sum([law["disturbance"] for law in statistics], axis=0)
    excess = max(float(np.max(law["excess/disturbance"])) for law in statistics)
    widths = design.problem.disturbance_set.support(np.eye(3))
    return {
        "steps": steps,
        "share_of_steps_outside": find_share("w_outside_W"),
        "share_of_steps_outside_by_coordinate": by_coordinate(outside),
        "largest": by_coordinate(histogram.quantile(sizes, 1.0) * TO_DISPLAY),
        "allowed": by_coordinate(widths * TO_DISPLAY),
        "margin": OUTSIDE - excess,
    }


def _count_steps(statistics: Statistics, event: str) -> int:
    """Return the steps in which an event occurred."""
    laps = statistics["events"][find_row(event)]
    return int(laps @ np.arange(len(laps)))


def save(folder: RunFolder, tested: list[DesignUnderTest], performance: dict) -> None:
    """Write metrics, tables and figure, and print the report."""
    from jaxtube.experiments.guarantee.figures import laws_figure

    other = to_toml(tested[0].scenario).encode()
    markdown = guarantee_report.markdown(tested).encode()
    write_atomically(folder.path / "against.toml", lambda file: file.write(other))
    write_atomically(folder.path / "guarantee.md", lambda file: file.write(markdown))
    folder.save_metrics(guarantee_claims.metrics(tested))
    folder.save_figure(laws_figure(tested), "laws")
    folder.report(guarantee_report.text(tested))
    if performance:
        folder.save_json("performance", performance)
        laps = performance["laps"]
        seconds = performance["seconds"]
        folder.report(f"\n{laps:,} laps computed in {seconds:.1f} s, with compilation")


def save_page(
    folder: RunFolder,
    designs: dict[str, Design],
    tested: list[DesignUnderTest],
    attacks: list[LawRun],
    seed: int,
) -> None:
    """Keep some laps of each design under each law over whole laps, and write the page that plays
    them."""
    kept = []
    for design in tested:
        for attack in attacks:
            if attack.name != design.name or attack.law.edge:
                continue
            numbers = choose_numbers(design.laws[attack.law.name], KEPT)
            laps = run_numbered(attack.run.task, seed, numbers)
            name = f"{design.name}-{attack.law.name}"
            total = design.laws[attack.law.name]["laps"]
            by_name = {name: np.array(numbers, np.uint64)}
            judged = limit_true_errors(designs[design.name], "robot")
            kept.append(collect(judged, {name: laps}, by_name, total))
    joined = kept[-1]._replace(laps={name: lap for each in kept for name, lap in each.laps.items()})
    folder.save_arrays("laps", **joined.arrays())
    note = describe_pose(designs[tested[-1].name].problem)
    folder.save_page(guarantee_page.make_page(tested, make_player(joined, note)))
