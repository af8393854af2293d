"""Laws of saved designs: what is read commands to the bit what was saved, and every change of a
byte is refused in one line before anything is designed."""

import io
import json
import os
import pickle
import shutil
import subprocess
import sys

import numpy as np
import pytest
from damage import damaged, is_one_line, list_files, only_reading
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import jaxtube as jt
from jaxtube import results, sealed, storage
from jaxtube.scenario import load, replace
from jaxtube.synthesis.design import restore_design

SHORT = "reference.duration_s=1"
ERRORS = ((0.05, -0.02, 0.1), (0.1, 0.1, 0.0), (-0.02, 0.05, -0.1))
"""Measured, of three periods, m, m, rad."""

PROGRAM = """
import json
import sys

import test_saved_designs as laws

import jaxtube as jt

print(json.dumps(laws.list_commands(jt.read(sys.argv[1]))))
"""


def list_commands(design):
    """Return the numbers of a design, and wheel speeds of a stepper and of laps, bit by bit."""
    stepper = jt.Stepper(design)
    steps = np.array([stepper(errors).wheels for errors in ERRORS])
    laps = jt.simulate(design, "tube_mpc", laps=3, seed=1)
    assert np.isfinite(steps).all() and np.ptp(laps.trajectory.wheels) > 0
    arrays = {name: sealed.hash_bytes(array.tobytes()) for name, array in design.arrays().items()}
    return {
        "arrays": arrays,
        "steps": steps.tobytes().hex(),
        "laps": laps.trajectory.wheels.tobytes().hex(),
    }


@pytest.fixture(scope="module")
def design():
    return jt.design(load("certified", SHORT))


@pytest.fixture(scope="module")
def saved(design, tmp_path_factory):
    return jt.save(design, tmp_path_factory.mktemp("saved") / "design")


@pytest.fixture
def folder(saved, tmp_path):
    """A copy of the saved design, elsewhere."""
    return shutil.copytree(saved, tmp_path / "inside" / "moved")


@pytest.fixture
def no_design(monkeypatch):
    """Fail where anything is designed."""
    monkeypatch.delattr(results, "design")
    monkeypatch.delattr(results, "restore_design")


def refuse(folder) -> str:
    """Return the one line with which a folder is refused; what lies there is only read."""
    with pytest.raises(jt.ScenarioError) as told, only_reading():
        jt.read(folder)
    assert is_one_line(told.value), told.value
    return str(told.value)


def forge(folder, files=(), **facts):
    """Change facts and files, and write the hashes that fit, as one who knows the format does."""
    told = sealed.unseal((folder / "result.json").read_bytes()) | facts
    hashes = told["files"]
    for name, content in dict(files).items():
        (folder / name).write_bytes(content)
        hashes[name] = sealed.hash_bytes(content)
    (folder / "result.json").write_bytes(sealed.seal(told))


def pack(arrays, save=np.savez_compressed) -> bytes:
    file = io.BytesIO()
    save(file, **arrays)
    return file.getvalue()


def unpack(folder) -> dict[str, np.ndarray]:
    with np.load(folder / "arrays.npz") as file:
        return dict(file)


# -------------------------------------------------------------------------------------- to the bit


def test_a_design_that_was_read_in_another_process_commands_to_the_bit(design, saved, request):
    commands = list_commands(design)
    # As these tests compile, and with what they have compiled.
    is_quick = request.config.option.markexpr == "not slow"
    compiling = {
        "JAX_DISABLE_MOST_OPTIMIZATIONS": str(int(is_quick)),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
    }
    paths = {"PYTHONPATH": os.pathsep.join([os.path.dirname(__file__), *sys.path])}
    run = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(saved)],
        env={**os.environ, **compiling, **paths},
        capture_output=True,
        text=True,
        check=True,
    )
    assert json.loads(run.stdout) == commands


def test_the_arrays_of_the_folder_are_those_that_command(folder):
    """And not those of the scenario designed again, from which they may differ by rounding."""
    arrays = unpack(folder)
    other = {
        name: array * (1 + 1e-12) if name.split("/")[0] in ("tube_qps", "plain_qps") else array
        for name, array in arrays.items()
    }
    forge(folder, {"arrays.npz": pack(other)})
    again = jt.read(folder)
    kept = again.arrays()
    assert kept.keys() == other.keys()
    for name, array in other.items():
        assert kept[name].tobytes() == array.tobytes(), name
    assert any(kept[name].tobytes() != arrays[name].tobytes() for name in arrays)
    assert again.certificate.holds_for_robot


def test_what_the_certificate_does_not_cover_is_refused_however_small(folder):
    arrays = unpack(folder)
    gains = {"tube_gain/vertices": arrays["tube_gain/vertices"] * (1 + 1e-11)}
    forge(folder, {"arrays.npz": pack(arrays | gains)})
    assert "NOT CERTIFIED: vertices_cover_schedule" in refuse(folder)


def test_a_design_that_was_read_is_certified_anew(design, saved):
    again = jt.read(saved)
    assert again.certificate.verdict == design.certificate.verdict
    assert again.certificate.conditions.keys() == design.certificate.conditions.keys()
    told = json.loads((saved / "result.json").read_text())["certificate"]
    assert told["verdict"] == design.certificate.verdict
    for condition in told["conditions"]:
        made = design.certificate.conditions[condition["name"]]
        assert float(condition["margin"]) == made.margin and condition["holds"] == made.holds
    for name, array in design.arrays().items():
        assert again.arrays()[name].tobytes() == array.tobytes(), name
    assert jt.save(again, saved) == saved


def test_a_verdict_that_does_not_hold_is_refused(folder):
    told = sealed.unseal((folder / "result.json").read_bytes())["certificate"]
    forge(folder, certificate={**told, "verdict": "CERTIFIED: as I say", "holds_for_robot": True})
    assert "certificate.verdict" in refuse(folder)
    conditions = [dict(condition) for condition in told["conditions"]]
    conditions[0]["holds"] = False
    forge(folder, certificate={**told, "conditions": conditions})
    assert f"certificate.{conditions[0]['name']}" in refuse(folder)


def test_arrays_that_swap_places_are_refused_whoever_wrote_the_hashes(folder, design):
    arrays = unpack(folder)
    swapped = {**arrays, "tube_qps/lower": arrays["tube_qps/upper"]}
    swapped["tube_qps/upper"] = arrays["tube_qps/lower"]
    forge(folder, {"arrays.npz": pack(swapped)})
    assert "differs from that of the scenario designed again" in refuse(folder)
    with pytest.raises(jt.ScenarioError, match="differs"):
        restore_design(design.problem.scenario, swapped)


# ----------------------------------------------------------------------------------- self-contained


def write_path(file):
    instants = 0.1 * np.arange(41)
    rows = [f"{t:.1f},{0.5 * t:.6f},{0.02 * t * t:.6f}" for t in instants]
    file.write_text("\n".join(["time_s,x_m,y_m", *rows]) + "\n")


def test_a_folder_that_was_moved_brings_the_files_that_its_scenario_names(
    tmp_path, uncertified, monkeypatch
):
    path = tmp_path / "there" / "way.csv"
    path.parent.mkdir()
    write_path(path)
    slips = path.with_name("log.txt")
    slips.write_text("time_s,right_slip,left_slip,sideslip\n0,0.2,0.2,0\n0.1,0.21,0.19,0\n")
    words = [
        "reference.shape=file",
        f"reference.file={path}",
        "reference.wheel_speed_min_mps=0.2",
        "slip.process=recorded",
        f"slip.recording={slips}",
    ]
    made = uncertified("paper", *words)
    folder = made.save(tmp_path / "there" / "design")
    assert {entry.name for entry in folder.iterdir()} == {
        *storage.FILES,
        "reference.csv",
        "slips.txt",
    }
    shutil.move(folder, tmp_path / "here")
    shutil.rmtree(path.parent)
    monkeypatch.chdir(tmp_path)
    stored = storage.read_result("here")
    assert stored.scenario == load("here") == load(tmp_path / "here")
    same = {"reference.file": str(path), "slip.recording": str(slips)}
    moved = made.problem.scenario
    for key, file in same.items():
        section, name = key.split(".")
        assert getattr(getattr(moved, section), name) == file
        kept = getattr(getattr(stored.scenario, section), name)
        assert kept.startswith(str(tmp_path / "here"))
    monkeypatch.setattr("jaxtube.synthesis.design.certify", lambda *sets: made.certificate)
    again = jt.read("here")
    for name, array in made.arrays().items():
        assert again.arrays()[name].tobytes() == array.tobytes(), name
    with (tmp_path / "here" / "reference.csv").open("a") as file:
        file.write("\n")
    assert "reference.csv differs from what was written" in refuse("here")
    with pytest.raises(jt.ScenarioError, match=r"reference\.csv differs"):
        load("here")


def test_a_bag_that_is_a_folder_is_copied_with_all_that_it_holds(tmp_path):
    bag = tmp_path / "bag"
    (bag / "parts").mkdir(parents=True)
    (bag / "metadata.yaml").write_text("a: 1\n")
    (bag / "parts" / "0.db3").write_bytes(b"rows")
    scenario = load("paper", ["reference.shape=file", f"reference.file={bag}"])
    stored = storage.StoredResult("laps", scenario, {}, {"a": np.zeros(2)})
    folder = storage.write_result(tmp_path / "laps", stored)
    shutil.rmtree(bag)
    moved = shutil.move(folder, tmp_path / "moved")
    shutil.copytree(moved, tmp_path / "replaced")
    plain = stored._replace(scenario=load("paper"))
    for _ in range(2):
        storage.write_result(tmp_path / "replaced", plain)
    assert {entry.name for entry in (tmp_path / "replaced").iterdir()} == set(storage.FILES)
    again = storage.read_result(moved)
    assert again.scenario.reference.file == str(moved / "reference")
    assert list_files(moved / "reference") == {
        "metadata.yaml": b"a: 1\n",
        "parts/0.db3": b"rows",
    }
    (moved / "reference" / "parts" / "0.db3").write_bytes(b"rowz")
    with pytest.raises(jt.ScenarioError, match=r"reference/parts/0\.db3 differs"):
        storage.read_result(moved)


def test_a_result_replaces_the_copies_of_the_one_before(tmp_path, uncertified):
    path = tmp_path / "way.csv"
    write_path(path)
    words = ["reference.shape=file", f"reference.file={path}"]
    made = uncertified("paper", *words)
    made.save(tmp_path / "design")
    uncertified("paper").save(tmp_path / "design")
    assert {entry.name for entry in (tmp_path / "design").iterdir()} == set(storage.FILES)


# ------------------------------------------------------------------------------------------ damage


def swap_two(arrays, random):
    names = [name for name, array in arrays.items() if array.size]
    one, other = random.choice(names, 2, replace=False)
    if arrays[one].tobytes() != arrays[other].tobytes():
        arrays[one], arrays[other] = arrays[other], arrays[one]
    else:
        put_nan(arrays, random)


def put_nan(arrays, random):
    names = [name for name, array in arrays.items() if array.dtype.kind == "f" and array.size]
    name = str(random.choice(names))
    arrays[name] = arrays[name].copy()
    arrays[name].flat[random.integers(arrays[name].size)] = np.nan


def damage(folder, random):
    """Change one file of a saved result, its hash left as it is."""
    names = [path.name for path in sorted(folder.iterdir())]
    path = folder / str(random.choice(names))
    data = path.read_bytes()
    kind = random.integers(7)
    if kind <= 2:
        place = random.integers(len(data))
        flipped = bytes([data[place] ^ (1 << random.integers(8))])
        path.write_bytes(data[:place] + flipped + data[place + 1 :])
    elif kind == 3:
        path.write_bytes(data[: random.integers(len(data))])
    elif kind == 4:
        path.write_bytes(data + random.bytes(random.integers(1, 9)))
    elif kind == 5:
        other = folder / str(random.choice([name for name in names if name != path.name]))
        path.write_bytes(other.read_bytes())
        other.write_bytes(data)
    else:
        arrays = unpack(folder)
        random.choice([swap_two, put_nan])(arrays, random)
        (folder / "arrays.npz").write_bytes(pack(arrays, np.savez))


def test_a_thousand_damaged_designs_are_refused_before_anything_is_designed(folder, no_design):
    random = np.random.default_rng(7)
    whole = list_files(folder)
    for _ in range(1000):
        damage(folder, random)
        changed = list_files(folder)
        assert changed != whole
        refuse(folder)
        assert list_files(folder) == changed
        for name, content in whole.items():
            if changed[name] != content:
                (folder / name).write_bytes(content)


def read_facts_only(folder, data, whole):
    """Read a design whose result.json is damaged, then one whose damage is sealed anew."""
    (folder / "result.json").write_bytes(data)
    if data != whole:
        refuse(folder)
    try:
        content = json.loads(data)
        forged = sealed.seal({k: v for k, v in content.items() if k != "sha256"})
    except (ValueError, AttributeError, RecursionError):
        return
    (folder / "result.json").write_bytes(forged)
    try:
        with only_reading():
            storage.read_result(folder)
    except jt.ScenarioError as error:
        assert is_one_line(error)


def read_forged_arrays(folder, data):
    """Read arrays that are damaged and whose hash was made to fit."""
    forge(folder, {"arrays.npz": data})
    try:
        with only_reading():
            arrays = storage.read_result(folder).arrays
    except jt.ScenarioError as error:
        assert is_one_line(error)
    else:
        assert all(isinstance(array, np.ndarray) for array in arrays.values())
        assert not any(array.dtype.hasobject for array in arrays.values())


def fuzz_saved_design(folder, count):
    whole = list_files(folder)
    usual = settings(
        max_examples=count,
        deadline=None,
        database=None,
        derandomize=True,
        suppress_health_check=list(HealthCheck),
    )

    @usual
    @given(damaged([whole["result.json"]]))
    def damage_facts(data):
        read_facts_only(folder, data, whole["result.json"])

    @usual
    @given(damaged([whole["arrays.npz"], pack({"a": np.arange(3.0)})]))
    def damage_arrays(data):
        read_forged_arrays(folder, data)

    @usual
    @given(st.text(max_size=12) | st.sampled_from(["../x", "/x", "a/../../x", "", ".", "a//b"]))
    def damage_names(name):
        files = sealed.unseal(whole["result.json"])["files"]
        forge(folder, files={}, **{"kind": "design"})
        (folder / "result.json").write_bytes(
            sealed.seal({**sealed.unseal(whole["result.json"]), "files": {**files, name: "0" * 64}})
        )
        refuse(folder)

    damage_facts()
    (folder / "result.json").write_bytes(whole["result.json"])
    damage_arrays()
    damage_names()


def test_forged_designs_are_refused_in_one_line(folder, no_design):
    fuzz_saved_design(folder, 30)


@pytest.mark.slow
def test_two_thousand_forged_designs_are_refused_in_one_line(folder, no_design):
    fuzz_saved_design(folder, 700)


class Touching:
    """What creates a file where it is unpickled."""

    def __init__(self, path):
        self.path = str(path)

    def __reduce__(self):
        return open, (self.path, "w")


def test_pickles_in_a_folder_are_not_unpickled(folder, tmp_path, no_design):
    victim = tmp_path / "touched"
    arrays = unpack(folder)
    hidden = np.empty(1, dtype=object)
    hidden[0] = Touching(victim)
    for content in (
        pack({**arrays, "tube_qps/lower": hidden}),
        pickle.dumps(Touching(victim)),
        pickle.dumps({"tube_qps/lower": Touching(victim)}),
    ):
        forge(folder, {"arrays.npz": content})
        assert "arrays.npz is no archive of arrays" in refuse(folder)
        assert not victim.exists()
    pickle.loads(pickle.dumps(Touching(victim))).close()  # it would have
    assert victim.exists()


def test_names_do_not_lead_out_of_the_folder(folder, tmp_path, design, no_design):
    outside = tmp_path / "inside" / "victim"
    outside.write_text("mine")
    hashed = sealed.hash_bytes(b"mine")
    facts = sealed.unseal((folder / "result.json").read_bytes())
    for name in ("../victim", str(outside), "./../victim", "a/../../victim"):
        files = {**facts["files"], name: hashed}
        (folder / "result.json").write_bytes(sealed.seal({**facts, "files": files}))
        assert "names other files than its own" in refuse(folder)
        design.save(folder)
        assert outside.read_text() == "mine"
    (folder / "result.json").write_bytes(sealed.seal(facts))
    linked = tmp_path / "inside" / "linked"
    linked.mkdir()
    (linked / "a.txt").write_text("mine")
    (folder / "reference").symlink_to(linked)
    files = {**facts["files"], "reference/a.txt": hashed}
    (folder / "result.json").write_bytes(sealed.seal({**facts, "files": files}))
    assert "is a link to another place" in refuse(folder)
    with pytest.raises(jt.ScenarioError, match="holds links to other places"):
        design.save(folder)
    assert (linked / "a.txt").read_text() == "mine"
    (folder / "reference").unlink()
    (folder / "result.json").write_bytes(sealed.seal(facts))
    forge(folder, {"arrays.npz": pack({"../victim": np.ones(2), str(outside): np.ones(2)})})
    before = list_files(tmp_path)
    with only_reading():
        assert "../victim" in storage.read_result(folder).arrays
    assert list_files(tmp_path) == before
    text = (folder / "scenario.toml").read_text()
    forged = text.replace('shape = "two_circles"', 'shape = "file"')
    forged = forged.replace('file = ""', 'file = "../victim"')
    assert forged != text
    forge(folder, {"scenario.toml": forged.encode()})
    assert "reference.file names a file outside the folder" in refuse(folder)


# ---------------------------------------------------------------------------------------- scenarios


def test_a_folder_stands_for_its_scenario(folder, design):
    assert load(folder) == design.problem.scenario
    longer = load(folder, "controller.horizon=6")
    assert longer == replace(design.problem.scenario, {"controller.horizon": 6})
    (folder / "scenario.toml").write_text("")
    with pytest.raises(jt.ScenarioError, match=r"scenario\.toml differs"):
        load(folder)


def test_the_door_saves_results_alone(tmp_path):
    with pytest.raises(ValueError, match="give what design, simulate"):
        jt.save("certified", tmp_path)
    assert list(tmp_path.iterdir()) == []
