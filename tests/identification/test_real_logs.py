"""Records of real robots: what is identified of them, and what is refused.

They lie beside the repository, or where JAXTUBE_DATA says, and are no part of the project.
"""

import os
from pathlib import Path

import numpy as np
import pytest

from jaxtube.identification.findings import inspect_log
from jaxtube.identification.identify import Choices, identify_log, identify_windows
from jaxtube.recordings.reading import read_log
from jaxtube.recordings.window_table import read_windows
from jaxtube.scenario import ScenarioError

DATA = Path(os.environ.get("JAXTUBE_DATA", Path(__file__).parents[2] / "../shared/data"))
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason="no records of real robots")

HUSKY_TRACK_M = 0.5385
MARMOTTE_TRACK_M = 0.52


def windows_of(**select):
    return read_windows(DATA / "slip_windows.csv", select)


def findings_of(name):
    return inspect_log(read_log(DATA / "logs" / name), 2.0)


def test_a_husky_on_tile_turns_on_nearly_twice_its_track():
    found = identify_windows(windows_of(robot="husky"), Choices())
    assert found.geometry.track / HUSKY_TRACK_M == pytest.approx(1.8, abs=0.12)
    assert found.geometry.explained > 0.9
    assert found.box.right[0] > -0.15
    assert found.box.left[1] < 0.2
    assert found.box.sideslip < 0.1
    # From the 24 commands of 200 that drive both wheels forwards, a third of them for the track.
    assert found.promise.commands == 16
    assert found.promise.share == pytest.approx(0.515, abs=0.001)


def test_a_tracked_robot_in_the_forest_is_identified():
    found = identify_windows(windows_of(robot="marmotte"), Choices())
    assert found.geometry.track / MARMOTTE_TRACK_M == pytest.approx(1.15, abs=0.05)
    assert found.box.sideslip < 0.15
    assert found.promise.share == pytest.approx(0.68, abs=0.01)


def test_a_robot_that_slides_on_ice_is_refused_for_how_it_turns():
    with pytest.raises(
        ScenarioError, match="yaw rate that wheels explain through an effective track"
    ):
        identify_windows(windows_of(robot="warthog", terrain="ice"), Choices())


def test_the_cleanest_log_has_poses_a_tenth_of_a_second_late():
    findings = findings_of("warthog_asphalt.csv")
    assert findings.clock.offset == pytest.approx(0.1, abs=0.02)
    assert findings.pose_period == pytest.approx(0.1, abs=0.01)
    assert findings.held_share == pytest.approx(0.5, abs=0.02)
    assert findings.cuts.of_kind("lost") == []
    assert findings.cuts.of_kind("gap") == []
    with pytest.raises(ScenarioError, match="commands = 1: of 14 steady ones"):
        identify_log(findings, Choices())


def test_late_poses_at_four_hertz_are_found():
    findings = findings_of("warthog_grass.csv")
    assert 0.2 <= findings.clock.offset <= 0.3
    assert len(findings.cuts.of_kind("gap")) > 10


def test_a_pose_that_is_lost_is_found_where_it_leaves_the_wheels_behind():
    log = read_log(DATA / "logs" / "husky_wetgrass.csv")
    findings = inspect_log(log, 2.0)
    lost = findings.cuts.of_kind("lost")
    worst = max(lost, key=lambda cut: cut.largest)
    # An independent look: from when on the pose is further off after two seconds than wheels roll.
    at = np.arange(50.0, 130.0, 0.1)
    went = _find_way(log.pose_time, log.poses[:, :2], at)
    rolled = np.abs(log.wheels).max(axis=1)
    could = np.array([rolled[(log.time >= t) & (log.time < t + 2.0)].max() for t in at]) * 2.0
    wild = at[went > 2.0 * could + 1.0]
    assert abs(worst.start - (wild[0] + 2.0)) <= 2.0
    assert abs(worst.end - wild[-1]) <= 6.0
    assert worst.largest > 12.0


def _find_way(time, places, at):
    """Return how far places lie apart that are two seconds apart."""
    first = np.searchsorted(time, at)
    last = np.searchsorted(time, at + 2.0)
    return np.linalg.norm(places[last] - places[first], axis=1)
