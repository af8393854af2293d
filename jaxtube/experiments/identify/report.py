"""What the command `identify` reports: the promise first, then what was found, and what is not
covered."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxtube.experiments.run.table import WIDTH, Column, format_table, left, wrap
from jaxtube.identification.box import Box
from jaxtube.identification.findings import Findings, Noise
from jaxtube.identification.identify import Identified
from jaxtube.identification.scenario_text import LEAST_EXPLAINED, find_track_width
from jaxtube.identification.uncovered import find_uncovered
from jaxtube.identification.words import say_other_boxes, say_promise, say_sample

MOST_CUTS = 12
"""That are listed one by one."""

Row = tuple[str, str, str, str]


def report(identified: Identified, findings: Findings | None, track_width: float | None) -> str:
    """Return the report."""
    promise = say_promise(identified)
    parts = [
        promise,
        "\n".join(wrap(say_sample(identified))),
        "\n".join(wrap(say_other_boxes(identified))),
        _tabulate(_robot_rows(identified, findings, track_width)),
        say_log(findings) if findings else "",
        "\n".join(_say_limits(identified)),
        "\n".join(wrap(f"Read: {'; '.join(identified.windows.guesses)}", "  "))
        if identified.windows.guesses
        else "",
    ]
    return "\n\n".join(part for part in parts if part)


def say_log(findings: Findings) -> str:
    """Return what was found of the sensors and actuators of a log."""
    parts = [_tabulate(_sensor_rows(findings)), _say_cuts(findings)]
    if findings.log.guesses:
        parts.append("\n".join(wrap(f"Read: {'; '.join(findings.log.guesses)}", "  ")))
    return "\n\n".join(parts)


def _tabulate(rows: list[Row]) -> str:
    columns = [left("quantity"), Column("value"), left("uncertainty"), left("from")]
    return format_table(columns, rows, WIDTH)


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
    beyond = f"{100 * margin:g} % beyond the extremes, not promised" if margin else ""
    noise = identified.slip_noise
    spread = beyond if noise is None else f"pose noise alone +- {100 * noise:.2g} %"
    known = source.startswith("not known")
    times = "" if known else f"; {geometry.track / width:.3g} times {width:.4g} m, {source}"
    return [
        ("slip of the right wheel", _say_interval(box.right), spread, counted),
        ("slip of the left wheel", _say_interval(box.left), beyond or spread, counted),
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
    if response.explained < LEAST_EXPLAINED:
        reason = f"{changes}: no first-order lag"
        return [("wheels behind commands", "unknown", "", reason)]
    least, greatest = response.lag_interval
    return [
        (
            "wheels behind commands",
            f"{response.lag:.3f} s",
            f"{least:.3f} to {greatest:.3f} s in single changes",
            f"first-order lag; {changes}",
        ),
        (
            "dead time of commands",
            f"{response.delay:.3f} s",
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
        f"{noise.poses} poses about the arcs of their windows",
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
        _count(len(findings.cuts.of_kind(kind)), one, many)
        for kind, one, many in (
            ("lost", "stretch in which the pose was lost", "stretches in which it was lost"),
            ("gap", "gap", "gaps"),
            ("jump", "single jump", "single jumps"),
        )
    ]
    shown = f"; the {len(rows)} that matter most" if len(rows) < len(cuts) else ""
    head = "\n".join(wrap(f"Pose not trusted for {lost:.1f} s: {', '.join(kinds)}{shown}."))
    return f"{head}\n{format_table(columns, rows)}"


def _count(number: int, one: str, many: str) -> str:
    return f"{number} {one if number == 1 else many}"


def _say_limits(identified: Identified) -> list[str]:
    """Return what the promise does not cover."""
    uncovered = find_uncovered(identified)
    lines = ["Not covered by the promise:"]
    lines += wrap(
        "* slips within a window: what is promised is their mean over it; lag, noise and anything "
        "the drive did not meet (other ground, load, speed)"
    )
    if identified.slip_noise is not None:
        lines += wrap(
            "* which part of an interval is slip: pose noise spreads the slips of windows by "
            f"{100 * identified.slip_noise:.2g} % (one standard deviation, median), so that the "
            "intervals are wider than slip alone is, the more the slower a wheel turns"
        )
    if uncovered.on_the_spot:
        low, middle, high = uncovered.spot_track
        lines += wrap(
            f"* turning on the spot, {_count(uncovered.on_the_spot, 'command', 'commands')}: there "
            f"wheels differ by {middle:.3g} m times the yaw rate, slip included ({low:.3g} to "
            f"{high:.3g} m in 80 % of windows)"
        )
    if uncovered.reversing:
        lines += wrap(f"* reversing, {_count(uncovered.reversing, 'command', 'commands')}")
    if uncovered.changing:
        share = uncovered.changing_inside / uncovered.changing
        lines += wrap(
            "* changing speed: of windows that drive forwards but not steadily, "
            f"{100 * share:.0f} % of {uncovered.changing} lie inside the box"
        )
    return lines


def metrics(
    identified: Identified, findings: Findings | None, track_width: float | None
) -> dict[str, Any]:
    """Return the numbers of an identification."""
    geometry = identified.geometry
    promise = identified.promise
    width, _ = find_track_width(identified, findings, track_width)
    return {
        "promised_share": promise.share,
        "confidence": promise.confidence,
        "commands": promise.commands,
        "sides": promise.sides,
        "commands_for_95_percent": promise.count_needed(0.95),
        "fitted_commands": len(np.unique(identified.windows.command[identified.fits])),
        **_measure_box(identified.widened_box),
        "slip_noise": identified.slip_noise,
        "effective_track_m": geometry.track,
        "effective_track_standard_error_m": geometry.track_error,
        "effective_track_by_track": geometry.track / width,
        "lever_arm_m": geometry.lever_arm,
        "lever_arm_standard_error_m": geometry.lever_arm_error,
        "crab_angle_rad": geometry.crab,
        "yaw_rate_explained": geometry.explained,
        "least_wheel_mps": identified.least_wheel,
        "fastest_wheel_mps": identified.fastest_wheel,
        "log": _measure_log(findings) if findings else None,
    }


def _measure_box(box: Box) -> dict[str, Any]:
    return {"slip_right": box.right, "slip_left": box.left, "sideslip": box.sideslip}


def _measure_log(findings: Findings) -> dict[str, Any]:
    response = findings.response
    noise = findings.noise
    return {
        "poses_behind_wheels_s": findings.clock.offset,
        "poses_behind_wheels_standard_error_s": findings.clock.standard_error,
        "correlation": findings.clock.correlation,
        "wheel_lag_s": response.lag if response else None,
        "wheel_lag_interval_s": response.lag_interval if response else None,
        "command_delay_s": response.delay if response else None,
        "wheel_response_explained": response.explained if response else None,
        "wheel_period_s": findings.wheel_period,
        "pose_period_s": findings.pose_period,
        "held_share": findings.held_share,
        "pose_noise_m": noise.deviation[0] if noise else None,
        "pose_noise_rad": noise.deviation[1] if noise else None,
        "pose_noise_bound_m": noise.bound[0] if noise else None,
        "pose_noise_bound_rad": noise.bound[1] if noise else None,
        "cuts": [cut._asdict() for cut in findings.cuts.cuts],
    }
