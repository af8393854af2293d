"""A damaged controller is refused: by its loader, by its own hash, or by the sums of its files."""

import hashlib
import re
import shutil
import subprocess

import numpy as np
import pytest
from c_controller import CController, compile_c, needs_compiler

from jaxtube.exporting.replay import load_controller
from jaxtube.exporting.write import SUMS, refuse_foreign
from jaxtube.scenario.refusal import ScenarioError

MUTATIONS = 1000


def list_files(folder) -> set[str]:
    """Return the names of all files but those that Python makes where a controller is imported."""
    files = (path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    return {path.as_posix() for path in files if "__pycache__" not in path.parts}


def check_sums(folder) -> bool:
    """Say what `sha256sum --check --strict` says."""
    lines = (folder / SUMS).read_bytes().split(b"\n")
    if lines[-1] != b"":
        return False
    for line in lines[:-1]:
        match = re.fullmatch(rb"([0-9a-f]{64})  (\S+)", line)
        if match is None:
            return False
        path = folder / match[2].decode(errors="replace")
        if not path.is_file():
            return False
        if hashlib.sha256(path.read_bytes()).hexdigest().encode() != match[1]:
            return False
    return len(lines) > 1


def mutate(content: bytes, generator: np.random.Generator) -> bytes:
    """Return content with a flipped bit, a lost end, a lost, doubled or exchanged stretch, or a
    NaN."""
    place = int(generator.integers(len(content)))
    other = int(generator.integers(len(content)))
    low = min(place, other)
    high = max(place, other) + 1
    kind = generator.integers(6)
    if kind == 0:
        flipped = bytearray(content)
        flipped[place] ^= 1 << int(generator.integers(8))
        return bytes(flipped)
    if kind == 1:
        return content[:place]
    if kind == 2:
        return content[:low] + content[high:]
    if kind == 3:
        return content[:low] + content[low:high] + content[low:]
    if kind == 4:
        return content[:low] + content[high:] + content[low:high]
    return content[:place] + np.array(np.nan).tobytes() + content[place + 8 :]


def test_a_thousand_mutations_of_the_folder_are_all_found(exported, tmp_path):
    folder = tmp_path / "mutated"
    shutil.copytree(exported.folder, folder)
    names = sorted(list_files(folder))
    assert check_sums(folder)
    generator = np.random.default_rng(4)
    for number in range(MUTATIONS):
        path = folder / names[number % len(names)]
        content = path.read_bytes()
        mutated = mutate(content, generator)
        if mutated == content:
            continue
        path.write_bytes(mutated)
        assert not check_sums(folder), (path, number)
        path.write_bytes(content)


def test_a_mutated_file_of_numbers_never_runs(exported, tmp_path):
    folder = tmp_path / "mutated"
    shutil.copytree(exported.folder, folder)
    module = load_controller(folder)
    path = folder / "controller.npz"
    content = path.read_bytes()
    generator = np.random.default_rng(5)
    for _ in range(200):
        mutated = mutate(content, generator)
        path.write_bytes(mutated)
        if mutated != content:
            with pytest.raises(ValueError, match="SHA256SUMS"):
                module.Controller(path)


def test_arrays_that_changed_places_never_run(exported, tmp_path):
    folder = tmp_path / "swapped"
    shutil.copytree(exported.folder, folder)
    path = folder / "controller.npz"
    with np.load(path) as file:
        arrays = dict(file)
    arrays |= {"rows": arrays["whitened"], "whitened": arrays["rows"]}
    np.savez_compressed(path, **arrays)
    with pytest.raises(ValueError, match="SHA256SUMS"):
        load_controller(folder).Controller(path)


def test_a_changed_program_refuses_itself(exported, tmp_path):
    folder = tmp_path / "changed"
    shutil.copytree(exported.folder, folder)
    path = folder / "controller.py"
    path.write_text(path.read_text().replace("2.0 * math.sin", "3.0 * math.sin"))
    with pytest.raises(ValueError, match="SHA256SUMS"):
        load_controller(folder).Controller(folder / "controller.npz")


@pytest.mark.skipif(shutil.which("sha256sum") is None, reason="there is no sha256sum here")
def test_make_checks_the_files_first(exported, tmp_path):
    folder = tmp_path / "changed"
    shutil.copytree(exported.folder, folder)
    command = ["sha256sum", "--check", "--quiet", "--strict", SUMS]
    assert subprocess.run(command, cwd=folder, check=False).returncode == 0
    path = folder / "c" / "constants.c"
    path.write_text(path.read_text().replace("0x1.", "0x1.0", 1))
    assert subprocess.run(command, cwd=folder, capture_output=True, check=False).returncode != 0


@needs_compiler
def test_constants_that_were_changed_and_compiled_are_found_before_the_first_step(
    exported, tmp_path
):
    folder = tmp_path / "changed"
    shutil.copytree(exported.folder, folder)
    path = folder / "c" / "constants.c"
    text = path.read_text()
    numbers = [match.span() for match in re.finditer(r"-?0x[01]\.[0-9a-f]+p[+-]\d+\b", text)]
    generator = np.random.default_rng(6)
    for number in range(5):
        begin, end = numbers[int(generator.integers(len(numbers)))]
        value = float.fromhex(text[begin:end])
        changed = np.nextafter(value, np.inf).hex()
        path.write_text(text[:begin] + changed + text[end:])
        controller = CController(compile_c(folder, tmp_path / f"c{number}.so", "-O0"))
        assert not controller.is_sound
        output = controller.step(np.zeros(3))
        assert output.status == 4
        assert not output.guaranteed
        assert np.array_equal(output.wheels, [0.0, 0.0])


def test_only_files_of_an_export_are_replaced(tmp_path):
    for name in ("mine.txt", SUMS, "c/controller.h", "c/mine.c"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("mine")
    with pytest.raises(ScenarioError, match="no export has written"):
        refuse_foreign(tmp_path)
    (tmp_path / "mine.txt").unlink()
    with pytest.raises(ScenarioError, match=r"c/mine\.c"):
        refuse_foreign(tmp_path)
    (tmp_path / "c" / "mine.c").unlink()
    refuse_foreign(tmp_path)
    # As a killed export leaves it.
    (tmp_path / SUMS).unlink()
    (tmp_path / "c" / ".constants.c.123").write_text("half")
    refuse_foreign(tmp_path)


def test_the_sums_are_of_all_files(exported):
    named = {line.split()[1] for line in (exported.folder / SUMS).read_text().splitlines()}
    assert list_files(exported.folder) == named | {SUMS}
