"""Spans of simulated logs: one after another, of their kinds, with the wheels' way in between."""

import numpy as np
import pytest
from made_logs import find, make_log, scenario

from jaxtube.identification.simulated.log import Sensors
from jaxtube.witness.spans import KINDS, cut_spans


@pytest.fixture(scope="module")
def findings():
    return find(make_log(sensors=Sensors(jumps=1, lost=((30.0, 33.0),))))


@pytest.mark.parametrize(("length", "pieces"), [(0.1, 1), (0.5, 5), (0.03, 1)])
def test_spans_follow_each_other(findings, length, pieces):
    spans = cut_spans(findings, scenario(), length)
    np.testing.assert_array_equal(spans.start[1:], spans.end[:-1])
    np.testing.assert_array_equal(spans.first[1:], spans.last[:-1])
    assert spans.pieces == pieces and spans.ways.shape[1] % pieces == 0
    assert np.median(spans.duration) == pytest.approx(max(length, findings.pose_period), rel=0.05)


def test_ways_are_those_of_the_wheels_when_the_poses_were_taken(findings):
    spans = cut_spans(findings, scenario(), 0.1)
    time = findings.log.time
    k = int(np.flatnonzero(spans.is_kind("steady"))[100])
    fine = np.linspace(spans.start[k], spans.end[k], 1001) - findings.clock.offset
    for wheel in range(2):
        speed = np.interp(fine, time, findings.log.wheels[:, wheel])
        way = np.trapezoid(speed, fine)
        assert spans.ways[k, :, wheel].sum() == pytest.approx(way, rel=1e-3)


def test_every_span_has_the_kind_that_its_wheels_and_poses_tell(findings):
    spans = cut_spans(findings, scenario(), 0.1)
    speed = spans.ways.sum(axis=1) / spans.duration[:, None]
    for cut in findings.cuts.cuts:
        touches = (spans.end > cut.start) & (spans.start < cut.end)
        assert touches.any() and spans.is_kind("lost")[touches].all()
    standing = spans.is_kind("standing")
    assert standing.any() and np.abs(speed[standing]).max() < 0.02
    judged = spans.is_kind("steady", "changing")
    assert speed[judged].min() >= 0.2 and speed[judged].max() <= 1.05
    beyond = spans.is_kind("beyond")
    assert beyond.any() and np.all(np.abs(speed[beyond]).max(axis=1) >= 0.02)
    assert sum(spans.is_kind(kind).sum() for kind in KINDS) == len(spans.start)


def test_changing_spans_lie_around_changes_of_command(findings):
    spans = cut_spans(findings, scenario(), 0.1)
    log = findings.log
    changes = log.time[1:][np.diff(log.step) != 0]
    steady = spans.is_kind("steady")
    since = [np.min(np.abs(changes - start)) for start in spans.start[spans.is_kind("changing")]]
    assert steady.sum() > 100 and np.median(since) < 2.0
    settled = spans.ways[steady] * spans.ways.shape[1] / spans.duration[steady, None, None]
    assert np.ptp(settled, axis=1).max() < 0.1


def test_slip_may_change_within_a_span_that_is_longer_than_a_period():
    slow = find(make_log(sensors=Sensors(pose_rate=4.0), commands=10))
    spans = cut_spans(slow, scenario(), 0.1)
    assert np.median(spans.duration) == pytest.approx(0.25, rel=0.1)
    assert spans.pieces in (2, 3)
