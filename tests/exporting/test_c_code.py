"""The C of an exported controller: no warning, no undefined behaviour, no access out of bounds, and
no more operations than it says."""

import ctypes
import shutil
import subprocess

import jax.numpy as jnp
import numpy as np
import pytest
from c_controller import COMPILER, WARNINGS, CController, compile_c, needs_compiler

from jaxtube.exporting.proof import prove_floats
from jaxtube.plant.error_dynamics import world_pose
from jaxtube.synthesis.feasible import reach_of_ray

pytestmark = needs_compiler


@pytest.mark.parametrize("flags", [["-Wdouble-promotion", "-Wcast-qual"], ["-DJAXTUBE_FLOAT32"]])
@pytest.mark.parametrize("level", ["-O0", "-O3"])
def test_it_compiles_without_a_warning(exported, tmp_path, flags, level):
    compile_c(exported.folder, tmp_path / "replay", *WARNINGS, *flags, level, main=True)


def test_it_asks_for_nothing_but_math(exported):
    source = (exported.folder / "c" / "controller.c").read_text()
    included = {line.split()[1] for line in source.splitlines() if line.startswith("#include")}
    assert included == {'"controller.h"', "<math.h>", "<stddef.h>", "<string.h>"}
    assert "malloc" not in source


def has_sanitizers(folder) -> bool:
    """Say whether the compiler links a program with sanitizers."""
    source = folder / "empty.c"
    source.write_text("int main(void) { return 0; }\n")
    flags = ["-fsanitize=undefined,address", "-o", str(folder / "empty")]
    return subprocess.run([COMPILER, *flags, source], capture_output=True).returncode == 0


def test_sanitizers_find_nothing(exported, tmp_path):
    checks = "-fsanitize=undefined,address,float-divide-by-zero,float-cast-overflow"
    flags = (checks, "-fno-sanitize-recover=all", "-g")
    if not has_sanitizers(tmp_path):
        pytest.skip("this compiler has no sanitizers")
    program = compile_c(exported.folder, tmp_path / "replay", *flags, main=True)
    steps = exported.folder / "c" / "steps.csv"
    done = subprocess.run([program, steps], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "runtime error" not in done.stderr


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("valgrind") is None, reason="there is no valgrind here")
def test_valgrind_finds_nothing(exported, tmp_path):
    program = compile_c(exported.folder, tmp_path / "replay", "-g", "-O1", main=True)
    steps = exported.folder / "c" / "steps.csv"
    command = ["valgrind", "--error-exitcode=9", "--leak-check=full", "--track-origins=yes"]
    done = subprocess.run([*command, program, steps], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def counting(exported, tmp_path_factory):
    """A library that counts what it does."""
    return compile_c(
        exported.folder, tmp_path_factory.mktemp("counting") / "c.so", "-DJAXTUBE_COUNT"
    )


def test_no_plan_takes_more_operations_than_the_bound(exported, counting):
    controller = CController(counting)
    counter = ctypes.c_ulong.in_dll(ctypes.CDLL(str(counting)), "jaxtube_operations")
    generator = np.random.default_rng(2)
    most = 0
    for _ in range(3000):
        controller.restart()
        pose = generator.uniform(-1.0, 1.0, 3) * [0.5, 0.5, 0.6]
        counter.value = 0
        controller.step(pose)
        most = max(most, counter.value)
    assert 10_000 < most <= exported.operations


def test_floats_call_no_error_infeasible_that_has_a_plan(exported, certified, tmp_path):
    floats = CController(compile_c(exported.folder, tmp_path / "c.so", "-DJAXTUBE_FLOAT32"))
    proof = prove_floats(certified)
    assert proof is not None
    qps = proof.design.tube_qps
    window = certified.first_window
    generator = np.random.default_rng(8)
    statuses = []
    for direction in generator.normal(size=(150, 3)) * certified.problem.operating_set.offsets[:3]:
        reach = reach_of_ray(qps, window, direction, np.zeros(3))
        for share in (0.9995, 0.999, 0.998, 1.02):
            floats.restart()
            error = jnp.asarray(share * reach * direction)
            pose = np.asarray(world_pose(error, certified.problem.reference.poses[0]))
            statuses.append(floats.step(pose).status)
            assert statuses[-1] != 1 or share > 1
    assert set(statuses) >= {0, 1}


def test_floats_command_nearly_what_doubles_do(exported, library, tmp_path):
    floats = CController(compile_c(exported.folder, tmp_path / "c.so", "-DJAXTUBE_FLOAT32"))
    assert floats.is_sound
    doubles = CController(library)
    generator = np.random.default_rng(3)
    differences = []
    for _ in range(500):
        pose = generator.uniform(-1.0, 1.0, 3) * [0.1, 0.15, 0.2]
        floats.restart()
        doubles.restart()
        ours = floats.step(pose)
        theirs = doubles.step(pose)
        if ours.status == theirs.status == 0:
            differences.append(np.abs(ours.wheels - theirs.wheels).max())
    # Not rounding makes the difference but constraints that are drawn in by up to a millimetre.
    assert len(differences) > 100
    assert np.median(differences) < 1e-5
    assert max(differences) < 1e-2
