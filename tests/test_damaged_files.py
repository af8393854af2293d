"""Laws of all that is read from files: what is damaged is refused in one line or means what it
says, no code in it is run, and nothing is written."""

import csv
import dataclasses
import io
import json
import math
import re
import tomllib
import warnings
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest
from damage import damaged, is_one_line, list_files, only_reading
from hypothesis import HealthCheck, given, settings

from jaxtube.experiments import check
from jaxtube.experiments.cli import main
from jaxtube.experiments.falsify.command import read_worst_case
from jaxtube.experiments.identify import command as identify
from jaxtube.experiments.montecarlo.replay import read_laps, refuse_another_run
from jaxtube.experiments.options import IdentifyOptions
from jaxtube.experiments.run.record_file import DamagedError, decode, encode
from jaxtube.experiments.run.records import Records
from jaxtube.paths.mission_file import COLUMNS, read_mission
from jaxtube.paths.places import PathWarning
from jaxtube.plant.recorded_slips import read_slips, write_slips
from jaxtube.recordings.log import Log
from jaxtube.recordings.reading import read_path
from jaxtube.recordings.windows import Windows
from jaxtube.results import read
from jaxtube.scenario.reading import FILE_KEYS, experiments_folder, load, names
from jaxtube.scenario.refusal import ScenarioError
from jaxtube.scenario.tree import Scenario, to_toml
from jaxtube.sealed import hash_bytes
from jaxtube.synthesis.problem import make_problem
from jaxtube.witness.shares import find_promise

NUMBER = r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*"
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
        beside: what lies beside it, by name.
        share: of the usual number of files that is read, where that takes long.
    """

    name: str
    corpus: list[bytes]
    read: Callable[[Path], object]
    errors: tuple[type[Exception], ...] = (ValueError,)
    beside: dict[str, bytes] = dataclasses.field(default_factory=dict)
    share: float = 1.0

    def write(self, folder: Path) -> Path:
        """Write the first file of the corpus into a folder; return its path."""
        folder.mkdir(exist_ok=True)
        for name, content in self.beside.items():
            (folder / name).write_bytes(content)
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
    find_promise(path.read_text(encoding="utf-8-sig"))
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


def read_run(path: Path) -> None:
    assert load(path.parent) == load("certified")
    assert json.loads(path.read_bytes())["scenario_sha256"] == hash_bytes(TEXT)


def read_expected(path: Path) -> None:
    claims = check.read_claims(str(path.with_name("scenario.toml")))
    written = tomllib.loads(path.read_text(encoding="utf-8"))
    assert len(claims.metric) == len(written.get("metric", ()))
    for claim, table in zip(claims.metric, written.get("metric", ()), strict=True):
        assert is_same(claim.value, table["value"])
        assert claim.tolerance == table.get("tolerance", 0.0) and math.isfinite(claim.tolerance)


def read_a_log(path: Path) -> None:
    log = identify.read(IdentifyOptions(log=str(path)))
    if isinstance(log, Windows):
        return
    assert np.all(np.diff(log.time) > 0) and np.all(np.diff(log.pose_time) > 0)
    for values in (log.time, log.wheels, log.pose_time, log.poses):
        assert np.isfinite(values).all()
    table = find_plain_table(path, DRIVE)
    if table is not None:
        rows = {row[:3] for row in table.values()}
        first = min(time for time, _, _ in rows)
        for time, (right, left) in zip(log.time, log.wheels, strict=True):
            assert any(
                abs(time + first - row[0]) < 1e-9 and row[1:] == (left, right) for row in rows
            ), time


def find_plain_table(path: Path, whole: bytes) -> dict[int, tuple[float, ...]] | None:
    """Return the numbers of a table by line, where its header is whole and nothing is quoted."""
    data = path.read_bytes()
    header = whole.split(b"\n")[0] + b"\n"
    if not data.startswith(header) or any(mark in data for mark in (b'"', b"\r", b";", b"\t")):
        return None
    lines = enumerate(data.decode("utf-8", "replace").split("\n"), start=1)
    rows = {number: line.split(",") for number, line in lines}
    return {
        number: tuple(map(float, cells))
        for number, cells in rows.items()
        if all(re.fullmatch(NUMBER, cell) for cell in cells)
    }


def read_a_path(path: Path) -> None:
    raw = read_path(path)
    assert np.isfinite(raw.positions).all()
    assert len(raw.positions) == len(raw.lines)
    table = find_plain_table(path, RECORDED)
    if table is not None:
        for line, position in zip(raw.lines, raw.positions + raw.origin, strict=True):
            np.testing.assert_allclose(position, table[line][1:3], rtol=1e-12)


def drive_a_path(path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PathWarning)
        scenario = load("certified", ["reference.shape=file", f"reference.file={path}"])
        reference = make_problem(scenario).reference
    assert np.isfinite(reference.wheels).all() and np.isfinite(reference.poses).all()


def read_window_rows(path: Path) -> None:
    windows = identify.read(IdentifyOptions(log=str(path)))
    if isinstance(windows, Log):
        return
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


def list_slow_path() -> bytes:
    rows = [f"{0.1 * k:.1f},{0.136 * k:.4f},{0.0005 * k * k:.5f}" for k in range(30)]
    return ("time_s,x_m,y_m\n" + "\n".join(rows) + "\n").encode()


def list_mission() -> bytes:
    rows = [",".join(COLUMNS)]
    rows += [f"{0.1 * k:.6f},{0.05 * k:.9f},0.0,0.0,0.5,0.5" for k in range(9)]
    return ("\n".join(rows) + "\n").encode()


REFUSED = (ScenarioError,)
FOLDER = experiments_folder()
TEXT = to_toml(load("certified")).encode()
MANIFEST = json.dumps({"scenario_sha256": hash_bytes(TEXT), "seed": 0}, indent=2).encode()
DRIVE = b"".join((FOLDER / "husky" / "drive.csv").read_bytes().splitlines(True)[:60])
RECORDED = (FOLDER / "untuned" / "recorded.csv").read_bytes()
SLIPS = write_slips(np.arange(9.0) / 10, np.full((9, 3), 0.1)).encode()
METRICS = json.dumps({"laps": 10, "law": "a", "events": {"e": [1, 2.5]}}).encode()
IDENTITY = json.dumps({"seed": 0, "scenario": {"a": [1.0, 2]}}).encode()

KINDS = {
    "scenarios": Kind(
        "scenario.toml",
        [(FOLDER / name / "scenario.toml").read_bytes() for name in names()] + [TEXT],
        read_scenario,
        REFUSED,
    ),
    "manifests": Kind(
        "manifest.json", [MANIFEST], read_run, REFUSED, beside={"scenario.toml": TEXT}
    ),
    "expected": Kind(
        "expected.toml",
        [(FOLDER / name / "expected.toml").read_bytes() for name in ("certified", "husky")],
        read_expected,
        REFUSED,
    ),
    "logs": Kind("drive.csv", [DRIVE], read_a_log, REFUSED),
    "paths": Kind(
        "path.csv",
        [RECORDED, list_poses()],
        read_a_path,
    ),
    "driven paths": Kind("path.csv", [list_slow_path()], drive_a_path, REFUSED, share=0.1),
    "windows": Kind("windows.csv", [list_windows()], read_window_rows, REFUSED),
    "slips": Kind("slips.csv", [SLIPS], read_slip_rows, REFUSED),
    "missions": Kind("mission.csv", [list_mission()], read_mission_rows),
    "records": Kind("a.record", [RECORD], read_record, (DamagedError,)),
    "identities": Kind("identity.json", [IDENTITY], read_identity, REFUSED),
    "metrics": Kind(
        "metrics.json", [METRICS], read_metrics, REFUSED, beside={"identity.json": b""}
    ),
    "worst cases": Kind("worst_E.npz", [write_archive(**WORST)], read_worst, REFUSED),
}


def read_damaged_files(kind: Kind, folder: Path, count: int) -> None:
    path = kind.write(folder / "inside")
    (folder / "outside").write_text("mine")

    @settings(
        max_examples=math.ceil(kind.share * count),
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


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('path = "a"\nvalue = 1.0\ntolerance = inf', "inf is not finite"),
        ('path = "a"\nvalue = 1.0\ntolerance = nan', "tolerance"),
        ('path = "a"\nvalue = nan', "nan is not finite"),
        ('path = "a"\nvalue = 1\n"b\\nc" = 2', "unknown field"),
        ("x = " + "[" * 5000, "give path, value"),
        ('path = "a"\nvalue = 1\n[identify]\nlog = "../drive.csv"', "is no name of a file"),
        ('path = "a"\nvalue = 1\n[identify]\nlog = ""', "is no name of a file"),
        ('path = "a"\nvalue = 1\n[identify]\nlog = ".."', "is no name of a file"),
    ],
)
def test_expected_metrics_that_check_nothing_are_refused(tmp_path, text, told):
    name = str(tmp_path / "scenario.toml")
    head, _, rest = text.partition("\n[identify]")
    whole = f'[[metric]]\nprovenance = "p"\n{head}\n'
    if rest:
        whole += f"[identify]{rest}\n"
    (tmp_path / "expected.toml").write_text(whole)
    with pytest.raises(ScenarioError) as refused:
        check.read_claims(name)
    assert told in str(refused.value) and is_one_line(refused.value)


# ------------------------------------------------------------------------------------------- names


TOO_LONG = "a" * 300
"""A name that no file has."""


@pytest.mark.parametrize(
    "words",
    [
        ["list", "--scenario", TOO_LONG],
        ["list", "--scenario", f"{TOO_LONG}.toml"],
        ["list", "--scenario", "paper", "reference.shape=file", f"reference.file={TOO_LONG}"],
        ["list", "--scenario", "paper", "slip.process=recorded", f"slip.recording={TOO_LONG}"],
        ["identify", TOO_LONG],
        ["path", TOO_LONG],
        ["replay", TOO_LONG, "--scenario", "husky"],
        ["falsify", "--replay", TOO_LONG],
        ["check", f"{TOO_LONG}/scenario.toml"],
    ],
)
def test_names_that_no_file_has_are_refused_in_one_line(words, tmp_path, monkeypatch, capsys):
    """The system fails to look them up, and not just to find them."""
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_folders_that_cannot_be_looked_up_are_refused_in_one_line(tmp_path):
    for name in (TOO_LONG, f"{TOO_LONG}/below", "a\0b"):
        with pytest.raises(ScenarioError, match="does not exist"):
            read(tmp_path / name)


# ----------------------------------------------------------------------------------------- records


BLOCK = "blocks-0000000000-0000000000.record"
SEED = {"seed": 0}


def add(one, other):
    return {name: one[name] + other[name] for name in one}


def open_damaged_records(folder: Path, count: int) -> None:
    with Records(folder, SEED, add, 10) as records:
        records.add(0, 10, {"sum": np.arange(3.0)})
    whole = (folder / BLOCK).read_bytes()
    _, _, content = whole.partition(b"\n")

    @settings(
        max_examples=count,
        deadline=None,
        database=None,
        derandomize=True,
        suppress_health_check=list(HealthCheck),
    )
    @given(damaged([whole]), damaged([content]))
    def read(data, forged):
        sealed = b"record sha256 " + hash_bytes(forged).encode() + b"\n" + forged
        for changed in (data, sealed):
            (folder / BLOCK).write_bytes(changed)
            try:
                with Records(folder, SEED, add, 10) as records:
                    assert records.laps in (0, 10) or changed is sealed
                    assert changed == whole or records.laps == 0 or changed is sealed
                    assert all(is_one_line(line) for line in records.damaged)
            except ScenarioError as error:
                assert changed is sealed and is_one_line(error)

    read()


def test_damaged_records_are_told_and_computed_again(tmp_path):
    open_damaged_records(tmp_path / "records", QUICK)


@pytest.mark.slow
def test_a_thousand_damaged_records_are_told_and_computed_again(tmp_path):
    open_damaged_records(tmp_path / "records", 500)
