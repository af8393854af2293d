"""Laws of all that is read from files: what is damaged is refused in one line or means what it
says, no code in it is run, and nothing is written."""

import csv
import dataclasses
import io
import json
import math
import tomllib
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest
from damage import damaged, is_one_line, list_files, only_reading
from hypothesis import HealthCheck, given, settings

from jaxtube.experiments import check
from jaxtube.experiments.falsify.command import read_worst_case
from jaxtube.experiments.montecarlo.replay import read_laps, refuse_another_run
from jaxtube.experiments.run.record_file import DamagedError, decode, encode
from jaxtube.paths.mission_file import COLUMNS, read_mission
from jaxtube.plant.recorded_slips import read_slips, write_slips
from jaxtube.recordings.reading import read_log, read_path
from jaxtube.recordings.window_table import is_window_table, read_windows
from jaxtube.scenario.reading import FILE_KEYS, experiments_folder, load, names
from jaxtube.scenario.tree import Scenario, to_toml

QUICK = 30
"""Files of each kind; the long test reads 40 times as many, more than 10,000."""


@dataclasses.dataclass(frozen=True)
class Kind:
    """A kind of file.

    Attributes:
        name: that the file has.
        corpus: whole files.
        read: reads one, and asserts what holds of all that is accepted.
        errors: with which one is refused.
        beside: name of an empty file that lies beside it.
    """

    name: str
    corpus: list[bytes]
    read: Callable[[Path], object]
    errors: tuple[type[Exception], ...] = (ValueError,)
    beside: str = ""

    def write(self, folder: Path) -> Path:
        """Write the first file of the corpus into a folder; return its path."""
        folder.mkdir(exist_ok=True)
        if self.beside:
            (folder / self.beside).touch()
        path = folder / self.name
        path.write_bytes(self.corpus[0])
        return path


def read_scenario(path: Path) -> None:
    """Accept a scenario only with the values that its text gives, and no other keys."""
    scenario = load(path)
    tables = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    meant = msgspec.to_builtins(scenario)
    for section, table in tables.items():
        for key, value in table.items():
            expected = value
            if f"{section}.{key}" in FILE_KEYS and value:
                expected = str(Path.cwd() / path.parent / value)
            assert is_same(meant[section][key], expected), (section, key)
    absent = {
        f"{section}.{key}": value
        for section, table in meant.items()
        for key, value in table.items()
        if key not in tables.get(section, {})
    }
    default = load_text("")
    derived = {"slip.nominal_right", "slip.nominal_left", "reference.duration_s"}
    for key, value in absent.items():
        if key not in derived:
            section, _, name = key.partition(".")
            assert value == msgspec.to_builtins(getattr(getattr(default, section), name)), key
    again = msgspec.convert(tomllib.loads(to_toml(scenario)), Scenario)
    assert again == scenario


def load_text(text: str) -> Scenario:
    return msgspec.convert(tomllib.loads(text), Scenario)


def is_same(meant, written) -> bool:
    """Say whether a value of a scenario is the one that was written: a whole number may become a
    number, nothing else changes its type."""
    if isinstance(written, dict):
        return all(is_same(meant[key], value) for key, value in written.items())
    if isinstance(written, list):
        pairs = zip(meant, written, strict=True)
        return all(is_same(one, other) for one, other in pairs)
    if isinstance(meant, float) and type(written) is int:
        return meant == written
    return type(meant) is type(written) and meant == written


def read_expected(path: Path) -> None:
    claims = check.read_claims(str(path.with_name("scenario.toml")))
    written = tomllib.loads(path.read_text(encoding="utf-8"))
    assert len(claims.metric) == len(written.get("metric", ()))
    for claim, table in zip(claims.metric, written.get("metric", ()), strict=True):
        assert is_same(claim.value, table["value"])
        assert claim.tolerance == table.get("tolerance", 0.0) and math.isfinite(claim.tolerance)


def read_a_log(path: Path) -> None:
    log = read_log(path)
    assert np.all(np.diff(log.time) > 0) and np.all(np.diff(log.pose_time) > 0)
    for values in (log.time, log.wheels, log.pose_time, log.poses):
        assert np.isfinite(values).all()


def read_a_path(path: Path) -> None:
    raw = read_path(path)
    assert np.isfinite(raw.positions).all()
    assert len(raw.positions) == len(raw.lines)
    text = path.read_bytes()
    if not text.startswith(b"time_s,x_m,y_m\n") or b'"' in text or b"\r" in text:
        return
    rows = text.decode("utf-8", "replace").split("\n")
    for line, position in zip(raw.lines, raw.positions + raw.origin, strict=True):
        cells = [float(cell) for cell in rows[line - 1].split(",")[1:3]]
        np.testing.assert_allclose(position, cells, rtol=1e-12)


def read_window_rows(path: Path) -> None:
    is_window_table(path)
    windows = read_windows(path)
    kept = ~windows.lost
    assert np.isfinite(windows.wheels[kept]).all() and np.isfinite(windows.velocity[kept]).all()


def read_slip_rows(path: Path) -> None:
    recorded = read_slips(path)
    assert recorded.period > 0 and np.all(np.abs(recorded.values) < 1)


def read_mission_rows(path: Path) -> None:
    mission = read_mission(path, 0.1, 3, 0.5, None)
    if mission is not None:
        assert np.isfinite(mission.wheels).all() and np.isfinite(mission.poses).all()


RECORD = encode({"name": "a", "identity": {"seed": 0}, "laps": 3}, {"sum": np.arange(4.0)})


def read_record(path: Path) -> None:
    header, arrays = decode(path.read_bytes())
    assert header["laps"] == 3 and np.array_equal(arrays["sum"], np.arange(4.0))
    assert path.read_bytes() == RECORD


def read_identity(path: Path) -> None:
    refuse_another_run(path.parent, 0, {"seed": 0, "scenario": {"a": [1.0, 2]}})
    assert json.loads(path.read_bytes()) == {"seed": 0, "scenario": {"a": [1.0, 2]}}


def read_metrics(path: Path) -> None:
    laps = read_laps(path.parent)
    assert laps is None or (type(laps) is int and laps >= 0)


def write_archive(**arrays) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue()


WORST = {
    "scenario": np.array(to_toml(Scenario())),
    "controller": np.array("tube_mpc"),
    "plant": np.array("robot"),
    "starts": np.array("scenario"),
    "limit": np.array("E"),
    "errors": np.zeros((4, 3)),
    "attack_start": np.zeros(3),
    **{
        name: np.array(value)
        for name, value in zip(
            ("usage", "margin", "step", "facet", "when"), (0.5, 0.1, 3, 1, 2), strict=True
        )
    },
}


def read_worst(path: Path) -> None:
    saved = read_worst_case(path)
    assert saved.keys() >= WORST.keys()
    assert all(isinstance(array, np.ndarray) and array.dtype != object for array in saved.values())


def list_rows(*columns: str, count: int = 12) -> bytes:
    """Return a table of smooth numbers."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    for row in range(count):
        numbers = [0.1 * row, *(0.01 * (row + 1) * k for k in range(1, len(columns)))]
        writer.writerow([f"{number:.4f}" for number in numbers])
    return text.getvalue().encode()


def list_windows() -> bytes:
    header = "step,right_wheel_mps,left_wheel_mps,v_mps,omega_radps,v_y_mps\n"
    rows = [f"{k // 2},{0.3 + 0.01 * k},{0.31},{0.3},{0.02 * k},{0.001}" for k in range(12)]
    return (header + "\n".join(rows) + "\n").encode()


def list_poses() -> bytes:
    rows = [f"{0.1 * k:.2f} {0.05 * k:.3f} {0.01 * k * k:.4f} 0 0 0 0 1" for k in range(12)]
    return ("\n".join(rows) + "\n").encode()


def list_mission() -> bytes:
    rows = [",".join(COLUMNS)]
    rows += [f"{0.1 * k:.6f},{0.05 * k:.9f},0.0,0.0,0.5,0.5" for k in range(9)]
    return ("\n".join(rows) + "\n").encode()


FOLDER = experiments_folder()
DRIVE = b"".join((FOLDER / "husky" / "drive.csv").read_bytes().splitlines(True)[:60])
SLIPS = write_slips(np.arange(9.0) / 10, np.full((9, 3), 0.1)).encode()
METRICS = json.dumps({"laps": 10, "law": "a", "events": {"e": [1, 2.5]}}).encode()
IDENTITY = json.dumps({"seed": 0, "scenario": {"a": [1.0, 2]}}).encode()

KINDS = {
    "scenarios": Kind(
        "scenario.toml",
        [(FOLDER / name / "scenario.toml").read_bytes() for name in names()]
        + [to_toml(load("certified")).encode()],
        read_scenario,
    ),
    "expected": Kind(
        "expected.toml",
        [(FOLDER / name / "expected.toml").read_bytes() for name in ("certified", "husky")],
        read_expected,
    ),
    "logs": Kind("drive.csv", [DRIVE], read_a_log),
    "paths": Kind(
        "path.csv",
        [(FOLDER / "untuned" / "recorded.csv").read_bytes(), list_poses()],
        read_a_path,
    ),
    "windows": Kind("windows.csv", [list_windows()], read_window_rows),
    "slips": Kind("slips.csv", [SLIPS], read_slip_rows),
    "missions": Kind("mission.csv", [list_mission()], read_mission_rows),
    "records": Kind("a.record", [RECORD], read_record, (DamagedError,)),
    "identities": Kind("identity.json", [IDENTITY], read_identity),
    "metrics": Kind("metrics.json", [METRICS], read_metrics, beside="identity.json"),
    "worst cases": Kind("worst_E.npz", [write_archive(**WORST)], read_worst),
}


def read_damaged_files(kind: Kind, folder: Path, count: int) -> None:
    path = kind.write(folder / "inside")
    (folder / "outside").write_text("mine")

    @settings(
        max_examples=count,
        deadline=None,
        database=None,
        derandomize=True,
        suppress_health_check=list(HealthCheck),
    )
    @given(damaged(kind.corpus))
    def read(data):
        path.write_bytes(data)
        before = list_files(folder)
        try:
            with only_reading():
                kind.read(path)
        except kind.errors as error:
            assert isinstance(error, DamagedError) or is_one_line(error), error
        assert list_files(folder) == before

    read()


@pytest.mark.parametrize("kind", KINDS)
def test_whole_files_are_read(kind, tmp_path):
    for data in KINDS[kind].corpus:
        path = KINDS[kind].write(tmp_path)
        path.write_bytes(data)
        KINDS[kind].read(path)


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files_are_refused_in_one_line_or_mean_what_they_say(kind, tmp_path):
    read_damaged_files(KINDS[kind], tmp_path, QUICK)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_ten_thousand_damaged_files_are_refused_or_mean_what_they_say(kind, tmp_path):
    read_damaged_files(KINDS[kind], tmp_path, 40 * QUICK)
