"""A design as sections of a page: its certificate, what the tube uses of the limits, and the causes
of W."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from jaxtube.coordinates import COORDINATES
from jaxtube.experiments.run import metrics
from jaxtube.experiments.run.design_report import LEGEND, NOTHING, find_causes, say_verdict
from jaxtube.reporting.page import (
    Bar,
    Bars,
    ConditionRow,
    Conditions,
    Heading,
    Page,
    Section,
    Table,
    Tone,
)
from jaxtube.synthesis.parts import Design
from sets.certificate import MARGINS, Certificate, Condition

BARS = (
    "The line in the middle of a bar is the limit; what holds goes to the right, what fails to the "
    "left. Lengths are logarithmic, and units differ: compare a bar with its limit, not with other "
    "bars."
)
CAUSES = (
    ("yaw kick", "deg"),
    ("longitudinal", "mm"),
    ("lateral", "mm"),
    ("heading", "deg"),
)
"""Parts of a disturbance, with their units of display."""
SMALL = 5e-3
"""Share of W below which a cause is told in the table alone."""


def say_certified(name: str, certificate: Certificate) -> str:
    """Return in a sentence for what a design is certified."""
    failing = _say_names(certificate.failing)
    if certificate.holds_for_robot:
        return f"The design “{name}” is certified for the robot itself: every condition holds."
    if certificate.holds_for_model:
        missing = failing or "its disturbances were not checked"
        return (
            f"The design “{name}” is certified for the linear model with w in W alone, not for the "
            f"robot; {missing}."
        )
    return f"The design “{name}” is not certified; {failing or 'nothing was checked'}."


def make_page(
    design: Design,
    name: str,
    numbers: dict,
    nearest: Sequence[str],
    player: Mapping[str, Any] | None,
) -> Page:
    """Return the page of a design.

    Args:
        design: with its certificate.
        name: of the design.
        numbers: its metrics.
        nearest: sentences on what holds nearby, where that was searched.
        player: laps to play; None where there are none.
    """
    return Page(
        say_verdict(design),
        find_tone(design.certificate),
        [say_certified(name, design.certificate), *nearest],
        design_sections(design, numbers),
        design.certificate.assumptions,
        player,
    )


def find_tone(certificate: Certificate) -> Tone:
    """Return whether the certificate of a design is good news."""
    return "good" if certificate.holds_for_robot else "bad"


def design_sections(design: Design, numbers: dict) -> list[Section]:
    """Return the sections of a design.

    Args:
        design: with its certificate.
        numbers: its metrics, from `metrics.design_metrics`.
    """
    sections = [
        certificate_section(design.certificate),
        Section("Tube and disturbances", list(_list_uses(design, numbers))),
    ]
    causes = find_causes(design)
    if causes:
        sections.append(Section("Causes of W", _describe_causes(causes)))
    return sections


def certificate_section(certificate: Certificate) -> Section:
    """Return all conditions: those that a verdict rests on, then those for information."""
    required = [_make_row(each) for each in certificate.checked if each.required]
    others = [_make_row(each) for each in certificate.checked if not each.required]
    margins = f"{MARGINS[0].upper()}{MARGINS[1:]}."
    parts = [Conditions("", required, f"{margins} {BARS}")]
    if others:
        parts.append(Conditions("For information: no verdict rests on these", others))
    return Section("Certificate", parts)


def _make_row(condition: Condition) -> ConditionRow:
    return ConditionRow(
        condition.name,
        condition.holds,
        condition.required,
        condition.scope,
        condition.margin,
        condition.margin_words,
        condition.sentence,
    )


def _list_uses(design: Design, numbers: dict) -> Iterator[Bars]:
    """Yield bars of the tube against the limits of errors, and against the caps where there are
    any; and of the disturbances against W where laps were run."""
    limits = design.problem.operating_set.support(np.eye(3))
    widths = metrics.tube_half_widths(design, design.tube.name)[-1]
    bars = []
    for coordinate, width, limit in zip(COORDINATES, widths, limits, strict=True):
        allowed = limit * coordinate.to_display
        words = f"{width:.3g} of {allowed:.3g} {coordinate.unit}, {width / allowed:.0%}"
        bars.append(Bar(f"{coordinate.name} error", float(width / allowed), words))
    horizon = design.problem.horizon
    note = f"Half widths of the last section R_{horizon}. The dashed line is the limit."
    yield Bars(f"Tube “{design.tube.name}” against the limits on errors", bars, note)
    shares = numbers.get("cap_shares")
    if shares:
        yield Bars(
            "Widest tube against its caps",
            [Bar(name, share, f"{share:.1%}") for name, share in shares.items()],
            "Of the terminal gain, after any number of steps. The dashed line is the cap.",
        )
    if "disturbance" in numbers:
        yield _compare_seen(numbers["disturbance"])


def _compare_seen(disturbance: dict) -> Bars:
    """Return the largest disturbances that laps met against the half widths of W."""
    bars = []
    for coordinate in COORDINATES:
        largest = disturbance["largest"][coordinate.key]
        allowed = disturbance["allowed"][coordinate.key]
        share = largest / allowed if allowed else float(bool(largest)) * np.inf
        outside = disturbance["share_of_steps_outside_by_coordinate"][coordinate.key]
        words = f"{largest:.3g} of {allowed:.3g} {coordinate.unit}"
        if outside:
            words += f", beyond in {outside:.1%} of steps"
        bars.append(Bar(coordinate.name, share, words))
    note = f"In {disturbance['steps']:,} steps. Laps can refute W, never prove it."
    return Bars("Largest disturbances seen in laps against W", bars, note)


def _describe_causes(causes: dict) -> list[Table | Bars]:
    """Return the table of the causes of W, and of each of its parts the causes as shares of it."""
    headings = [Heading("cause, alone")]
    headings += [Heading(f"{name} [{unit}]", True) for name, unit in CAUSES]
    whole = causes["W"]
    rows = [
        [name, *(_say_width(width, largest) for width, largest in zip(widths, whole, strict=True))]
        for name, widths in causes.items()
    ]
    parts: list[Table | Bars] = [Table("Half widths of one step", headings, rows, LEGEND)]
    alone = {name: widths for name, widths in causes.items() if name != "W"}
    for part, (name, unit) in enumerate(CAUSES):
        if not whole[part] > 0:
            continue
        bars = [
            Bar(cause, widths[part] / whole[part], f"{widths[part]:.3g} {unit}", is_judged=False)
            for cause, widths in alone.items()
            if widths[part] > SMALL * whole[part]
        ]
        title = f"{name.capitalize()}: causes against W, {whole[part]:.3g} {unit}"
        parts.append(Bars(title, bars))
    return parts


def _say_width(width: float, largest: float) -> str:
    """Return a half width, 0 for what is nothing beside the largest one."""
    return f"{width:.4g}" if width > NOTHING * largest else "0"


def _say_names(names: list[str]) -> str:
    """Return names of conditions that fail, in words."""
    words = [name.replace("_", " ") for name in names]
    return f"what fails: {', '.join(words)}" if words else ""
