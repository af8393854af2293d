"""`design` of a scenario with bands: certify a tracking law scheduled on speed, then attack it."""

from __future__ import annotations

import numpy as np

from jaxtube.experiments.design.banded_attack import REFERENCES, BandedLaps, attack
from jaxtube.experiments.options import DesignOptions
from jaxtube.experiments.run import folder as run_folder
from jaxtube.experiments.run.design_page import certificate_section, find_tone
from jaxtube.experiments.run.exit_codes import exit_code
from jaxtube.experiments.run.limits import describe_error_set
from jaxtube.experiments.run.table import wrap
from jaxtube.plant.slip_processes import TEST_PROCESSES
from jaxtube.progress import progress
from jaxtube.reporting.page import Bar, Bars, Heading, Page, Section, Table
from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.bands import BandedLaw, make_law
from sets.certificate import MARGINS

ATTACKED = (
    "laps",
    "steps",
    "left set",
    "w left W",
    "caps",
    "wheels",
    "set used",
    "W used",
)
"""Headings of what laps that attacked the law came to."""
ATTACK = (
    "Laps with wheel speeds jumping anywhere in the range, from starts all over the invariant set."
)


def run(scenario: Scenario, options: DesignOptions) -> int:
    """Run the command; returns 3 where a certificate is required and fails."""
    law = make_law(scenario)
    folder = run_folder.create(scenario, options)
    folder.report(report(law))
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
        *wrap(_verdict(law), "  "),
        "",
        *_band_lines(law),
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
    verdict = _verdict(law)
    bars = [Bar(name, share, f"{share:.1%}") for name, share in law.shares.items()]
    headings = [Heading("slip"), *(Heading(words, True) for words in ATTACKED)]
    rows = [
        [process, *(f"{value:,.4g}" for value in vars(laps).values())]
        for process, laps in attacks.items()
    ]
    sections = [
        certificate_section(law.certificate),
        Section("What the law uses", [Bars("", bars, "The dashed line is the cap.")]),
    ]
    if rows:
        sections.append(Section("Laps that attacked it", [Table("", headings, rows, ATTACK)]))
    return Page(
        f"{verdict}.",
        find_tone(law.certificate),
        sections=sections,
        not_covered=law.certificate.assumptions,
    )


def _band_lines(law: BandedLaw) -> list[str]:
    lines = [
        "band  mean speed [m/s]  k1 [1/s]  k2 [rad/(m s)]  k3 [1/s]  W: yaw [deg]  x [mm]  y [mm]"
        "  caps used"
    ]
    scenario = law.problem.scenario
    slowest = scenario.reference.wheel_speed_min_mps
    for number, (band, settings) in enumerate(
        zip(law.bands, scenario.operating.bands, strict=True), start=1
    ):
        k1, k2, k3 = settings.tracking_gains
        yaw = np.rad2deg(band.bound.yaw)
        x, y, _ = 1e3 * band.bound.box
        share = law.shares[f"inputs of band {number}"]
        lines.append(
            f"{number:>4}{slowest:>11g} to {settings.below_mps:<5g}{k1:>10g}{k2:>16g}{k3:>10g}"
            f"{yaw:>14.3f}{x:>8.2f}{y:>8.2f}{share:>11.1%}"
        )
        slowest = settings.below_mps
    return lines


def _verdict(law: BandedLaw) -> str:
    if not law.certificate.holds_for_robot:
        return law.certificate.verdict
    low, high = law.problem.model.box
    return f"CERTIFIED for wheel speeds of {low[0]:g} to {high[0]:g} m/s in any order"


def attack_report(attacks: dict[str, BandedLaps]) -> str:
    """Return the laps run against the law as text."""
    lines = [
        *wrap(f"{ATTACK[0].lower()}{ATTACK[1:-1]}"),
        f"{'slip':<12}{'laps':>8}{'steps':>12}{'left set':>10}{'w left W':>10}{'caps':>8}"
        f"{'wheels':>8}{'set used':>10}{'W used':>8}",
    ]
    for process, laps in attacks.items():
        lines.append(
            f"{process:<12}{laps.laps:>8,}{laps.steps:>12,}{laps.outside_set:>10}"
            f"{laps.outside_w:>10}{laps.outside_caps:>8}{laps.saturated:>8}{laps.used_set:>10.3f}"
            f"{laps.used_w:>8.3f}"
        )
    return "\n".join(lines)


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
