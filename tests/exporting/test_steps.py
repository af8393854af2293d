"""An exported controller commands what the controller of the design does, in NumPy and in C, on
laps and on errors from everywhere, where there is a plan and where there is none."""

import subprocess
import sys

import jax.numpy as jnp
import numpy as np
import pytest
from c_controller import CController, compile_c, needs_compiler
from doubtful import Doubtful

import jaxtube as jt
from jaxtube import qp
from jaxtube.control import planning
from jaxtube.exporting import recording as recordings
from jaxtube.exporting.recording import Recording, draw_starts, record_laps
from jaxtube.exporting.replay import load_controller, replay_in_numpy
from jaxtube.exporting.write import LAPS
from jaxtube.plant.error_dynamics import world_pose
from jaxtube.simulation import components

SAME = 1e-9
"""By how much commands may differ, m/s and rad/s: what is asked of an exported controller."""
FAR = 1.4
"""Times the edge of the feasible set from which laps also start: many of their QPs have no plan."""


def require_commands(controller, recording: Recording, dt: float) -> None:
    """Assert that a controller commands what was recorded."""
    steps, laps = recording.status.shape
    for lap in range(laps):
        controller.restart(runs=True)
        for step in range(steps):
            output = controller.step(
                recording.poses[step, lap], step * dt, step * dt, recording.slips[step, lap]
            )
            assert output.status == recording.status[step, lap]
            np.testing.assert_allclose(
                output.errors, recording.errors[step, lap], rtol=0, atol=SAME
            )
            np.testing.assert_allclose(
                output.inputs, recording.inputs[step, lap], rtol=0, atol=SAME
            )
            np.testing.assert_allclose(
                output.wheels, recording.wheels[step, lap], rtol=0, atol=SAME
            )


@pytest.fixture(scope="module")
def recording(certified):
    """Laps from the start, from the edge of the feasible set, and from beyond it."""
    starts = draw_starts(certified, LAPS)
    # As many as an export records, for one program.
    return record_laps(certified, np.concatenate([starts[2:], FAR * starts[-2:]]))


def test_laps_that_the_short_program_leaves_are_recorded_from_the_whole_one(certified, monkeypatch):
    inner = components.controllers(certified)["compensated"]
    starts = np.array([[0.0, 0.0, 0.0], [0.0, 0.15, 0.0]])

    def record(far):
        doubtful = Doubtful(inner, jnp.array(far))
        monkeypatch.setattr(recordings, "make_tube_mpc", lambda design: doubtful)
        return record_laps(certified, starts)

    left = record(0.1)
    solved = record(np.inf)
    assert not np.any(left.status == qp.UNSOLVED)
    np.testing.assert_array_equal(left.wheels[:, 0], solved.wheels[:, 0])
    assert not np.array_equal(left.wheels[:, 1], solved.wheels[:, 1])


def test_numpy_commands_what_the_design_commands(controller, certified, recording):
    assert np.any(recording.status != 0)
    assert np.any(recording.status == 0)
    require_commands(controller, recording, certified.problem.reference.dt)


@needs_compiler
def test_c_commands_what_the_design_commands(c_controller, certified, recording):
    require_commands(c_controller, recording, certified.problem.reference.dt)


def test_recorded_steps_are_in_the_folder(exported):
    replay = replay_in_numpy(exported.folder)
    assert replay.steps == exported.recorded
    assert replay.wrong == 0


@needs_compiler
def test_main_plays_the_recorded_steps(exported, tmp_path):
    program = compile_c(exported.folder, tmp_path / "replay", main=True)
    steps = exported.folder / "c" / "steps.csv"
    done = subprocess.run([program, steps], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    assert f"steps {exported.recorded}, wrong 0" in done.stdout


@needs_compiler
def test_main_finds_a_step_that_differs(exported, tmp_path):
    program = compile_c(exported.folder, tmp_path / "replay", main=True)
    lines = (exported.folder / "c" / "steps.csv").read_text().splitlines()
    words = lines[3].split(",")
    words[9] = repr(float(words[9]) + 1e-8)
    steps = tmp_path / "steps.csv"
    steps.write_text("\n".join([*lines[:3], ",".join(words), *lines[4:]]) + "\n")
    done = subprocess.run([program, steps], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "wrong 1," in done.stdout


def require_plans(design, controller, count: int, seed: int) -> int:
    """Compare plans from errors in a box wider than the caps with those of the design, window by
    window; return how many errors have a plan."""
    generator = np.random.default_rng(seed)
    caps = np.asarray(controller.caps)
    solved = 0
    for window in range(len(controller.rows)):
        errors = generator.uniform(-1.3, 1.3, (count, 3)) * caps
        qp = planning.take_qp(design.tube_qps, window)
        plans = planning.constrained_plan(qp, jnp.asarray(errors))
        for error, status, inputs in zip(errors, plans.status, plans.inputs, strict=True):
            found, plan, _ = controller._make_plan(window, error)
            assert found == int(status)
            if plan is not None:
                solved += 1
                np.testing.assert_allclose(plan, np.asarray(inputs), rtol=0, atol=SAME)
    return solved


def test_plans_from_anywhere_are_those_of_the_design(certified, controller):
    count = 100
    solved = require_plans(certified, controller, count, seed=3)
    assert 0 < solved < count * len(controller.rows)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["certified", "tuned", "robust", "husky", "certified_lag"])
def test_ten_thousand_steps_of_a_scenario_are_those_of_the_design(name, tmp_path):
    design = jt.design(jt.load(name))
    exported = jt.export(design, tmp_path / "controller", name)
    dt = design.problem.reference.dt
    starts = draw_starts(design, 12)
    recording = record_laps(design, np.concatenate([starts, FAR * starts[12:]]))
    assert recording.status.size >= 10_000
    module = load_controller(exported.folder)
    controller = module.Controller(exported.folder / "controller.npz")
    require_commands(controller, recording, dt)
    require_plans(design, controller, 1000, seed=4)
    library = compile_c(exported.folder, tmp_path / "controller.so")
    require_commands(CController(library), recording, dt)


def test_the_controller_needs_numpy_alone(exported):
    source = (exported.folder / "controller.py").read_text()
    assert len(source.splitlines()) < 200
    code = (
        "import sys; sys.path.insert(0, '.'); import controller; controller.Controller(); "
        "print(sorted({name.split('.')[0] for name in sys.modules} & {'jax', 'scipy', 'jaxtube'}))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=exported.folder,
        capture_output=True,
        text=True,
        check=True,
        env={"PATH": ""},
    )
    assert done.stdout.strip() == "[]"


def test_turning_whole_circles_changes_no_command(controller, certified):
    pose = np.add(certified.problem.reference.poses[0], [0.01, 0.02, 0.03])
    straight = controller.step(pose)
    controller.restart()
    turned = controller.step(np.add(pose, [0.0, 0.0, 6 * np.pi]))
    np.testing.assert_allclose(turned.wheels, straight.wheels, rtol=0, atol=1e-12)


def test_poses_are_of_the_frame_of_the_reference(controller, certified):
    error = np.array([0.02, -0.03, 0.05])
    poses = certified.problem.reference.poses
    for period in range(40):
        pose = np.asarray(world_pose(jnp.asarray(error), poses[period]))
        np.testing.assert_allclose(controller.step(pose).errors, error, rtol=0, atol=1e-12)
