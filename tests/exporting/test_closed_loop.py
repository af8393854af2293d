"""The exported controllers drive the robot: no period leaves W, E, U or the wheels' limits, and
every QP has a plan. All of it is computed here, from the sets of the design."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from c_controller import CController, compile_c, needs_compiler

import jaxtube as jt
from jaxtube.exporting.recording import draw_starts
from jaxtube.plant.error_dynamics import world_pose
from jaxtube.plant.protocol import Command
from jaxtube.simulation.components import slipping_robot
from jaxtube.simulation.rollout import realisation_keys

ROUNDING = 1e-9


def drive(design, controllers: list, starts, slip: str) -> dict[str, float]:
    """Drive one lap with each controller; return by how much each limit was passed at worst, and
    how many steps had no plan or no guarantee."""
    problem = design.problem
    plant = slipping_robot(design, slip)
    keys = realisation_keys(1, 0, len(starts))
    sense = jax.jit(plant.sense)
    advance = jax.jit(plant.advance)
    errors = jnp.asarray(starts)
    memory = plant.initial(keys, errors)
    rows = problem.input_rows
    worst = {"w": -np.inf, "e": -np.inf, "u": -np.inf, "wheels": -np.inf, "plans": 0, "steps": 0}
    before = None
    for step in range(problem.reference.steps):
        measurement, memory = sense(keys, jnp.asarray(step), memory, errors)
        measured = np.asarray(measurement.errors)
        poses = np.asarray(world_pose(measurement.errors, problem.reference.poses[step]))
        now = step * problem.reference.dt
        outputs = [
            controller.step(pose, now, now, slips)
            for controller, pose, slips in zip(
                controllers, poses, np.asarray(measurement.slip), strict=True
            )
        ]
        inputs = np.array([output.inputs for output in outputs])
        wheels = np.array([output.wheels for output in outputs])
        worst["plans"] += sum(output.status != 0 or not output.guaranteed for output in outputs)
        worst["steps"] += len(outputs)
        if before is not None:
            w = measured - before
            normals = problem.disturbance_set.normals
            offsets = problem.disturbance_set.offsets
            worst["w"] = max(worst["w"], np.max(w @ normals.T - offsets))
        transition, matrix = problem.model.matrices(problem.schedule[step])
        before = measured @ transition.T + inputs @ matrix.T
        of_rows = inputs @ rows.inputs.T + measured @ rows.errors.T - rows.offsets
        worst["u"] = max(worst["u"], np.max(of_rows))
        true = np.asarray(errors)
        limits = problem.error_set
        worst["e"] = max(worst["e"], np.max(true @ limits.normals.T - limits.offsets))
        low = problem.robot.wheel_speed_min
        high = problem.robot.wheel_speed_max
        worst["wheels"] = max(worst["wheels"], np.max(np.maximum(low - wheels, wheels - high)))
        command = Command(jnp.asarray(inputs), jnp.asarray(wheels))
        errors, memory, _ = advance(keys, jnp.asarray(step), memory, errors, command)
    return worst


def require_kept(worst: dict[str, float]) -> None:
    for name in ("w", "e", "u", "wheels"):
        assert worst[name] <= ROUNDING, (name, worst)
    assert worst["plans"] == 0


@needs_compiler
def test_no_limit_is_passed_with_the_c_controller_in_the_loop(certified, library):
    starts = draw_starts(certified, 8)
    require_kept(drive(certified, [CController(library) for _ in starts], starts, "patches"))


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize("slip", ["vertex", "constant", "adversarial"])
def test_no_limit_is_passed_in_a_hundred_thousand_steps(slip, tmp_path):
    design = jt.design(jt.load("certified"))
    exported = jt.export(design, tmp_path / "controller", "certified")
    library = compile_c(exported.folder, tmp_path / "controller.so")
    starts = draw_starts(design, 167)
    worst = drive(design, [CController(library) for _ in starts], starts, slip)
    print(slip, worst)
    assert worst["steps"] >= 100_000
    require_kept(worst)
