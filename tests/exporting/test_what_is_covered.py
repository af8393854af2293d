"""`guaranteed` says no more than the certificate: what it is not about ends it from the start."""

import re
import shutil

import numpy as np
import pytest
from c_controller import COMPILER, CController, compile_c, needs_compiler

import jaxtube as jt
from jaxtube.exporting.replay import load_controller

SHORT = "reference.duration_s=2"
MEASURED = [
    "slip.right=[0.1, 0.3]",
    "slip.left=[0.1, 0.3]",
    "slip.measurement_error=0.01",
    "robot.wheel_speed_max_mps=4",
]


def export(tmp_path, name: str, overrides: list[str]):
    """Return the design of a scenario and its controllers, in NumPy and, if possible, in C."""
    design = jt.design(jt.load(name, [SHORT, *overrides]))
    folder = jt.export(design, tmp_path / "controller").folder
    module = load_controller(folder)
    controllers = [module.Controller(folder / "controller.npz")]
    if COMPILER is not None:
        controllers.append(CController(compile_c(folder, tmp_path / "controller.so")))
    return design, controllers


@pytest.mark.slow
def test_a_design_for_measured_slips_needs_them(tmp_path):
    design, controllers = export(tmp_path, "certified", MEASURED)
    assert design.certificate.holds_for_robot
    pose = design.problem.reference.poses[0]
    for controller in controllers:
        controller.restart()
        assert controller.step(pose, slip=(0.2, 0.2)).guaranteed
        controller.restart()
        assert not controller.step(pose).guaranteed


@pytest.mark.slow
def test_wheels_that_lag_have_to_run_at_the_start(tmp_path):
    design, controllers = export(tmp_path, "certified_lag", [])
    assert design.certificate.holds_for_robot
    pose = design.problem.reference.poses[0]
    for controller in controllers:
        controller.restart(runs=True)
        assert controller.step(pose).guaranteed
        controller.restart()
        output = controller.step(pose)
        assert not output.guaranteed
        assert np.all(np.isfinite(output.wheels))


@needs_compiler
def test_a_controller_that_was_never_begun_stands_still(library, certified):
    controller = CController(library)
    controller._memory.raw = bytes(len(controller._memory))
    output = controller.step(certified.problem.reference.poses[0])
    assert output.status == 4
    assert np.array_equal(output.wheels, [0.0, 0.0])


@needs_compiler
def test_c_code_refuses_arithmetic_that_the_proof_is_not_about(exported, tmp_path):
    with pytest.raises(AssertionError, match="ffast-math"):
        compile_c(exported.folder, tmp_path / "fast.so", "-ffast-math")


def test_without_slips_that_it_needs_nothing_is_guaranteed(controller, certified):
    pose = certified.problem.reference.poses[0]
    slip = certified.problem.scenario.slip.nominal
    controller.needs_slip = True
    assert controller.step(pose, slip=slip).guaranteed
    controller.restart()
    assert not controller.step(pose).guaranteed


@needs_compiler
def test_choices_of_the_preprocessor_are_hashed_like_numbers(exported, tmp_path):
    folder = tmp_path / "changed"
    shutil.copytree(exported.folder, folder)
    path = folder / "c" / "constants.h"
    text = path.read_text()
    for number, (name, value) in enumerate({"IS_CERTIFIED": 0, "NEEDS_SLIP": 1}.items()):
        changed = re.sub(rf"(#define JAXTUBE_{name}) \d", rf"\1 {value}", text)
        assert changed != text
        path.write_text(changed)
        assert not CController(compile_c(folder, tmp_path / f"c{number}.so", "-O0")).is_sound
