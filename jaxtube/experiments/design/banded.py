"""`design` of a scenario with bands: certify a tracking law scheduled on speed, then attack it."""

from __future__ import annotations

import numpy as np

from jaxtube.experiments.design.banded_attack import REFERENCES, BandedLaps, attack
from jaxtube.experiments.options import DesignOptions
from jaxtube.experiments.run import folder as run_folder
from jaxtube.experiments.run.design_page import certificate_section, find_tone
from jaxtube.experiments.run.exit_codes import exit_code
from jaxtube.experiments.run.limits import describe_error_set
from jaxtube.experiments.run.page_table import make_table
from jaxtube.experiments.run.proof_line import write_proof
from jaxtube.experiments.run.table import Column, format_table, left, wrap
from jaxtube.experiments.run.verdict import fit_line
from jaxtube.plant.slip_processes import TEST_PROCESSES
from jaxtube.progress import announce, progress
from jaxtube.reporting.page import Bar, Bars, Page, Section
from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.bands import BandedLaw, make_law
from sets.certificate import MARGINS

ATTACKED = (
    left("slip"),
    Column("laps"),
    Column("steps"),
    Column("left set"),
    Column("w left W"),
    Column("caps"),
    Column("wheels"),
    Column("set used"),
    Column("W used"),
)
ATTACK = (
    "laps with wheel speeds jumping anywhere in the range, from starts all over the invariant set: "
    "periods in which the error left the set, w left W, an input left its caps, a wheel was at its "
    "limit; and the largest share of set and W that was used"
)


def run(scenario: Scenario, options: DesignOptions) -> int:
    """Run the command; returns 3 where a certificate is required and fails."""
    announce("designing the law of each band")
    law = make_law(scenario)
    folder = run_folder.create(scenario, options)
    folder.report(report(law))
    if law.certificate.holds_for_robot:
        folder.report(f"\n{write_proof(law, folder.path, options.label)}")
    attacks = {}
    if law.invariant.polytope is not None:
        with progress(len(TEST_PROCESSES) * REFERENCES, "attacking", "references") as bar:
            for process in TEST_PROCESSES:
                attacks[process] = attack(law, process, options.seed, bar.update)
        folder.report("\n" + attack_report(attacks))
    folder.save_metrics(metrics(law, attacks))
    folder.save_page(make_page(law, attacks))
    print(f"\nwritten to {folder.path}/")
    return exit_code(law.certificate, options.require_certificate)


def report(law: BandedLaw) -> str:
    """Return the bands and the certificate as text."""
    errors = ", ".join(f"{name} {law.shares[name]:.1%}" for name in list(law.shares)[:3])
    lines = [
        say_verdict(law),
        "",
        _band_table(law),
        "",
        f"widest use of the caps on errors: {errors}",
        "",
        describe_error_set(law.problem),
        "",
        "certificate of the scheduled tracking law, without MPC",
        *wrap(f"  {MARGINS}", "  "),
        law.certificate.table(),
        "",
        "assumed",
    ]
    for assumption in law.certificate.assumptions:
        lines += wrap(f"  * {assumption}", "    ")
    lines += ["", f"designed in {law.seconds:.1f} s"]
    return "\n".join(lines)


def make_page(law: BandedLaw, attacks: dict[str, BandedLaps]) -> Page:
    """Return the page of a law scheduled on speed."""
    bars = [Bar(name, share, f"{share:.1%}") for name, share in law.shares.items()]
    sections = [
        certificate_section(law.certificate),
        Section("What the law uses", [Bars("", bars, "The dashed line is the cap.")]),
    ]
    if attacks:
        table = make_table(ATTACKED, _list_attacks(attacks), note=ATTACK)
        sections.append(Section("Laps that attacked it", [table]))
    return Page(
        say_verdict(law),
        find_tone(law.certificate),
        sections=sections,
        not_covered=law.certificate.assumptions,
    )


def _band_table(law: BandedLaw) -> str:
    columns = [
        Column("band"),
        left("mean speed [m/s]"),
        Column("k1", "1/s"),
        Column("k2", "rad/(m s)"),
        Column("k3", "1/s"),
        Column("W: yaw", "deg"),
        Column("x", "mm"),
        Column("y", "mm"),
        Column("caps used"),
    ]
    rows = []
    scenario = law.problem.scenario
    slowest = scenario.reference.wheel_speed_min_mps
    for number, (band, settings) in enumerate(
        zip(law.bands, scenario.operating.bands, strict=True), start=1
    ):
        k1, k2, k3 = settings.tracking_gains
        yaw = np.rad2deg(band.bound.yaw)
        x, y, _ = 1e3 * band.bound.box
        share = law.shares[f"inputs of band {number}"]
        rows.append(
            [
                str(number),
                f"{slowest:g} to {settings.below_mps:g}",
                *(f"{gain:.4g}" for gain in (k1, k2, k3)),
                f"{yaw:.3f}",
                f"{x:.2f}",
                f"{y:.2f}",
                f"{share:.1%}",
            ]
        )
        slowest = settings.below_mps
    return format_table(columns, rows)


def say_verdict(law: BandedLaw) -> str:
    """Return one line: for which wheel speeds a law is certified, or what fails."""
    if not law.certificate.holds_for_robot:
        return fit_line(law.certificate.verdict)
    low, high = law.problem.model.box
    return (
        f"CERTIFIED for wheel speeds of {low[0]:g} to {high[0]:g} m/s in any order; at most "
        f"{max(law.shares.values()):.1%} of a cap is used"
    )


def attack_report(attacks: dict[str, BandedLaps]) -> str:
    """Return the laps run against the law as text."""
    return "\n".join([*wrap(ATTACK), format_table(ATTACKED, _list_attacks(attacks))])


def _list_attacks(attacks: dict[str, BandedLaps]) -> list[list[str]]:
    return [_attack_row(process, laps) for process, laps in attacks.items()]


def _attack_row(process: str, laps: BandedLaps) -> list[str]:
    counts = (laps.outside_set, laps.outside_w, laps.outside_caps, laps.saturated)
    return [
        process,
        f"{laps.laps:,}",
        f"{laps.steps:,}",
        *map(str, counts),
        f"{laps.used_set:.3f}",
        f"{laps.used_w:.3f}",
    ]


def metrics(law: BandedLaw, attacks: dict[str, BandedLaps]) -> dict:
    """Return the numbers of the law and of the attack."""
    omega = law.invariant.polytope
    return {
        "shares": law.shares,
        "certified": law.certificate.holds_for_robot,
        "certified_for_model": law.certificate.holds_for_model,
        "certificate": {
            condition.name: {"holds": condition.holds, "margin": condition.margin}
            for condition in law.certificate.checked
        },
        "invariant_set_facets": None if omega is None else len(omega.offsets),
        "bands": [{"yaw_rad": band.bound.yaw, "box": band.bound.box} for band in law.bands],
        "attack": {process: vars(laps) for process, laps in attacks.items()},
        "design_seconds": law.seconds,
    }
