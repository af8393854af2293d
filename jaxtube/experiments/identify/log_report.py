"""What the command `identify` reports of a log's sensors and actuators.

Source: new.
"""

from __future__ import annotations

import numpy as np

from jaxtube.experiments.run.table import Column, format_table, left, wrap
from jaxtube.identification.findings import Findings, Noise
from jaxtube.identification.scenario_text import LEAST_EXPLAINED_BY_LAG

MOST_CUTS = 12
"""That are listed one by one."""

Row = tuple[str, str, str, str]


def say_log(findings: Findings) -> str:
    """Return what was found of the sensors and actuators of a log."""
    parts = [tabulate(_sensor_rows(findings)), _say_cuts(findings)]
    if findings.log.guesses:
        parts.append("\n".join(wrap(f"Read: {'; '.join(findings.log.guesses)}", "  ")))
    return "\n\n".join(parts)


def tabulate(rows: list[Row]) -> str:
    """Return quantities as a table."""
    columns = [left("quantity"), Column("value"), left("uncertainty"), left("from")]
    return format_table(columns, rows)


def _sensor_rows(findings: Findings) -> list[Row]:
    clock = findings.clock
    rows: list[Row] = [
        (
            "poses behind wheels",
            f"{clock.offset:.3f} s",
            f"+- {clock.standard_error:.2g} s",
            f"motion of both, correlation {clock.correlation:.3f}; clocks and late stamps",
        ),
        *_response_rows(findings),
        ("wheel speeds", f"every {findings.wheel_period:.3g} s", "", "median of rows"),
        (
            "poses",
            f"every {findings.pose_period:.3g} s",
            f"{100 * findings.held_share:.0f} % of rows held, dropped",
            "median of new poses",
        ),
    ]
    for name, noise in (("driving", findings.moving), ("standing", findings.standing)):
        if noise:
            rows.append(_noise_row(name, noise))
    return rows


def _response_rows(findings: Findings) -> list[Row]:
    response = findings.response
    if response is None:
        return [("wheels behind commands", "unknown", "", "no commands in the log, or too few")]
    changes = f"{response.changes} changes, {100 * max(response.explained, 0):.0f} % explained"
    if response.explained < LEAST_EXPLAINED_BY_LAG:
        reason = f"{changes}: no first-order lag"
        return [("wheels behind commands", "unknown", "", reason)]
    least, greatest = response.lag_interval
    return [
        (
            "wheels behind commands",
            f"{response.lag:.3f} s",
            f"{least:.3f} to {greatest:.3f} s for 90 % of them",
            f"first-order lag; {changes}",
        ),
        (
            "dead time of commands",
            f"{response.delay:.3f} s" if response.delay > 0.0 else "none seen",
            f"a row shows commands up to {findings.wheel_period:.3g} s late",
            changes,
        ),
    ]


def _noise_row(name: str, noise: Noise) -> Row:
    place, turn = noise.deviation
    widest, most = noise.bound
    return (
        f"pose noise, {name}",
        f"{1000 * place:.2g} mm, {np.rad2deg(turn):.2g} deg",
        f"99.5 % within {1000 * widest:.3g} mm, {np.rad2deg(most):.2g} deg",
        f"{noise.poses} poses about parabolas through seven",
    )


def _say_cuts(findings: Findings) -> str:
    """Return the cuts: stretches in which the pose was lost, gaps and jumps."""
    cuts = findings.cuts.cuts
    if not cuts:
        return "Pose trusted throughout: no jump, no gap."
    lost = sum(cut.end - cut.start for cut in cuts)
    columns = [
        left("cut"),
        Column("from", "s"),
        Column("to", "s"),
        Column("jumps"),
        Column("largest", "m"),
        Column("turn", "deg"),
    ]
    # The longest are the ones to know of; in order of time all the same.
    longest = sorted(cuts, key=lambda cut: (cut.kind != "lost", cut.start - cut.end))[:MOST_CUTS]
    rows = [
        (
            cut.kind,
            f"{cut.start:.1f}",
            f"{cut.end:.1f}",
            str(cut.jumps),
            f"{cut.largest:.2f}",
            f"{np.rad2deg(cut.turn):.0f}",
        )
        for cut in sorted(longest, key=lambda cut: cut.start)
    ]
    kinds = [
        count_words(len(findings.cuts.of_kind(kind)), one, many)
        for kind, one, many in (
            ("lost", "stretch in which the pose was lost", "stretches in which it was lost"),
            ("gap", "gap", "gaps"),
            ("jump", "single jump", "single jumps"),
        )
    ]
    shown = f"; the {len(rows)} that matter most" if len(rows) < len(cuts) else ""
    head = "\n".join(wrap(f"Pose not trusted for {lost:.1f} s: {', '.join(kinds)}{shown}."))
    return f"{head}\n{format_table(columns, rows)}"


def count_words(number: int, one: str, many: str) -> str:
    """Return a number with its noun."""
    return f"{number} {one if number == 1 else many}"
