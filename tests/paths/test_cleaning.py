"""Laws of cleaning: rows in order, cells that hold stops, breaks where the robot does not drive
on."""

import numpy as np
import pytest
from made_paths import BENDS, add_noise, circle, corner, drive, shuffle, stand, there_and_back

from jaxtube.paths.breaks import find_breaks
from jaxtube.paths.cells import arc_lengths, find_radius, make_chain
from jaxtube.paths.closing import close
from jaxtube.paths.pieces import cut_path
from jaxtube.paths.rows import arrange_rows, measure_noise, polygon_length
from jaxtube.recordings.path import RawPath

TRACK_WIDTH = 0.5
LENGTH = sum(bend[0] for bend in BENDS)


def raw_of(made, with_headings=False):
    time, positions, headings = made
    return RawPath(
        path="made.csv",
        time=time - time[0],
        positions=positions,
        headings=headings if with_headings else None,
        lines=np.arange(len(time)) + 2,
        word="line",
    )


def breaks_of(raw):
    radius = find_radius(raw.positions, TRACK_WIDTH)
    return find_breaks(raw, make_chain(raw.positions, radius), TRACK_WIDTH)


@pytest.mark.parametrize("deviation", [0.0, 0.003, 0.02, 0.05])
def test_noise_is_measured_on_curves_too(deviation):
    positions = add_noise(circle(radius=2.0, turns=3.0), deviation)[1]
    # The curve itself lies off its chords by 0.1^2 / (8 * 2) m, at each row the same.
    assert measure_noise(positions) == pytest.approx(deviation, rel=0.2, abs=1e-6)


def test_the_chain_of_a_drive_is_as_long_as_the_drive_however_it_jitters_and_stands():
    made = add_noise(stand(drive(speed=0.3), 300, 60.0), 0.02)
    positions = made[1]
    chain = make_chain(positions, find_radius(positions, TRACK_WIDTH))
    assert polygon_length(positions) > 2.0 * LENGTH
    assert arc_lengths(positions, chain)[-1] == pytest.approx(LENGTH, rel=0.03)
    assert (np.diff(arc_lengths(positions, chain)) >= 0.0).all()
    assert chain.counts.sum() == len(positions) and chain.counts.max() > 600


def test_rows_are_sorted_by_time_and_repeats_left_out():
    made = drive()
    rows = arrange_rows(raw_of(shuffle(made)), 0.1)
    np.testing.assert_array_equal(rows.raw.positions, made[1])
    assert "time falls back 9 times" in str(rows.notes[0])
    twice = np.repeat(np.arange(len(made[0])), 2)
    raw = raw_of(tuple(part[twice] for part in made))
    rows = arrange_rows(raw, 0.1)
    np.testing.assert_array_equal(rows.raw.positions, made[1])
    assert f"{len(made[0])} repeated rows left out" in str(rows.notes[0])


def test_two_drives_in_one_file_are_refused_by_their_line():
    time, positions, _ = drive()
    times = np.append(time, time)
    both = np.concatenate([positions, positions + np.array([9.0, 3.0])])
    raw = RawPath("two.csv", times, both, None, np.arange(len(times)) + 2, "line")
    with pytest.raises(ValueError, match=r"two\.csv: time falls back at line 242 .*own") as caught:
        arrange_rows(raw, 0.1)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_stray_rows_are_left_out_and_no_others(noise):
    made = add_noise(drive(), noise)
    positions = made[1].copy()
    positions[70] += [0.8, 0.5]
    positions[120:122] += [-1.5, 0.4]
    rows = arrange_rows(raw_of((made[0], positions, made[2])), 0.1)
    assert set(raw_of(made).lines) - set(rows.raw.lines) == {72, 122, 123}
    assert len(rows.notes) == 2 and "7.0 s" in str(rows.notes[0])
    assert arrange_rows(raw_of(made), 0.1).notes == []


def test_a_stop_is_found_where_and_for_as_long_as_it_was():
    made = stand(drive(), 80, 5.0)
    (found,) = breaks_of(raw_of(made))
    assert found.stop.startswith("stands for 5") and not found.motion
    assert found.place.time == pytest.approx(8.0, abs=0.11)
    np.testing.assert_allclose([found.place.x, found.place.y], drive()[1][80], atol=0.06)


def test_a_stop_without_time_is_found_by_its_rows():
    time, positions, _ = add_noise(stand(drive(), 80, 5.0), 0.003)
    raw = RawPath("made.csv", None, positions, None, np.arange(len(time)) + 2, "line")
    (found,) = breaks_of(raw)
    assert found.stop.endswith("rows") and str(found.place).startswith("line 8")


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_a_turn_on_the_spot_is_found_with_its_angle_and_place(noise):
    (found,) = breaks_of(raw_of(add_noise(corner(), noise)))
    degrees = float(found.motion.split()[-2])
    assert found.motion.startswith("turns on the spot by ")
    assert degrees == pytest.approx(90.0, abs=12.0)
    np.testing.assert_allclose([found.place.x, found.place.y], [5.0, 0.0], atol=0.15)
    assert found.place.time == pytest.approx(5.0, abs=0.15)


def test_reversing_and_turning_about_are_told_apart_by_headings_alone():
    reversing = there_and_back(turning=False)
    turning = there_and_back(turning=True)
    (unknown,) = breaks_of(raw_of(reversing))
    assert "reverses or turns on the spot: no headings" in unknown.motion
    (about,) = breaks_of(raw_of(turning, with_headings=True))
    assert about.motion == "turns on the spot by 180 deg"
    cut = cut_path(raw_of(reversing, with_headings=True), TRACK_WIDTH, through_stops=False)
    assert [piece.backwards for piece in cut.pieces] == [False, True]
    cut = cut_path(raw_of(turning, with_headings=True), TRACK_WIDTH, through_stops=False)
    assert [piece.backwards for piece in cut.pieces] == [False, False]


def test_headings_of_another_convention_are_not_believed():
    made = drive()
    compass = (made[0], made[1], np.pi / 2.0 - made[2] + 0.3)
    cut = cut_path(raw_of(compass, with_headings=True), TRACK_WIDTH, through_stops=False)
    assert "off the direction of motion" in str(cut.notes[0])
    assert [piece.backwards for piece in cut.pieces] == [None]


def test_a_path_may_lead_through_its_stops_but_not_through_its_corners():
    raw = raw_of(stand(drive(), 80, 5.0))
    assert len(cut_path(raw, TRACK_WIDTH, through_stops=False).pieces) == 2
    cut = cut_path(raw, TRACK_WIDTH, through_stops=True)
    (piece,) = cut.pieces
    assert polygon_length(piece.raw.positions) == pytest.approx(LENGTH, abs=0.2)
    assert "cut out" in str(cut.notes[0])
    assert len(cut_path(raw_of(corner()), TRACK_WIDTH, through_stops=True).pieces) == 2


def test_a_jump_cuts_and_waypoints_far_apart_do_not():
    time, positions, headings = drive()
    jumping = positions.copy()
    jumping[100:] += [0.0, 5.0]
    (found,) = breaks_of(raw_of((time, jumping, headings)))
    assert found.motion.startswith("jumps by ")
    waypoints = np.array([[0, 0], [5, 1], [10, 4], [12, 9], [8, 12], [2, 10], [-2, 5]], float)
    raw = RawPath("way.csv", None, waypoints, None, np.arange(7) + 2, "line")
    assert breaks_of(raw) == []


@pytest.mark.parametrize("turns", [0.98, 1.0, 1.03])
def test_a_lap_is_closed_a_bit_early_and_a_bit_late(turns):
    cut = cut_path(raw_of(circle(turns=turns)), TRACK_WIDTH, through_stops=False)
    closed = close(cut.pieces[0], TRACK_WIDTH)
    assert closed is not None
    length = arc_lengths(closed.piece.raw.positions, make_chain(closed.piece.raw.positions, 0.025))
    assert length[-1] + closed.gap == pytest.approx(6.0 * np.pi, rel=0.01)


@pytest.mark.parametrize("made", [drive(), circle(turns=0.9), corner()])
def test_open_paths_are_not_closed(made):
    for piece in cut_path(raw_of(made), TRACK_WIDTH, through_stops=False).pieces:
        assert close(piece, TRACK_WIDTH) is None
