"""The page of `paper`: claims, controllers side by side, the design under stress."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from jaxtube.coordinates import COORDINATES, KEYS
from jaxtube.experiments.paper import stress
from jaxtube.experiments.paper.claims import PaperClaim
from jaxtube.experiments.paper.report import say_verdict
from jaxtube.experiments.run.design_page import design_sections, say_certified
from jaxtube.reporting.page import (
    Bar,
    Bars,
    Heading,
    Interval,
    Intervals,
    Page,
    Section,
    Table,
    Tone,
    Words,
)
from jaxtube.statistics.intervals import CONFIDENCE, share_interval
from jaxtube.synthesis.parts import Design

TONES: dict[str, Tone] = {"reproduced": "good", "in part": "plain", "not reproduced": "bad"}
"""By verdict on a claim."""


def make_page(
    design: Design,
    name: str,
    measured: dict,
    rows: Sequence[PaperClaim],
    player: Mapping[str, Any],
) -> Page:
    """Return the page of a run.

    Args:
        design: of the scenario.
        name: of the design.
        measured: metrics of the run.
        rows: claims of the paper with their verdicts.
        player: laps to play.
    """
    claims = Table(
        "",
        [Heading("claim"), Heading("measured"), Heading("verdict")],
        [[row.claim, row.measured, Words(row.verdict, TONES[row.verdict])] for row in rows],
    )
    sections = [
        Section("Claims of the paper", [claims]),
        Section("Controllers", [_compare(measured), _bars(design, measured), _shares(measured)]),
        *design_sections(design, measured),
        Section("Under stress", [_stress_table(measured)]),
    ]
    tone = "good" if all(row.verdict == "reproduced" for row in rows) else "plain"
    lead = [say_certified(name, design.certificate)]
    return Page(
        say_verdict(rows, design),
        tone,
        lead,
        sections,
        design.certificate.assumptions,
        player=player,
    )


def _compare(measured: dict) -> Table:
    """Return the controllers side by side."""
    headings = [Heading("controller"), Heading("laps that leave E", True)]
    for kind in ("largest", "RMS"):
        headings += [Heading(f"{kind} {each.symbol} [{each.unit}]", True) for each in COORDINATES]
    headings.append(Heading("steps with active row", True))
    rows = []
    for name, numbers in measured["controllers"].items():
        share = numbers["violation_share"]
        row = [name, Words(f"{share:.1%}", "bad" if share else "good")]
        for kind in ("max_error", "rms_error"):
            row += [f"{numbers[kind]['whole_run']['median'][key]:.4g}" for key in KEYS]
        rows.append([*row, f"{numbers['active_share']:.2%}"])
    laps = next(iter(measured["controllers"].values()))["realisations"]
    note = f"Medians over {laps:,} laps of each controller, on the same draws."
    return Table("", headings, rows, note)


def _bars(design: Design, measured: dict) -> Bars:
    """Return the worst lap of each controller against the limits of E."""
    limits = design.problem.error_set.offsets[:3]
    bars = []
    for name, numbers in measured["controllers"].items():
        worst = numbers["max_error"]["whole_run"]["worst"]
        shares = {
            each.symbol: worst[each.key] / (limit * each.to_display)
            for each, limit in zip(COORDINATES, limits, strict=True)
        }
        symbol = max(shares, key=lambda key: shares[key])
        bars.append(Bar(name, shares[symbol], f"{shares[symbol]:.0%} of the limit of {symbol}"))
    return Bars("Worst of all laps against E", bars, "The dashed line is the limit.")


def _shares(measured: dict) -> Intervals:
    """Return the share of laps that leave E, with exact intervals, controller by controller."""
    rows = []
    for name, numbers in measured["controllers"].items():
        laps = numbers["realisations"]
        outside = numbers["violating_realisations"]
        low, high = share_interval(outside, laps, CONFIDENCE)
        words = f"{low:.2g} to {high:.2g}" if outside else f"none: at most {high:.2g}"
        rows.append(Interval(name, words, outside / laps, low if outside else 0.0, high))
    note = (
        f"Exact intervals (Clopper-Pearson, {CONFIDENCE:.0%}, one controller each) for laps drawn "
        "as these were. Logarithmic axis."
    )
    return Intervals("Share of laps that leave E", rows, note)


def _stress_table(measured: dict) -> Table:
    headings = [
        Heading("plant"),
        Heading("controller"),
        Heading("runs", True),
        Heading("leave E", True),
        Heading("infeasible QPs", True),
        Heading("every w in W", True),
        Heading("of these leave E", True),
    ]
    rows = []
    for case, by_controller in measured["stress"].items():
        for name, numbers in by_controller.items():
            promised = numbers["runs_outside_E_with_every_w_in_W"]
            counts = [numbers[key] for key in ("runs", "runs_outside_E", "infeasible_QPs")]
            words = [f"{count:,}" for count in (*counts, numbers["runs_with_every_w_in_W"])]
            tone = "bad" if promised else "good"
            rows.append([stress.CASES[case], name, *words, Words(f"{promised:,}", tone)])
    note = (
        f"Design “{measured['stress_design']}”, starts all over the feasible set of its tube-MPC. "
        "The last column is what the certificate of the linear model excludes for tube_mpc."
    )
    return Table("", headings, rows, note)
