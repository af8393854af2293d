"""Laws of tables: one table reads alike however it is written, and messages name the right line."""

import codecs
import csv
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxtube.recordings.columns import find_columns, normalise
from jaxtube.recordings.hints import Hints, parse_pairs
from jaxtube.recordings.stamps import read_stamps
from jaxtube.recordings.table import open_table, read_cells, read_numbers
from jaxtube.recordings.usual_names import TIME

NAMES = ["time_s", "größe", "x_m"]
ROWS = np.array([[0.0, 1.5, -2.25], [0.1, 1e-3, 4.0], [0.25, -7.0, 1e5]])
SEPARATORS = {",": ",", ";": ";", "\t": "\t", " ": "   ", ", ": ", "}


def write(path, text, encoding="utf-8", mark=b""):
    path.write_bytes(mark + text.encode(encoding))
    return path


def spell(separator, newline, comma=False, header=True):
    lines = [separator.join(NAMES)] if header else []
    for row in ROWS:
        cells = [repr(float(cell)) for cell in row]
        lines.append(separator.join(cell.replace(".", ",") if comma else cell for cell in cells))
    return newline.join([*lines, ""])


def read_all(path):
    table = open_table(path)
    cells = read_cells(table, range(len(table.names)))
    return table, cells, np.column_stack([read_numbers(cells, k) for k in cells.columns])


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("separator", list(SEPARATORS))
@pytest.mark.parametrize("header", [True, False])
def test_a_table_reads_alike_with_any_delimiter_and_newline(tmp_path, separator, newline, header):
    text = spell(SEPARATORS[separator], newline, header=header)
    table, cells, numbers = read_all(write(tmp_path / "table.txt", text))
    np.testing.assert_array_equal(numbers, ROWS)
    assert list(table.names) == (NAMES if header else ["1", "2", "3"])
    assert cells.lines.tolist() == [1 + header, 2 + header, 3 + header]


@pytest.mark.parametrize("character", ["\v", "\f", "\x85", "\u2028"])
def test_messages_are_one_line_whatever_ends_a_line(tmp_path, character):
    text = f'"a{character}b",x_m\n1,2\n3,{character}4z\n'
    table = open_table(write(tmp_path / "table.csv", text))
    assert len(table.names[0].splitlines()) == 1
    with pytest.raises(ValueError, match="no column") as told:
        find_columns(table, [TIME], Hints(columns={"time": f"t{character}t"}))
    assert len(str(told.value).splitlines()) == 1


@pytest.mark.parametrize("cell", ["1_0", "٣", "1_0.5", "１.5"])
def test_what_only_python_takes_for_a_number_is_refused(tmp_path, cell):
    rows = "\n".join(f"{0.1 * k:.1f},{k}.5" for k in range(8))
    table = open_table(write(tmp_path / "table.csv", f"time_s,x_m\n{rows}\n0.9,{cell}\n"))
    cells = read_cells(table, range(2))
    with pytest.raises(ValueError, match=f"line 10: '{cell}' is no finite number"):
        read_numbers(cells, 1)


@pytest.mark.parametrize("separator", [";", "\t", " "])
def test_decimal_commas_are_read_as_points(tmp_path, separator):
    table, _, numbers = read_all(write(tmp_path / "table.csv", spell(separator, "\n", comma=True)))
    assert table.has_decimal_comma
    np.testing.assert_array_equal(numbers, ROWS)


@pytest.mark.parametrize(
    ("encoding", "mark"),
    [
        ("utf-8", b""),
        ("utf-8", codecs.BOM_UTF8),
        ("utf-16-le", codecs.BOM_UTF16_LE),
        ("utf-16-be", codecs.BOM_UTF16_BE),
        ("utf-16-le", b""),
        ("utf-16-be", b""),
        ("latin-1", b""),
    ],
)
def test_a_table_reads_alike_in_any_encoding(tmp_path, encoding, mark):
    text = spell(",", "\r\n")
    table, _, numbers = read_all(write(tmp_path / "table.csv", text, encoding, mark))
    assert list(table.names) == NAMES
    np.testing.assert_array_equal(numbers, ROWS)
    assert any("Latin-1" in clause for clause in table.guesses) == (encoding == "latin-1")


def test_lines_are_counted_through_comments_blank_lines_and_quotes(tmp_path):
    text = '# a robot\n\nx_m,note,y_m\n1,"two\nlines",2\n\n# pause\n3,"a, b",oops\n'
    table = open_table(write(tmp_path / "table.csv", text))
    cells = read_cells(table, [0, 2])
    assert cells.lines.tolist() == [5, 8]
    np.testing.assert_array_equal(read_numbers(cells, 0), [1.0, 3.0])
    with pytest.raises(
        ValueError, match=r"column y_m, line 8: 'oops' is no finite number"
    ) as error:
        read_numbers(cells, 2)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("text", ["# x_m; y_m\n1.5; 2\n3; 4\n", "# made by\n#x_m\ty_m\n1\t2\n3\t4"])
def test_a_header_may_be_a_comment(tmp_path, text):
    assert open_table(write(tmp_path / "line.csv", text)).names == ("x_m", "y_m")


@pytest.mark.parametrize("word", ["", "nan", "NaN", "null", "N/A", "  "])
def test_missing_numbers_are_nan(tmp_path, word):
    path = write(tmp_path / "table.csv", f"x,y\n1,2\n{word},4\n5,6\n")
    np.testing.assert_array_equal(read_all(path)[2][:, 0], [1.0, np.nan, 5.0])


def test_one_pose_file_is_known_by_its_unit_quaternions(tmp_path):
    text = "# poses\n1.7e9 1 2 3 0 0 0.6 0.8\n1.7e9 1 2 3 0 0 -0.6 0.8\n"
    assert open_table(write(tmp_path / "poses.txt", text)).names[4:] == ("qx", "qy", "qz", "qw")
    other = write(tmp_path / "other.txt", "1 1 2 3 0 0 6 8\n2 1 2 3 0 0 6 8\n")
    assert open_table(other).names[4:] == ("5", "6", "7", "8")


def test_trailing_delimiters_do_no_harm(tmp_path):
    _, _, numbers = read_all(write(tmp_path / "table.csv", "x,y,\n1,2,\n3,4,\n,,\n"))
    np.testing.assert_array_equal(numbers, [[1.0, 2.0], [3.0, 4.0]])


LONG = "9" * (csv.field_size_limit() + 1)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "is empty"),
        (b"just words\nand more\n", "no table of numbers"),
        (b"x,y\n", "no table of numbers"),
        (b"PK\x03\x04...", "workbook"),
        (b"\x00\x01\x02\x03" * 50, "not text"),
        (b"x,y\n1,2\n3\n", "line 3 has 1 cell, the header names 2"),
        (b"x,y\n1,2\n3,4,5\n", "line 3 has 3 cells"),
        (b"1,2\n3,4\n5\n", "line 3 has 1 cell, most rows have 2"),
        (b'x,y\n1,2\n"3,4\n5,6\n', "is not CSV"),
        (b"x,y\n1,2\n3,inf\n", "column y, line 3: 'inf' is no finite number"),
        (b"x,y\n1,2\n3,4.5.6\n", "column y, line 3"),
        (b"x,y\n1,2\n3," + LONG.encode() + b"\n", "field larger than field limit"),
        (b"x y\n1 2\n3 " + LONG.encode() + b"\n", "field larger than field limit"),
    ],
)
def test_what_is_no_table_is_refused_in_one_line(tmp_path, data, words):
    path = tmp_path / "table.csv"
    path.write_bytes(data)
    with pytest.raises(ValueError, match=words) as error:
        read_all(path)
    assert str(error.value).startswith(str(path)) and "\n" not in str(error.value)
    assert len(str(error.value)) < 400


def test_what_is_no_file_is_refused(tmp_path):
    for path in (tmp_path, tmp_path / "none.csv"):
        with pytest.raises(ValueError, match=r"cannot be read .* name a file"):
            open_table(path)


def read_times(path, text, **hints):
    table = open_table(write(path, text))
    found = find_columns(table, (TIME,), Hints(**hints))
    cells = read_cells(table, found["time"].places)
    return read_stamps(cells, found["time"])


@pytest.mark.parametrize(("unit", "digits"), [("s", 0), ("ms", 3), ("us", 6), ("ns", 9)])
@given(start=st.integers(10**18, 2 * 10**18), gaps=st.lists(st.integers(0, 10**12), min_size=2))
def test_no_digit_of_a_stamp_is_lost(tmp_path_factory, unit, digits, start, gaps):
    nanoseconds = [start + gap for gap in [0, *gaps]]
    scale = 10 ** (9 - digits)
    stamps = [
        f"{each // scale}.{each % scale:0{9 - digits}d}" if scale > 1 else str(each)
        for each in nanoseconds
    ]
    text = "t,x\n" + "".join(f"{stamp},0\n" for stamp in stamps)
    path = tmp_path_factory.getbasetemp() / "stamps.csv"
    found, column = read_times(path, text)
    exact = [float(Fraction(each - start, 10**9)) for each in nanoseconds]
    assert found.since.tolist() == exact
    assert Fraction(found.first) == Fraction(start, 10**9)
    assert column.unit == unit and not column.is_assumed


def test_seconds_and_nanoseconds_make_one_stamp(tmp_path):
    header = "header.stamp.sec,header.stamp.nanosec,x\n"
    text = header + "1700000000,999999999,0\n1700000001,1,0\n"
    found, column = read_times(tmp_path / "log.csv", text)
    assert found.since.tolist() == [0.0, 2e-9]
    assert column.describe() == "time = header.stamp.sec+header.stamp.nanosec in s"
    longer, _ = read_times(tmp_path / "log.csv", text.replace("header", "/odom/header"))
    assert longer.since.tolist() == [0.0, 2e-9]
    named, _ = read_times(
        tmp_path / "log.csv",
        text.replace("header.stamp.", "my"),
        columns={"time": "mysec+mynanosec"},
    )
    assert named.since.tolist() == [0.0, 2e-9]


@pytest.mark.parametrize(
    ("name", "stamps", "unit", "since"),
    [
        ("time", "0 0.5", "s", 0.5),
        ("time_ms", "0 500", "ms", 0.5),
        ("Time [us]", "100 500100", "us", 0.5),
        ("timestampNs", "0 500000000", "ns", 0.5),
        ("t_s", "1700000000123 1700000000623", "ms", 0.5),
        ("time", "1e5 100000.5", "s", 0.5),
    ],
)
def test_units_of_time_are_told_by_name_and_size(tmp_path, name, stamps, unit, since):
    first, second = stamps.split()
    found, column = read_times(tmp_path / "log.csv", f"{name};x\n{first};1\n{second};2\n")
    assert (column.unit, found.since[1]) == (unit, since)


@pytest.mark.parametrize(
    ("first", "second", "start", "since"),
    [
        ("2023-11-14 22:13:20.000000001", "2023-11-14 22:13:21", 1700000000, 1.0 - 1e-9),
        ("2023-11-14T22:13:20Z", "2023-11-14T22:13:20.25Z", 1700000000, 0.25),
        ("2023-11-15T00:13:20+02:00", "2023-11-14T22:13:21+00:00", 1700000000, 1.0),
    ],
)
def test_dates_are_times(tmp_path, first, second, start, since):
    found, column = read_times(tmp_path / "log.csv", f"time,x\n{first},1\n{second},2\n")
    assert int(found.first) == start and found.since[1] == pytest.approx(since, abs=1e-15)
    assert column.describe() == "time = time"
    with pytest.raises(ValueError, match=r"line 3: '2023-13-01 00:00:00' is no date and time"):
        read_times(tmp_path / "log.csv", f"time,x\n{first},1\n2023-13-01 00:00:00,2\n")


def test_names_are_compared_without_their_spelling():
    spellings = ("pose.position.x", "/pose/position/x", "posePositionX", "field.pose.position.x")
    assert {normalise(name) for name in spellings} == {"pose_position_x"}
    assert normalise("%time") == "time" and normalise("Time [s]") == "time_s"


def test_pairs_of_an_option_are_read():
    text = 'left=wl, right=a=b,"x=East, m"'
    assert parse_pairs("--columns", text) == {"left": "wl", "right": "a=b", "x": "East, m"}
    assert parse_pairs("--columns", "") == {}
    for text, words in [("left", "no pair"), ("left=", "no pair"), ("left=a,left=b", "twice")]:
        with pytest.raises(ValueError, match=words):
            parse_pairs("--columns", text)


def test_hints_of_what_nothing_holds_are_refused():
    with pytest.raises(
        ValueError, match=r"--columns lft=a: lft is unknown; name one of time, left"
    ):
        Hints(columns={"lft": "a"})
    with pytest.raises(
        ValueError, match=r"--topics pose=/odom: pose is unknown; name one of wheel"
    ):
        Hints(topics={"pose": "/odom"})


@pytest.mark.parametrize(
    ("quaternion", "is_pose_file"),
    [("0 0 0.71 0.71", True), ("0 0 0.7 0.69", True), ("0 0 2 1", False), ("0 0 nan 1", False)],
)
def test_a_row_with_a_unit_quaternion_but_for_rounding_is_one_of_a_pose_file(
    tmp_path, quaternion, is_pose_file
):
    table = open_table(write(tmp_path / "poses.txt", f"0.0 1 2 0 {quaternion}\n" * 3))
    assert table.has_names == is_pose_file
