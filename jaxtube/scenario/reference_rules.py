"""Rules on the reference: its box of wheel speeds, its duration, its file.

Two circles of radius r at speed V ask the wheels for V (1 +- b / (2 r)); both speeds lie in the
reference's box. Where the mean speed of the wheels is 0 the lateral error cannot be steered, so
that no gain stabilises a model over a box that reaches there.
"""

import os
from pathlib import Path
from typing import NoReturn

from jaxtube.scenario.refusal import Refuse, refusal
from jaxtube.scenario.tree import ReferenceTable, Scenario

SPEED_ROUNDING = 1e-9
"""Share of the greatest speed by which a wheel may pass the box: both are rounded numbers."""

MOST_PERIODS = 1_000_000
"""Most periods of a run: a day at 10 Hz has fewer, and one lap still fits into 1 GB."""


def check_reference(scenario: Scenario, refuse: Refuse) -> None:
    """Refuse the first key of the reference that breaks a rule."""
    _check_slowest(scenario, refuse)
    _check_duration(scenario, refuse)
    reference = scenario.reference
    if reference.shape == "file":
        _check_file(reference.file, refuse)
    elif reference.file:
        problem = f'is not read, because reference.shape is "{reference.shape}"'
        refuse("reference.file", problem, 'set reference.shape = "file", or leave the file out')
    if reference.shape == "two_circles":
        turn = scenario.robot.turning_track_m / (2 * reference.radius_m)
        slowest = reference.speed_mps * (1 - turn)
        fastest = reference.speed_mps * (1 + turn)
        _check_wheels(reference, slowest, fastest, refuse)


def check_reference_wheels(scenario: Scenario, slowest_mps: float, fastest_mps: float) -> None:
    """Refuse a reference whose wheels leave the box that the reference promises.

    Args:
        scenario: whose box is meant.
        slowest_mps: least speed of the two wheels over the whole reference.
        fastest_mps: greatest one.

    Raises:
        ScenarioError: one line.
    """

    def refuse(key: str, problem: str, cure: str) -> NoReturn:
        raise refusal("scenario", key, scenario.reference.speed_mps, problem, cure)

    _check_wheels(scenario.reference, slowest_mps, fastest_mps, refuse)


def is_in_box(reference: ReferenceTable, slowest_mps: float, fastest_mps: float) -> bool:
    """Return whether wheel speeds lie in the box of the reference, up to rounding; NaN does not."""
    low = reference.wheel_speed_min_mps
    high = reference.wheel_speed_max_mps
    rounding = SPEED_ROUNDING * max(abs(low), abs(high))
    return low - rounding <= slowest_mps and fastest_mps <= high + rounding


def _check_wheels(
    reference: ReferenceTable, slowest: float, fastest: float, refuse: Refuse
) -> None:
    if is_in_box(reference, slowest, fastest):
        return
    low = reference.wheel_speed_min_mps
    high = reference.wheel_speed_max_mps
    problem = (
        f"the reference wheels run {slowest:.6g} to {fastest:.6g} m/s, outside "
        "[reference.wheel_speed_min_mps, reference.wheel_speed_max_mps] = "
        f"[{low:.6g}, {high:.6g}]"
    )
    cure = "change the speed, turn less sharply, or widen the box"
    refuse("reference.speed_mps", problem, cure)


def _check_slowest(scenario: Scenario, refuse: Refuse) -> None:
    low = scenario.reference.wheel_speed_min_mps
    covers_box = scenario.reference.certified_for == "box"
    has_gains = scenario.controller.tracking_gains or scenario.controller.vertex_gains
    if low <= 0 and (covers_box or not has_gains):
        problem = "lets the reference stand, where no gain can steer the lateral error"
        refuse("reference.wheel_speed_min_mps", problem, "raise it above 0")


def _check_duration(scenario: Scenario, refuse: Refuse) -> None:
    duration = scenario.reference.duration_s
    dt = scenario.controller.dt_s
    if duration is None:
        return
    if duration < dt:
        problem = f"is shorter than one step, controller.dt_s = {dt}"
        refuse("reference.duration_s", problem, "run for at least one step")
    if duration > MOST_PERIODS * dt:
        problem = f"has {duration / dt:.3g} steps of controller.dt_s = {dt}"
        cure = f"run for {MOST_PERIODS:,} steps at most, {MOST_PERIODS * dt:.6g} s"
        refuse("reference.duration_s", problem, cure)


def _check_file(file: str, refuse: Refuse) -> None:
    if not file:
        problem = 'is empty, and reference.shape is "file"'
        refuse("reference.file", problem, "name the file, or choose another shape")
    if os.path.isdir(file):
        return  # a bag
    check_readable("reference.file", file, refuse)


def check_readable(key: str, file: str, refuse: Refuse) -> None:
    """Refuse a key that names a file which cannot be read."""
    try:
        Path(file).open("rb").close()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        cure = (
            "name a readable file: a path starts at the folder of the scenario file, "
            "in an override at the current folder"
        )
        refuse(key, f"cannot be read ({reason})", cure)
