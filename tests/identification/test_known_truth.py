"""Logs of robots whose truth is known: what is identified, against it.

The long form identifies 20 robots of the whole range, and 200 logs of 75 commands each of another
robot, whose boxes must hold the true slips of new commands as often as they promise.
"""

from typing import NamedTuple

import numpy as np
import pytest
from scipy import stats
from simulated_robots import draw_robot, draw_windows, share_inside

from jaxtube.identification.findings import inspect_log
from jaxtube.identification.geometry import find_sideslip, find_slips
from jaxtube.identification.identify import Choices, Identified, identify_log, identify_windows
from jaxtube.identification.simulated.drive import Truth, drive
from jaxtube.identification.simulated.log import record

TRACK = 0.02
"""Relative."""
LAG_S = 0.02
LATE_S = 0.3
"""Between a jump and its cut: a pose or two."""
NEW_COMMANDS = 4000
CHANCE = 1e-4
"""With which a repeated test fails though the law holds."""


class Answer(NamedTuple):
    """What was identified of one log, against the truth."""

    promised: float
    inside: float  # share of new commands whose true slips lie in the box
    track: float  # relative error
    lag: float  # error, s
    late: float  # offset of the clocks less the true delay of poses, s
    row: float  # s
    missed_jumps: int


def answer(index: int, commands: int) -> Answer:
    """Drive a robot, identify its log, and compare."""
    truth, sensors = draw_robot(index)
    simulated = record(drive(truth, commands, index), sensors, index)
    findings = inspect_log(simulated.log, 2.0)
    identified = identify_log(findings, Choices())
    assert findings.response is not None
    cuts = findings.cuts.cuts
    seen = [
        any(cut.start - LATE_S <= time <= cut.end + LATE_S for cut in cuts)
        for time in simulated.jump_times
    ]
    return Answer(
        promised=identified.promise.share,
        inside=share_inside(truth, identified.box, NEW_COMMANDS, index),
        track=identified.geometry.track / truth.effective_track - 1.0,
        lag=findings.response.lag - truth.wheel_lag,
        late=findings.clock.offset - sensors.pose_delay,
        row=1.0 / sensors.wheel_rate,
        missed_jumps=seen.count(False),
    )


def check(found: Answer) -> None:
    assert abs(found.track) < TRACK
    assert abs(found.lag) < LAG_S
    # A row shows a pose that arrived since the row before it.
    assert -LAG_S < found.late < found.row + LAG_S
    assert found.missed_jumps == 0


def test_a_robot_is_identified():
    found = answer(0, 100)
    check(found)
    assert found.inside >= found.promised


@pytest.mark.slow
@pytest.mark.parametrize("index", range(20))
def test_robots_of_the_whole_range_are_identified(index):
    found = answer(index, 240)
    print(
        f"track {100 * found.track:+.2f} %, lag {1000 * found.lag:+.1f} ms, "
        f"inside {found.inside:.3f}, promised {found.promised:.3f}"
    )
    check(found)


@pytest.mark.slow
def test_boxes_of_logs_hold_true_slips_as_often_as_they_promise():
    answers = [answer(1000 + k, 75) for k in range(200)]
    report([found.promised for found in answers], [found.inside for found in answers])


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["each", "alike", "scaled"])
def test_boxes_of_windows_without_noise_hold_new_commands_as_often_as_they_promise(kind):
    truth = Truth(effective_track=0.8, lever_arm=-0.1, slip=((0.0, 0.1), (0.05, 0.12)))
    promised = []
    inside = []
    for seed in range(200):
        found = identify_windows(draw_windows(truth, 45, seed), Choices(box=kind))
        promised.append(found.promise.share)
        inside.append(share_of_windows(found, truth, 10_000 + seed))
    report(promised, inside)


def share_of_windows(found: Identified, truth: Truth, seed: int) -> float:
    """Return the share of new commands whose windows, as the identified track sees them, all lie in
    the box."""
    new = draw_windows(truth, NEW_COMMANDS, seed)
    slips = find_slips(new.wheels, new.velocity, found.geometry.track)
    side = find_sideslip(new.velocity, found.geometry.lever_arm)
    return float(np.mean(found.box.holds(slips, side).reshape(NEW_COMMANDS, -1).all(axis=1)))


def report(promised: list[float], inside: list[float]) -> None:
    """Print the coverage beside the promise; fail where it is below more often than one in twenty,
    by more than chance allows."""
    below = int(np.sum(np.array(inside) < np.array(promised)))
    print(
        f"promised {np.mean(promised):.3f}, inside {np.mean(inside):.3f} (least "
        f"{np.min(inside):.3f}), below the promise in {below} of {len(inside)}"
    )
    assert below <= stats.binom.ppf(1 - CHANCE, len(inside), 0.05)
