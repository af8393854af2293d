"""Laws of the records of a long run: the statistics are the same bytes whatever happened; what is
damaged is found."""

import errno
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from jaxtube.experiments.run import record_file, records
from jaxtube.experiments.run.records import Records
from jaxtube.experiments.run.store import StoreError
from jaxtube.scenario import ScenarioError

BLOCK_SIZE = 8
IDENTITY = {
    "seed": 3,
    "scenario": {"controller": {"horizon": 5, "weights": [1.0, 2.0]}, "name": "paper"},
}


def statistics(block, laps):
    """Draw what a block might give: a sum of floats, counts, a maximum, and the two largest values
    with their lap."""
    values = np.random.default_rng((7, block)).standard_normal(BLOCK_SIZE)[:laps] * 10.0 ** (
        block % 7
    )
    numbered = np.stack([values, block * BLOCK_SIZE + np.arange(laps)], axis=1)
    return {
        "sum": np.array(values.sum()),
        "histogram": np.histogram(values, bins=4, range=(-2, 2))[0].astype(np.int32),
        "largest": np.array(values.max(), np.float32),
        "top": numbered[np.argsort(-values)][:2],
    }


def merge(first, second):
    both = np.concatenate([first["top"], second["top"]])
    return {
        "sum": first["sum"] + second["sum"],
        "histogram": first["histogram"] + second["histogram"],
        "largest": np.maximum(first["largest"], second["largest"]),
        "top": both[np.argsort(-both[:, 0])][:2],
    }


def opened(folder, identity=IDENTITY):
    return Records(folder, identity, merge, BLOCK_SIZE)


def laps_of(block, realisations):
    return min(BLOCK_SIZE, realisations - block * BLOCK_SIZE)


def continued(folder, realisations, blocks=None):
    """Record some of the missing blocks, or all, and return the statistics."""
    with opened(folder) as run:
        for block in list(run.missing(realisations)) if blocks is None else blocks:
            run.add(
                block, laps_of(block, realisations), statistics(block, laps_of(block, realisations))
            )
        return as_bytes(run.merge())


def as_bytes(merged):
    return {name: (array.dtype.str, array.shape, array.tobytes()) for name, array in merged.items()}


def files(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name != "lock"}


@pytest.fixture
def small(monkeypatch):
    """Four files to a merge, so that few blocks make many levels."""
    monkeypatch.setattr(records, "SIZES", (1, 4, 16, 64))


@pytest.fixture
def quick(monkeypatch):
    """Do not wait for the disk."""
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)


# ----------------------------------------------------------------------------------- the same bytes


@pytest.mark.parametrize("seed", range(4))
def test_any_order_and_any_interruptions_give_the_same_files(tmp_path, small, quick, seed):
    random = np.random.default_rng(seed)
    realisations = int(random.integers(1, 100 * BLOCK_SIZE))
    undisturbed = continued(tmp_path / "once", realisations)
    missing = range(1)
    while missing:
        with opened(tmp_path / "often") as run:
            missing = list(run.missing(realisations))
        continued(
            tmp_path / "often",
            realisations,
            random.permutation(missing)[: random.integers(1, 40)].tolist(),
        )
    assert continued(tmp_path / "often", realisations) == undisturbed
    assert files(tmp_path / "often") == files(tmp_path / "once")
    with opened(tmp_path / "often") as run:
        assert run.laps == realisations


def test_the_statistics_are_those_of_all_laps(tmp_path, small, quick):
    count = 11 * BLOCK_SIZE + 3
    continued(tmp_path, count)
    parts = [statistics(block, laps_of(block, count)) for block in range(12)]
    values = np.concatenate([part["top"] for part in parts])
    with opened(tmp_path) as run:
        merged = run.merge()
    assert merged["histogram"].dtype == np.int32 and merged["largest"].dtype == np.float32
    np.testing.assert_array_equal(merged["histogram"], sum(part["histogram"] for part in parts))
    np.testing.assert_array_equal(merged["top"], values[np.argsort(-values[:, 0])][:2])


def test_every_state_of_the_folder_on_the_way_leads_to_the_same_files(tmp_path, small, monkeypatch):
    """A process killed between two calls of the system leaves the folder as it is at the next."""
    folder = tmp_path / "run"
    snapshots = []

    def photographed(call):
        def shot(*arguments):
            snapshots.append(shutil.copytree(folder, tmp_path / f"snapshot-{len(snapshots)}"))
            return call(*arguments)

        return shot

    realisations = 17 * BLOCK_SIZE + 1
    with monkeypatch.context() as patch:
        for name in ("fsync", "replace", "unlink"):
            patch.setattr(os, name, photographed(getattr(os, name)))
        undisturbed = continued(folder, realisations)
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)
    assert len(snapshots) > 60
    assert any(list(snapshot.glob(".*")) for snapshot in snapshots)
    for snapshot in snapshots:
        with opened(snapshot) as run:
            assert run.damaged == []
            whole = {block for name in files(snapshot) for block in records._blocks(name)}
            assert sorted(whole | set(run.missing(realisations))) == list(range(18))
        assert continued(snapshot, realisations) == undisturbed
        assert files(snapshot) == files(folder)


def test_a_killed_process_loses_no_block_that_it_said_was_recorded(tmp_path):
    blocks = 3 * 64 + 9
    told = set()
    killed = 0
    random = np.random.default_rng(0)
    for _ in range(3):
        with subprocess.Popen(
            [sys.executable, __file__, str(tmp_path / "run"), str(blocks)], stdout=-1
        ) as child:
            assert child.stdout
            said = [child.stdout.readline()]
            time.sleep(random.uniform(0, 0.1))
            child.send_signal(signal.SIGKILL)
            said += child.stdout.readlines()
        killed += child.returncode == -signal.SIGKILL
        told |= {int(line) for line in said if line.endswith(b"\n")}
        with opened(tmp_path / "run") as run:
            assert run.damaged == []
            assert told.isdisjoint(run.missing(blocks * BLOCK_SIZE))
    assert killed >= 2
    assert continued(tmp_path / "run", blocks * BLOCK_SIZE) == continued(
        tmp_path / "once", blocks * BLOCK_SIZE
    )


# --------------------------------------------------------------------------------------- compaction


@pytest.mark.parametrize(
    ("sizes", "ranges"),
    [
        ((1, 4, 16), [1] * 3 + [4] * 2 + [16] * 5),
        pytest.param((1, 64, 4096), [1] * 6 + [64, 4096], marks=pytest.mark.slow),
    ],
)
def test_files_stay_few(tmp_path, quick, monkeypatch, sizes, ranges):
    monkeypatch.setattr(records, "SIZES", sizes)
    count = sum(ranges)
    with Records(
        tmp_path, IDENTITY, lambda first, second: {"n": first["n"] + second["n"]}, 1
    ) as run:
        for block in run.missing(count):
            run.add(block, 1, {"n": np.array(1)})
        assert run.laps == run.merge()["n"] == count and list(run.missing(count)) == []
    assert sorted(len(records._blocks(name)) for name in files(tmp_path)) == ranges


def test_the_largest_range_is_merged_no_further(tmp_path, small, quick):
    continued(tmp_path, 3 * 64 * BLOCK_SIZE)
    assert [len(records._blocks(name)) for name in files(tmp_path)] == [64] * 3


def test_a_partial_block_stays_a_file_of_its_own(tmp_path, small, quick):
    continued(tmp_path, 4 * BLOCK_SIZE - 1)
    assert len(files(tmp_path)) == 4
    continued(tmp_path, 4 * BLOCK_SIZE)
    assert len(files(tmp_path)) == 1


# ---------------------------------------------------------------------------------- what is missing


@pytest.mark.parametrize("first", [1, 7, 8, 9, 31, 32, 33, 100])
def test_a_run_goes_on_with_more_realisations(tmp_path, small, quick, first):
    continued(tmp_path / "two", first)
    with opened(tmp_path / "two") as run:
        whole = first // BLOCK_SIZE
        assert list(run.missing(120)) == list(range(whole, 15))
    assert continued(tmp_path / "two", 120) == continued(tmp_path / "one", 120)
    assert files(tmp_path / "two") == files(tmp_path / "one")


@pytest.mark.parametrize("asked", [1, 8, 32, 35])
def test_fewer_realisations_than_recorded_are_refused(tmp_path, small, quick, asked):
    continued(tmp_path, 36)
    with opened(tmp_path) as run, pytest.raises(ScenarioError) as caught:
        run.missing(asked)
    assert re.search(
        rf"--realisations = {asked}: .*36.*; ask for at least 36, or name another --out$",
        str(caught.value),
    )
    assert "\n" not in str(caught.value)


def test_a_block_between_missing_ones_is_not_asked_for_again(tmp_path, quick):
    continued(tmp_path, 10 * BLOCK_SIZE, [2, 7])
    with opened(tmp_path) as run:
        assert list(run.missing(10 * BLOCK_SIZE)) == [0, 1, 3, 4, 5, 6, 8, 9]
        with pytest.raises(ScenarioError):
            run.missing(8 * BLOCK_SIZE - 1)


@pytest.mark.parametrize(
    ("block", "laps"), [(-1, 8), (0, 0), (0, 9), (1, 8), (2, 3), (2, 2), (5, 8)]
)
def test_a_block_is_counted_once_and_within_its_size(tmp_path, small, quick, block, laps):
    continued(tmp_path, 9 * BLOCK_SIZE, [1, 4, 5, 6, 7])
    with opened(tmp_path) as run:
        run.add(2, 3, statistics(2, 3))
        before = files(tmp_path)
        with pytest.raises(ValueError, match=f"block {block}, laps = {laps}: "):
            run.add(block, laps, statistics(0, 1))
    assert files(tmp_path) == before


@pytest.mark.parametrize("array", [np.array([None]), np.array(["a"]), np.array(1j)])
def test_statistics_are_integers_or_floats(tmp_path, array):
    with opened(tmp_path) as run:
        with pytest.raises(ValueError, match="statistic odd: "):
            run.add(0, 1, {"odd": array})
        assert run.laps == 0 and run.merge() == {}
    assert files(tmp_path) == {}


# ------------------------------------------------------------------------------------------- damage


def damages(content):
    """Yield a name and what is left of a file's bytes."""
    for position in [*range(0, len(content), 41), *range(90), len(content) - 1]:
        yield (
            f"bit of byte {position}",
            content[:position] + bytes([content[position] ^ 32]) + content[position + 1 :],
        )
    for length in [0, 1, 77, 78, 79, *range(100, len(content), 97), len(content) - 1]:
        yield f"cut to {length}", content[:length]
    yield "longer", content + b"\0"
    yield "foreign", b"PK\3\4 no record"
    yield "no text", b"\xff" * 300


@pytest.mark.parametrize("victim", [range(4), range(5, 6), range(8, 9)])
def test_damage_is_found_and_loses_that_record_alone(tmp_path, small, quick, victim):
    realisations = 8 * BLOCK_SIZE + 5
    undisturbed = continued(tmp_path / "once", realisations)
    continued(tmp_path / "run", realisations, [0, 1, 2, 3, 4, 5, 8])
    path = tmp_path / "run" / records._name(victim)
    intact = path.read_bytes()
    for name, content in damages(intact):
        path.write_bytes(content)
        with opened(tmp_path / "run") as run:
            assert len(run.damaged) == 1 and path.name in run.damaged[0], name
            assert "\n" not in run.damaged[0]
            assert set(run.missing(realisations)) == {6, 7} | set(victim), name
        assert not path.exists()
    assert continued(tmp_path / "run", realisations) == undisturbed
    assert files(tmp_path / "run") == files(tmp_path / "once")


def test_a_record_under_another_name_is_damaged(tmp_path, quick):
    continued(tmp_path, BLOCK_SIZE)
    path = tmp_path / records._name(range(1))
    for name in (
        records._name(range(1, 2)),
        "blocks-1-1.record",
        records._name(range(1, 65)),
        "blocks-.record",
    ):
        shutil.copy(path, tmp_path / name)
    (tmp_path / "notes.txt").write_text("mine")
    with opened(tmp_path) as run:
        assert len(run.damaged) == 4
        assert list(run.missing(3 * BLOCK_SIZE)) == [1, 2]
    assert set(files(tmp_path)) == {path.name, "notes.txt"}


def test_damage_during_the_run_is_told_and_the_next_run_repairs_it(tmp_path, quick):
    with opened(tmp_path / "run") as run:
        for block in range(3):
            run.add(block, BLOCK_SIZE, statistics(block, BLOCK_SIZE))
        (tmp_path / "run" / records._name(range(1, 2))).write_bytes(b"")
        with pytest.raises(
            StoreError,
            match="was damaged meanwhile; the 16 laps recorded there are safe; run the same",
        ):
            run.merge()
    assert continued(tmp_path / "run", 3 * BLOCK_SIZE) == continued(
        tmp_path / "once", 3 * BLOCK_SIZE
    )


# ----------------------------------------------------------------------------------------- refusals


def test_records_of_another_run_are_refused_and_left_alone(tmp_path, quick):
    continued(tmp_path / "records", 3 * BLOCK_SIZE)
    (tmp_path / "records" / "blocks-junk.record").write_bytes(b"")
    before = files(tmp_path / "records")
    other = {
        "seed": 4,
        "scenario": {"controller": {"horizon": 7, "weights": [1.0, 3.0]}, "plant": "s" * 90},
    }
    with pytest.raises(ScenarioError) as caught:
        opened(tmp_path / "records", other)
    line = str(caught.value)
    assert line.startswith("command line: --out = ") and "\n" not in line
    assert "seed = 3 there, 4 here; scenario.controller.horizon = 5 there, 7 here; " in line
    weights = "scenario.controller.weights.1 = 2.0 there, 3.0 here; and 2 more"
    assert f"{weights}; name another --out, or delete" in line
    assert files(tmp_path / "records") == before
    with opened(tmp_path / "records") as run:
        assert run.laps == 3 * BLOCK_SIZE


@pytest.mark.parametrize(
    ("there", "here", "told"),
    [
        ({"a": 1}, {"a": 1, "b": []}, "b = absent there, [] here"),
        (
            {"a": {"b": None}},
            {"a": None},
            "a = absent there, null here; a.b = null there, absent here",
        ),
        ({"a": {}, "b": 1}, {"b": 1}, "a = {} there, absent here"),
        ({"a": True}, {"a": 1}, "a = true there, 1 here"),
        ({"a": {"b": 1, "c": [2, {}]}}, {"a": {"c": [2, {}], "b": 1}}, ""),
    ],
)
def test_values_that_differ_are_named(there, here, told):
    assert record_file.differences(there, here) == told


def test_another_block_size_is_another_run(tmp_path, quick):
    continued(tmp_path, BLOCK_SIZE)
    with pytest.raises(ScenarioError, match="block_size = 8 there, 16 here; name another"):
        Records(tmp_path, IDENTITY, merge, 16)


def test_only_one_process_writes(tmp_path):
    with opened(tmp_path / "records"):
        with pytest.raises(ScenarioError) as caught:
            opened(tmp_path / "records")
        child = subprocess.run(
            [sys.executable, __file__, str(tmp_path / "records"), "1"],
            capture_output=True,
            text=True,
        )
    line = str(caught.value)
    assert "another process is writing there; wait for it" in line and "\n" not in line
    assert child.stderr.endswith(f"ScenarioError: {line}\n")
    opened(tmp_path / "records").close()


def test_a_folder_that_cannot_be_made_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(
        ScenarioError,
        match=r"--out = .*: cannot be written to \(.*\); name a folder you may write to$",
    ):
        opened(tmp_path / "file" / "records")


# ----------------------------------------------------------------------------------- a failing disk


def failing(code):
    def fail(*_, **__):
        raise OSError(code, os.strerror(code))

    return fail


@pytest.mark.parametrize(
    ("call", "code", "nth"),
    [
        ("fsync", errno.ENOSPC, 1),
        ("replace", errno.EACCES, 1),
        ("fsync", errno.EDQUOT, 2),  # the merged record
        ("fsync", errno.EIO, 3),  # the folder, before the parts go
        ("unlink", errno.EROFS, 1),
    ],
)
def test_a_failing_disk_costs_one_line_and_no_record(tmp_path, small, monkeypatch, call, code, nth):
    continued(tmp_path / "run", 4 * BLOCK_SIZE, range(3))
    before = files(tmp_path / "run")
    calls = []
    works = getattr(os, call)

    def breaking(*arguments):
        # The temporary file is unlinked after it was renamed, to no effect.
        if "/." not in str(arguments[0]) or call == "replace":
            calls.append(arguments)
        return failing(code)() if len(calls) == nth else works(*arguments)

    with opened(tmp_path / "run") as run:
        with monkeypatch.context() as patch, pytest.raises(StoreError) as caught:
            patch.setattr(os, call, breaking)
            run.add(3, BLOCK_SIZE, statistics(3, BLOCK_SIZE))
        safe = 24 if nth == 1 and call != "unlink" else 32
        assert run.laps == safe
    line = str(caught.value)
    failed = f"recording block 3 failed ({os.strerror(code)})"
    assert f"{failed}; the {safe} laps recorded there are safe; run" in line
    assert "\n" not in line
    assert not list((tmp_path / "run").glob(".*"))
    assert before.items() <= files(tmp_path / "run").items()
    assert continued(tmp_path / "run", 4 * BLOCK_SIZE) == continued(
        tmp_path / "once", 4 * BLOCK_SIZE
    )
    assert files(tmp_path / "run") == files(tmp_path / "once")


def test_a_file_that_the_system_cuts_short_is_never_seen(tmp_path):
    with opened(tmp_path) as run:
        run.add(0, BLOCK_SIZE, statistics(0, BLOCK_SIZE))
        before = files(tmp_path)
        soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (200, hard))
        try:
            with pytest.raises(
                StoreError, match=r"recording block 1 failed \(File too large\); the 8 laps"
            ):
                run.add(1, BLOCK_SIZE, statistics(1, BLOCK_SIZE))
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        assert files(tmp_path) == before
        run.add(1, BLOCK_SIZE, statistics(1, BLOCK_SIZE))
        assert run.laps == 2 * BLOCK_SIZE


def test_a_disk_that_cannot_be_read_is_no_damage(tmp_path, monkeypatch):
    continued(tmp_path, BLOCK_SIZE)
    before = files(tmp_path)
    with (
        monkeypatch.context() as patch,
        pytest.raises(StoreError, match="opening the records failed"),
    ):
        patch.setattr("pathlib.Path.read_bytes", failing(errno.EIO))
        opened(tmp_path)
    assert files(tmp_path) == before
    opened(tmp_path).close()


if __name__ == "__main__":
    # The process that is killed: it records blocks in an order of its own and tells each one.
    with opened(records.Path(sys.argv[1])) as run:
        missing = list(run.missing(int(sys.argv[2]) * BLOCK_SIZE))
        for number in np.random.default_rng(os.getpid()).permutation(missing).tolist():
            run.add(number, BLOCK_SIZE, statistics(number, BLOCK_SIZE))
            print(number, flush=True)
