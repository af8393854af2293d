"""References along files: `[reference] shape = "file"`.

A mission that `path` has written is driven as it was checked. A clean recording keeps its own
timing, as long as that keeps the wheels within their limits. Anything else is cleaned, cut and
given speeds, and what was changed is told; where that leaves more than one mission, or none, the
file is refused.

Source: new.
"""

from __future__ import annotations

import warnings

from jaxtube.paths.driving import Drive, Mission
from jaxtube.paths.mission_file import read_mission
from jaxtube.paths.missions import PathPlan, plan_path
from jaxtube.paths.places import PathWarning, place_of
from jaxtube.paths.profile import WheelLimits
from jaxtube.paths.proof import find_excess, find_use
from jaxtube.plant.recorded_reference import follow_recording
from jaxtube.plant.reference import Reference
from jaxtube.recordings.reading import read_path
from jaxtube.scenario.tree import Scenario

LARGEST_SHARE = 0.2
"""Largest deviation of a cleaned path from its file in track widths, where none is given."""


MOST_NOTES = 3
"""Changes that are told one by one."""


def limits_of(scenario: Scenario) -> WheelLimits:
    """Return what the wheels of a scenario's reference may do."""
    most = scenario.robot.wheel_acceleration_max_mps2
    if most is not None:
        # What a wheel is told is more than its speed over ground where it slips.
        most *= 1 - max(scenario.slip.nominal)
    return WheelLimits(
        least=scenario.reference.wheel_speed_min_mps,
        greatest=scenario.reference.wheel_speed_max_mps,
        acceleration=most,
        track_width=scenario.robot.turning_track_m,
    )


def drive_of(scenario: Scenario) -> Drive:
    """Return how a scenario drives along its file."""
    limits = limits_of(scenario)
    return Drive(
        limits=limits,
        dt=scenario.controller.dt_s,
        preview=scenario.controller.horizon + 1,
        speed=scenario.reference.speed_mps,
        largest_deviation=LARGEST_SHARE * limits.track_width,
        recorded_timing=True,
        through_stops=True,
        duration=scenario.reference.duration_s,
    )


def follow_file(scenario: Scenario) -> Reference:
    """Return the reference along the file of a scenario.

    Raises:
        ValueError: in one line, for a file that cannot be read, and for a path that cannot be
            driven in one go: with time and place, and what helps.
    """
    file = scenario.reference.file
    drive = drive_of(scenario)
    width = drive.limits.track_width
    mission = read_mission(file, drive.dt, drive.preview, width, drive.duration)
    if mission is not None:
        return mission
    raw = read_path(file)
    try:
        reference = follow_recording(raw, drive.dt, drive.preview, width, drive.duration)
    except ValueError as error:
        reason = str(error).removeprefix(f"{file}: ")
    else:
        use = find_use(reference)
        if find_excess(use, drive.limits) == (0.0, 0.0):
            return reference
        reason = (
            f"its own timing asks the wheels for {use.least:.4g} to {use.greatest:.4g} m/s, "
            f"changing by up to {use.acceleration:.3g} m/s^2"
        )
    plan = plan_path(raw, drive)
    mission = _take_only_mission(file, plan)
    warnings.warn(_tell(file, reason, plan, mission), PathWarning, stacklevel=2)
    return mission.reference


def _take_only_mission(file: str, plan: PathPlan) -> Mission:
    """Return the mission that a path is; refuse one that is none, or more than one."""
    if plan.refused:
        raise ValueError(f"{file}: {plan.refused[0].note}")
    if not plan.missions:
        raise ValueError(f"{file}: {'; '.join(map(str, plan.notes[:MOST_NOTES]))}")
    if len(plan.missions) > 1:
        second = plan.missions[1].piece
        raise ValueError(
            f"{file}: {place_of(second.raw, 0)}: {second.begins}; run `path` on the file, which "
            f"writes its {len(plan.missions)} missions to files of their own, and name one of them"
        )
    return plan.missions[0]


def _tell(file: str, reason: str, plan: PathPlan, mission: Mission) -> str:
    """Return in one line how a file is driven that is not driven as it is."""
    notes = [str(note) for note in plan.notes[:MOST_NOTES]]
    more = len(plan.notes) - len(notes)
    if more > 0:
        notes.append(f"{more} more")
    text = "; ".join([reason.split("; ")[0], *notes])
    return (
        f"{file}: driven within {mission.deviations.from_rows:.3g} m of its rows, not as recorded: "
        f"{text}; `path` on the file shows all"
    )
