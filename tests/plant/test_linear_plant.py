"""Laws of the linear plant: disturbances drawn in W, and deviations from a plan that stay inside
the tubes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import SEQUENCE, model
from tolerances import CLOSED_LOOP, INSIDE_TUBE

from jaxtube import qp
from jaxtube.control import planning
from jaxtube.simulation import batches, components
from jaxtube.simulation.rollout import begin, follow_plan, realisation_keys
from sets.tubes import sequence_tube

AT_A_VERTEX = 1e-8
"""Relative; a disturbance of 3 mm rebuilt from errors of order one."""

BATCH = batches.BATCH
STEPS = 300


@pytest.fixture(scope="module")
def disturbances(robust_design, stressed):
    """w(k) = e(k+1) - A e(k) - B u(k) of the stressed runs, by plain products."""
    problem = robust_design.problem
    found = []
    trajectory = stressed["tube_mpc"]
    for step in range(STEPS):
        A, B = model(problem, problem.schedule[step])
        found.append(
            trajectory.errors[step + 1]
            - trajectory.errors[step] @ A.T
            - trajectory.inputs[step] @ B.T
        )
    return np.array(found)


def test_disturbances_of_the_linear_plant_are_those_drawn(robust_design, stressed, disturbances):
    plant = components.linear_plant(robust_design)
    keys = realisation_keys(5, 0, BATCH)
    drawn = jax.jit(
        jax.vmap(lambda step: jax.vmap(lambda key: plant.disturbance(key, step))(keys))
    )(jnp.arange(STEPS))
    np.testing.assert_allclose(disturbances[:, :BATCH], drawn, atol=CLOSED_LOOP)
    np.testing.assert_allclose(
        batches.model_disturbances(robust_design, stressed["tube_mpc"]),
        disturbances,
        atol=CLOSED_LOOP,
    )


def test_disturbances_fill_W_and_reach_every_vertex(robust_design, disturbances):
    W = robust_design.problem.disturbance_set
    assert W.margin(disturbances).min() >= INSIDE_TUBE
    units = disturbances.reshape(-1, 3) / W.support(np.eye(3))
    corners = np.all(np.abs(np.abs(units) - 1) <= AT_A_VERTEX, axis=1)
    assert abs(corners.mean() - 0.5) < 0.01
    patterns, counts = np.unique(np.sign(units[corners]), axis=0, return_counts=True)
    assert len(patterns) == 8 and np.ptp(counts) < 0.1 * counts.mean()
    assert np.all(np.abs(units.mean(axis=0)) < 0.01)
    # Runs and steps are disturbed independently.
    first = disturbances[:, :, 1]
    assert abs(np.corrcoef(first[:-1].ravel(), first[1:].ravel())[0, 1]) < 0.01
    assert abs(np.corrcoef(first[:, :-1].ravel(), first[:, 1:].ravel())[0, 1]) < 0.01


planned = jax.jit(planning.plan)


@pytest.fixture(scope="module")
def deviations(robust_design, stressed):
    """(step, deviations (N, runs, 3) from plans followed to their end, whether there was a plan) at
    some steps."""
    controller = components.controllers(robust_design)["tube_mpc"]
    plant = components.linear_plant(robust_design)
    keys = realisation_keys(11, 0, BATCH)
    found = []
    for step in (0, 1, 40, 113, 114, 115, 116, 230):
        starts = jnp.asarray(stressed["tube_mpc"].errors[step, :BATCH])
        state = begin(controller, plant, keys, starts)
        plans = planned(planning.take_qp(controller.qps, controller.index[step]), starts)
        deviations = follow_plan(controller, plant, keys, state, jnp.asarray(step), plans)
        found.append((step, np.asarray(deviations), np.asarray(plans.status) == qp.SOLVED))
    return found


def test_deviations_from_a_plan_obey_the_tubes_recursion(robust_design, deviations):
    """Whatever the plan was, only disturbances move it: deviation+ = (A + B K) deviation + w."""
    plant = components.linear_plant(robust_design)
    keys = realisation_keys(11, 0, BATCH)
    windows = robust_design.windows
    draw = jax.jit(jax.vmap(plant.disturbance, (0, None)))
    for step, found, planned in deviations:
        assert planned.all()
        expected = np.zeros((BATCH, 3))
        for j, deviation in enumerate(found):
            loop = windows.loops[windows.index[step + j], 0]
            expected = expected @ loop.T + np.asarray(draw(keys, step + j))
            np.testing.assert_allclose(deviation, expected, atol=CLOSED_LOOP)


@pytest.mark.parametrize("tube", ["paper", "hull", "summed", "sequence"])
def test_deviations_from_a_plan_stay_inside_every_tube(robust_design, deviations, tube):
    problem = robust_design.problem
    windows = robust_design.windows
    reached = 0.0
    for step, found, _ in deviations:
        sections = robust_design.tubes[tube]
        if tube == "sequence":
            sections = sequence_tube(windows.loops[windows.index[step]], problem.disturbance_set)
        for section, deviation in zip(sections[1:], found, strict=True):
            assert section.polytope().margin(deviation).min() >= INSIDE_TUBE
        reached = max(
            reached, np.max(np.abs(found[1]).max(axis=0) / sections[2].support(np.eye(3)))
        )
    # The law says something only where deviations come close to the sets.
    assert reached > 0.9


def test_plan_deviations_of_a_run_leave_out_what_had_no_plan(robust_design, stressed, monkeypatch):
    monkeypatch.setattr(batches, "PLAN_DISTANCE", 100)
    controller = components.controllers(robust_design)["tube_mpc"]
    plant = components.linear_plant(robust_design)
    trajectory = stressed["tube_mpc"]
    outside = trajectory._replace(errors=trajectory.errors.copy())
    outside.errors[:, :100] = [5.0, 5.0, 0.0]
    found = batches.plan_deviations(robust_design, controller, plant, outside, seed=11)
    assert found.shape == (robust_design.problem.horizon, 3 * (BATCH - 100), 3) and np.all(
        np.isfinite(found)
    )


def test_plan_deviations_of_the_tube_along_the_reference_are_judged_where_its_sections_hold(
    uncertified, edge_starts
):
    design = uncertified("paper", *SEQUENCE)
    controller = components.controllers(design)["tube_mpc"]
    plant = components.linear_plant(design)
    trajectory = batches.run_realisations(controller, plant, edge_starts(design, BATCH), 12)
    found = batches.plan_deviations(design, controller, plant, trajectory, seed=12)
    assert found.shape[1] >= 10 * BATCH
    assert design.tube.margins(found).min() >= INSIDE_TUBE
