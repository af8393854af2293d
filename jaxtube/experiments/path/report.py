"""The report of `path`: what the file was read as, what was cut, changed and refused, and the
missions with what their wheels do."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from jaxtube.experiments.run.page_table import make_table
from jaxtube.experiments.run.table import Column, format_table, left, wrap
from jaxtube.paths.driving import Drive, Mission
from jaxtube.paths.missions import PathPlan
from jaxtube.paths.rows import polygon_length
from jaxtube.recordings.path import RawPath
from jaxtube.reporting.page import Listing, Page, Part, Section

STANDSTILL = 1e-6
"""Speed in m/s that is none."""

SAME_SPEED = 0.01
"""Share by which a speed may differ from the one asked for without a word."""

STRAIGHT = 1e4
"""Radius in m from which on a path is straight."""

COLUMNS = (
    left("mission"),
    left("from"),
    Column("length", "m"),
    Column("time", "s"),
    Column("speed", "m/s"),
    Column("radius", "m"),
    Column("wheels", "m/s"),
    Column("change", "m/s²"),
    Column("off", "m"),
    Column("rms", "m"),
)
LEGEND = (
    "off, rms: largest distance of a row of the file from the driven arcs, and the root mean "
    "square of all; radius: the tightest; wheels, change: least and greatest speed of a wheel, and "
    "greatest change of one from a period to the next over dt."
)


def report(raw: RawPath, plan: PathPlan, drive: Drive, names: list[str]) -> str:
    """Return what became of a path as text.

    Args:
        raw: the path as its file has it.
        plan: what becomes of it.
        drive: how it was to be driven.
        names: of the missions.
    """
    lines = [say_verdict(plan), "", *wrap(_describe_file(raw), "  ")]
    lines += ["", *_note_lines(plan), ""]
    if plan.missions:
        lines += [_table(plan, names), "", *wrap(LEGEND), "", *_proof_lines(plan, drive), ""]
        lines += _start_lines(plan, drive)
    else:
        lines.append("no mission is left")
    return "\n".join(lines)


def say_verdict(plan: PathPlan) -> str:
    """Return one line: what became of a path."""
    refused = f"{len(plan.refused)} stretches refused" if plan.refused else "nothing refused"
    if not plan.missions:
        return f"no mission is left; {refused}"
    count = len(plan.missions)
    length = sum(mission.fit.curve.length for mission in plan.missions)
    rows = max(mission.deviations.from_rows for mission in plan.missions)
    return (
        f"{count} {'mission' if count == 1 else 'missions'} of {length:.2f} m in all, {refused}; "
        f"at most {rows:.4f} m off the file"
    )


def make_page(raw: RawPath, plan: PathPlan, names: list[str]) -> Page:
    """Return the page of a path."""
    count = len(plan.missions)
    told = [str(note) for note in plan.notes]
    refused = [str(reason) for reason in plan.refused]
    parts: list[Part] = []
    if told:
        parts.append(Listing(told, "Cut and changed"))
    if refused:
        parts.append(Listing(refused, "Refused"))
    if count:
        parts.append(make_table(COLUMNS, _rows(plan, names), "Missions", LEGEND))
    section = Section("What became of the path", parts)
    tone = "good" if count else "bad"
    return Page(say_verdict(plan), tone, [f"{_describe_file(raw)}."], [section])


def _describe_file(raw: RawPath) -> str:
    rows = f"{len(raw.lines):,} rows"
    time = "no time" if raw.time is None else f"{np.ptp(raw.time):.1f} s"
    length = polygon_length(raw.positions)
    text = f"{Path(raw.path).name}: {rows}, {time}, {length:.2f} m from row to row"
    guesses = "; ".join(raw.guesses)
    return f"{text}; {guesses}" if guesses else text


def _note_lines(plan: PathPlan) -> list[str]:
    """Return what was cut and changed, then what was refused."""
    if not plan.notes and not plan.refused:
        return ["nothing was cut or changed but smoothed"]
    lines = []
    if plan.notes:
        lines.append("cut and changed")
        for note in plan.notes:
            lines += wrap(f"  {note}", "    ")
    if plan.refused:
        lines.append("refused")
        for refused in plan.refused:
            lines += wrap(f"  {refused.note}", "    ")
    return lines


def _table(plan: PathPlan, names: list[str]) -> str:
    return format_table(COLUMNS, _rows(plan, names))


def _rows(plan: PathPlan, names: list[str]) -> list[list[str]]:
    return [_row(name, mission) for name, mission in zip(names, plan.missions, strict=True)]


def _row(name: str, mission: Mission) -> list[str]:
    speeds = mission.reference.wheels[: mission.reference.steps].mean(axis=1)
    use = mission.use
    deviations = mission.deviations
    return [
        f"{name.removeprefix('mission-')}{', closed' if mission.fit.curve.closed else ''}",
        str(mission.start).split(",")[0],
        f"{mission.fit.curve.length:.2f}",
        f"{mission.reference.steps * mission.reference.dt:.6g}",
        _say_range(speeds.min(), speeds.max()),
        f"{mission.least_radius:.3g}" if mission.least_radius < STRAIGHT else "straight",
        _say_range(use.least, use.greatest),
        f"{use.acceleration:.3g}",
        f"{deviations.from_rows:.4f}",
        f"{deviations.rms_from_rows:.4f}",
    ]


def _say_range(low: float, high: float) -> str:
    """Return a range in three digits, one number where both are the same."""
    least = f"{low:.3g}"
    greatest = f"{high:.3g}"
    return least if least == greatest else f"{least}\u2013{greatest}"


def _proof_lines(plan: PathPlan, drive: Drive) -> list[str]:
    """Return what was checked of the held wheel speeds."""
    limits = drive.limits
    uses = [mission.use for mission in plan.missions]
    least = min(use.least for use in uses)
    greatest = max(use.greatest for use in uses)
    change = max(use.acceleration for use in uses)
    periods = sum(len(mission.reference.wheels) for mission in plan.missions)
    bound = "no limit is set (robot.wheel_acceleration_max_mps2)"
    if limits.acceleration is not None:
        bound = f"the limit over ground is {limits.acceleration:.4g} m/s^2"
    arcs = max(mission.deviations.from_curve for mission in plan.missions)
    rows = max(mission.deviations.from_rows for mission in plan.missions)
    return [
        *wrap(
            f"checked in all {periods:,} periods, previews included: the held wheel speeds lie in "
            f"[{least:.6g}, {greatest:.6g}] m/s, the box is "
            f"[{limits.least:.6g}, {limits.greatest:.6g}] m/s; they change by {change:.4g} m/s^2 "
            f"or less, {bound}"
        ),
        *_speed_lines(plan, drive),
        *wrap(
            f"largest deviation: {rows:.4f} m from a row of the file (the smooth path may be "
            f"{drive.largest_deviation:.3g} m off), {arcs:.1g} m from the smooth path"
        ),
    ]


def _speed_lines(plan: PathPlan, drive: Drive) -> list[str]:
    """Return that speeds differ from those asked for, where they do."""
    if drive.recorded_timing and plan.raw.time is not None:
        return wrap(
            "speeds are those of the recording, over a second or more, as far as the limits of the "
            "wheels allow; time that the robot stands is left out"
        )
    means = [mission.reference.wheels.mean(axis=1) for mission in plan.missions]
    speeds = np.concatenate(means)
    if np.abs(speeds / drive.speed - 1.0).max() < SAME_SPEED:
        return []
    return wrap(
        f"asked for: {drive.speed:.3g} m/s along the path; the limits of the wheels leave "
        f"{_say_range(float(speeds.min()), float(speeds.max()))} m/s"
    )


def _start_lines(plan: PathPlan, drive: Drive) -> list[str]:
    """Return how fast missions begin and end, and what that means for a certificate."""
    if drive.limits.least <= STANDSTILL:
        return []
    starts = [float(mission.reference.wheels[0].mean()) for mission in plan.missions]
    return wrap(
        f"missions begin and end at speed, {_say_range(min(starts), max(starts))} m/s at the "
        f"start: wheels of the reference never run below {drive.limits.least:.3g} m/s, and a "
        "certificate holds for references in that box. A robot that stands has to reach speed "
        "before the start and to brake beyond the end; both lie outside of any certificate."
    )


def metrics(plan: PathPlan, drive: Drive) -> dict:
    """Return what became of a path as plain numbers and texts."""
    return {
        "missions": [_mission_metrics(mission) for mission in plan.missions],
        "refused": [str(refused.note) for refused in plan.refused],
        "changed": [str(note) for note in plan.notes],
        "largest_deviation_m": drive.largest_deviation,
        "wheel_speed_min_mps": drive.limits.least,
        "wheel_speed_max_mps": drive.limits.greatest,
        "reference_acceleration_max_mps2": drive.limits.acceleration,
    }


def _mission_metrics(mission: Mission) -> dict:
    return {
        "start": str(mission.start),
        "begins": mission.piece.begins,
        "ends": mission.piece.ends,
        "closed": mission.fit.curve.closed,
        "length_m": mission.fit.curve.length,
        "duration_s": mission.reference.steps * mission.reference.dt,
        "smoothing_m": mission.fit.smoothing,
        "tightest_radius_m": mission.least_radius,
        "least_wheel_mps": mission.use.least,
        "greatest_wheel_mps": mission.use.greatest,
        "greatest_wheel_acceleration_mps2": mission.use.acceleration,
        "largest_off_rows_m": mission.deviations.from_rows,
        "rms_off_rows_m": mission.deviations.rms_from_rows,
        "largest_off_curve_m": mission.deviations.from_curve,
    }
