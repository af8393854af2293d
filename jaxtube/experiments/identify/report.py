"""What the command `identify` reports: the promise first, then what was found, and what is not
covered."""

from __future__ import annotations

import numpy as np

from jaxtube.experiments.identify.log_report import Row, count_words, say_log, tabulate
from jaxtube.experiments.run.table import wrap
from jaxtube.identification.findings import Findings
from jaxtube.identification.identify import Identified
from jaxtube.identification.scenario_text import find_track_width, list_open_points
from jaxtube.identification.uncovered import find_uncovered
from jaxtube.identification.words import say_holding, say_needed, say_other_boxes, say_sample
from jaxtube.reporting.page import Heading, Listing, Page, Part, Section, Table


def report(identified: Identified, findings: Findings | None, track_width: float | None) -> str:
    """Return the report."""
    parts = [
        say_verdict(identified),
        "; ".join(say_needed(identified)),
        "\n".join(wrap(say_sample(identified))),
        "\n".join(wrap(say_other_boxes(identified))),
        tabulate(_robot_rows(identified, findings, track_width)),
        say_log(findings) if findings else "",
        "\n".join(_say_limits(identified)),
        "\n".join(_say_open(findings)),
        "\n".join(wrap(f"Read: {'; '.join(identified.windows.guesses)}", "  "))
        if identified.windows.guesses
        else "",
    ]
    return "\n\n".join(part for part in parts if part)


def say_verdict(identified: Identified) -> str:
    """Return one line: what the box of slips promises of new commands."""
    return f"the box of slips {say_holding(identified)} commands"


def make_page(identified: Identified, findings: Findings | None, track_width: float | None) -> Page:
    """Return the page of an identification."""
    rows = _robot_rows(identified, findings, track_width)
    headings = [Heading("quantity"), Heading("found"), Heading("spread"), Heading("from")]
    parts: list[Part] = [Table("", headings, [tuple(row) for row in rows])]
    open_points = list_open_points(findings)
    if open_points:
        parts.append(Listing(open_points, "To settle before a design, in identified.toml"))
    lead = ["; ".join(say_needed(identified)), say_sample(identified), say_other_boxes(identified)]
    return Page(
        say_verdict(identified),
        lead=[*filter(None, lead)],
        sections=[Section("What was found", parts)],
        not_covered=_list_limits(identified),
        not_covered_lead="The promise does not cover:",
    )


def _robot_rows(
    identified: Identified, findings: Findings | None, track_width: float | None
) -> list[Row]:
    geometry = identified.geometry
    windows = identified.windows
    box = identified.widened_box
    margin = identified.choices.margin
    width, source = find_track_width(identified, findings, track_width)
    fitted = f"{len(np.unique(windows.command[identified.fits]))} commands"
    counted = f"{identified.promise.commands} commands"
    noise = identified.slip_noise
    parts = [
        "" if noise is None else f"pose noise alone +- {100 * noise:.2g} %",
        f"{100 * margin:g} % beyond the extremes, not promised" if margin else "",
    ]
    spread = "; ".join(filter(None, parts))
    is_unknown = source.startswith("not known")
    times = "" if is_unknown else f"; {geometry.track / width:.3g} times {width:.4g} m, {source}"
    return [
        ("slip of the right wheel", _say_interval(box.right), spread, counted),
        ("slip of the left wheel", _say_interval(box.left), spread, counted),
        (
            "sideslip, of the speed",
            f"{100 * box.sideslip:.3g} %",
            f"{100 * geometry.crab:+.2g} % of it constant",
            counted,
        ),
        (
            "effective track",
            f"{geometry.track:.4g} m",
            f"+- {geometry.track_error:.2g} m",
            f"{fitted}{times}",
        ),
        (
            "lever arm",
            f"{geometry.lever_arm:.3g} m",
            f"+- {geometry.lever_arm_error:.2g} m",
            fitted,
        ),
        (
            "yaw rate explained",
            f"{100 * geometry.explained:.0f} %",
            "by mean slips and effective track",
            fitted,
        ),
    ]


def _say_interval(interval: tuple[float, float]) -> str:
    return f"{100 * interval[0]:.1f} to {100 * interval[1]:.1f} %"


def _say_open(findings: Findings | None) -> list[str]:
    """Return what a user has to settle before the scenario is designed for."""
    open_points = list_open_points(findings)
    if not open_points:
        return []
    lines = ["Before a design, settle in identified.toml:"]
    for point in open_points:
        lines += wrap(f"* {point}")
    return lines


def _say_limits(identified: Identified) -> list[str]:
    """Return what the promise does not cover, as lines."""
    lines = ["Not covered by the promise:"]
    for sentence in _list_limits(identified):
        lines += wrap(f"* {sentence}")
    return lines


def _list_limits(identified: Identified) -> list[str]:
    """Return what the promise does not cover, a sentence each."""
    uncovered = find_uncovered(identified)
    told = [
        "slips within a window: what is promised is their mean over it; lag, noise and anything "
        "the drive did not meet (other ground, load, speed)"
    ]
    if identified.slip_noise is not None:
        told.append(
            "which part of an interval is slip: pose noise spreads the slips of windows by "
            f"{100 * identified.slip_noise:.2g} % (one standard deviation, median), so that the "
            "intervals are wider than slip alone is, the more the slower a wheel turns"
        )
    if uncovered.on_the_spot:
        commands = count_words(uncovered.on_the_spot, "command", "commands")
        low, middle, high = uncovered.spot_track
        told.append(
            f"turning on the spot, {commands}: there "
            f"wheels differ by {middle:.3g} m times the yaw rate, slip included ({low:.3g} to "
            f"{high:.3g} m in 80 % of windows)"
        )
    if uncovered.reversing:
        told.append(f"reversing, {count_words(uncovered.reversing, 'command', 'commands')}")
    if uncovered.changing:
        share = uncovered.changing_inside / uncovered.changing
        told.append(
            "changing speed: of windows that drive forwards but not steadily, "
            f"{100 * share:.0f} % of {uncovered.changing} lie inside the box"
        )
    return told
