"""Laws of the store: entries come back as they were written; those of another run or of another
format are refused in one line."""

import errno
import os

import numpy as np
import pytest

from jaxtube.experiments.run.record_file import DamagedError, encode
from jaxtube.experiments.run.records import Records
from jaxtube.experiments.run.store import Store, StoreError
from jaxtube.scenario import ScenarioError

IDENTITY = {"seed": 3}


@pytest.fixture
def store(tmp_path):
    with Store(tmp_path / "store", IDENTITY) as opened:
        yield opened


def test_an_entry_comes_back_as_it_was_written(store):
    numbers = np.array([0.1, -0.0, np.nan])
    store.write("a-1", {"value": {"b": [1, None]}}, {"numbers": numbers})
    read = store.read("a-1")
    assert read.header["name"] == "a-1" and read.header["value"] == {"b": [1, None]}
    assert read.arrays["numbers"].tobytes() == numbers.tobytes()
    assert list(store.read_all("lost")) == ["a-1"] and store.damaged == []


def test_damaged_entries_and_leftovers_go_and_are_reported(store):
    for name in ("a", "b", "c"):
        store.write(name, {}, {})
    (store.folder / "a.record").write_bytes(b"cut")
    os.rename(store.folder / "b.record", store.folder / "d.record")
    (store.folder / ".c.record.77").write_bytes(b"half")
    with pytest.raises(DamagedError):
        store.read("d")
    assert list(store.read_all("computed again")) == ["c"]
    assert [line.split(": ", 1)[1] for line in store.damaged] == [
        "is damaged; it is removed and computed again"
    ] * 2
    assert sorted(path.name for path in store.folder.iterdir()) == ["c.record", "lock"]


def test_a_folder_has_one_holder(store):
    with pytest.raises(ScenarioError, match="another process is writing there"):
        Store(store.folder, IDENTITY)


def test_records_of_the_format_before_are_refused_in_one_line(tmp_path):
    """Their header named the blocks, not the entry."""
    folder = tmp_path / "records"
    folder.mkdir()
    identity = {"record_format": 1, "block_size": 8, **IDENTITY}
    header = {"first": 0, "last": 0, "laps": 8, "identity": identity}
    path = folder / "blocks-0000000000-0000000000.record"
    path.write_bytes(encode(header, {"n": np.array(1)}))
    before = path.read_bytes()
    with pytest.raises(ScenarioError) as refused:
        Records(folder, IDENTITY, dict.__or__, 8)
    line = str(refused.value)
    assert "record_format = 1 there, 2 here; name another --out, or delete that folder" in line
    assert "\n" not in line and path.read_bytes() == before


def test_a_failing_disk_is_one_line_that_says_what_is_safe(store):
    failing = store.explain_failure("recording block 3", lambda: "the 24 laps are safe")
    with pytest.raises(StoreError) as told, failing:
        raise OSError(errno.ENOSPC, "No space left on device")
    assert str(told.value) == (
        f"{store.folder}: recording block 3 failed (No space left on device); the 24 laps are "
        "safe; run the same command again to continue"
    )
