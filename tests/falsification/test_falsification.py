"""Laws of the search for violations: it reaches closed-form worst cases, and every margin it
reports is real."""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import model
from tolerances import FALSIFY_REPLAY, INSIDE_TUBE, ROUNDING

from jaxtube.falsification import setting as falsify_setting
from jaxtube.falsification.ascent import (
    CellAim,
    ascend,
    find_uncertainties,
    make_mean_attack,
    start_ascent,
)
from jaxtube.falsification.sample import sample
from jaxtube.falsification.search import search_worst_cases
from jaxtube.falsification.worst import confirm
from jaxtube.plant.slip_bounds import near_nominal
from jaxtube.simulation import components
from jaxtube.simulation.rollout import realisation_keys, rollout
from jaxtube.simulation.usage import JudgedLoop, compute_usages, make_limit, play, replay
from sets.polytope import Polytope

FALSIFY_CLOSED_FORM = 1e-9
"""Relative; worst cases of linear loops against sums of support numbers."""
FALSIFY_SLOPE = 1e-6
"""Relative; central differences with steps of 1e-5."""

DT, TRACK_WIDTH = 0.1, 0.5
SHORT = 40  # steps of the short laps
BATCH = 128
EXTREMES = 0.05
"""Relative: mean over facets and steps of the greatest of 1024 draws, against 1024 others."""


def shortened(plant, steps):
    """Return a plant whose reference ends early."""
    arrays = {"reference_wheels": plant.reference_wheels[:steps]}
    if hasattr(plant, "transitions"):
        return dataclasses.replace(plant, **arrays)
    return dataclasses.replace(plant, **arrays, reference_poses=plant.reference_poses[: steps + 1])


@pytest.fixture(scope="module")
def gain(paper_design):
    return components.controllers(paper_design)["local_gain"]


@pytest.fixture(scope="module")
def robot(paper_design):
    return shortened(components.slipping_robot(paper_design), SHORT)


@pytest.fixture(scope="module")
def error_limit(paper_design):
    E = paper_design.problem.error_set
    return {"error": make_limit(E.normals, E.offsets)}


@pytest.fixture(scope="module")
def start(paper_design):
    return paper_design.problem.initial_error[None]


@pytest.fixture(scope="module")
def searched(gain, robot, error_limit, start):
    """A search on the slipping robot from the scenario's start."""
    return search_worst_cases(JudgedLoop(gain, robot, error_limit), start, seconds=8, batch=BATCH)


# --------------------------------------------------------------------------- closed-form worst case


def closed_form(design, starts, steps):
    """Give the largest n e(k) / h of every facet of E: support numbers of start and disturbances,
    by plain products."""
    problem = design.problem
    E = problem.error_set
    W = problem.disturbance_set.vertices()
    gains = design.tube_gain.at(problem.model.weights(problem.schedule[:steps]))
    reach = []
    for end in range(1, steps + 1):
        rows = E.normals
        total = np.zeros(len(E.offsets))
        for step in reversed(range(end)):
            total = total + np.max(rows @ W.T, axis=1)
            A, B = model(problem, problem.schedule[step])
            rows = rows @ (A + B @ gains[step])
        reach.append((total + np.max(rows @ starts.T, axis=1)) / E.offsets)
    return np.array(reach)


@pytest.mark.parametrize("spread", [False, True], ids=["one start", "a polytope of starts"])
def test_on_the_linear_plant_every_closed_form_worst_case_is_reached(
    paper_design, gain, error_limit, start, spread
):
    starts = (
        np.array([[0.2, 0, 0], [-0.1, 0.1, 0.1], [-0.1, -0.2, 0.0], [0, 0, -0.2]])
        if spread
        else start
    )
    steps = 20
    plant = shortened(components.linear_plant(paper_design), steps)
    found = search_worst_cases(JudgedLoop(gain, plant, error_limit), starts, seconds=20, batch=120)
    expected = closed_form(paper_design, starts, steps)
    # 120 instances aim at 120 facets and steps, one each.
    np.testing.assert_allclose(found.reach["error"], expected, rtol=FALSIFY_CLOSED_FORM)
    worst = found.worst["error"]
    assert worst.usage == pytest.approx(expected.max(), rel=FALSIFY_CLOSED_FORM)
    assert expected[worst.step - 1, worst.facet] == pytest.approx(
        expected.max(), rel=FALSIFY_CLOSED_FORM
    )


def test_disturbances_in_a_general_polytope_are_searched_by_its_vertices(
    paper_design, gain, error_limit, start
):
    W = np.array([[0.01, 0, 0], [-0.002, 0.01, 0], [-0.002, -0.004, 0.02], [0, -0.003, -0.01]])
    plant = shortened(components.linear_plant(paper_design), 20)
    plant = dataclasses.replace(plant, disturbance_vertices=jnp.asarray(W))
    found = search_worst_cases(JudgedLoop(gain, plant, error_limit), start, seconds=20, batch=120)
    problem = dataclasses.replace(paper_design.problem, disturbance_set=Polytope.from_vertices(W))
    twin = dataclasses.replace(paper_design, problem=problem)
    np.testing.assert_allclose(
        found.reach["error"], closed_form(twin, start, 20), rtol=FALSIFY_CLOSED_FORM
    )


# --------------------------------------------------------------------------- what is reported holds


def world_frame_lap(design, attack, steps):
    """Drive robot and reference as unicycles in the world frame under given slip deviations; give
    the errors."""
    gains = design.tube_gain.at(design.problem.model.weights(design.problem.schedule[: steps + 1]))
    x, y, phi = -attack["start"][0]  # of a start without heading
    X = 0.0
    Y = 0.0
    PHI = 0.0
    errors = np.zeros((steps + 1, 3))

    def arc(x, y, phi, v, w):
        if w == 0:
            return x + DT * v * np.cos(phi), y + DT * v * np.sin(phi), phi
        turned = phi + DT * w
        return (
            x + v / w * (np.sin(turned) - np.sin(phi)),
            y - v / w * (np.cos(turned) - np.cos(phi)),
            turned,
        )

    for step in range(steps + 1):
        ahead = X - x
        aside = Y - y
        errors[step, 0] = np.cos(phi) * ahead + np.sin(phi) * aside
        errors[step, 1] = np.cos(phi) * aside - np.sin(phi) * ahead
        errors[step, 2] = PHI - phi
        right, left = design.problem.schedule[step]
        u1, u2 = gains[step] @ errors[step]
        wheels = (
            np.array([right - u1 - TRACK_WIDTH / 2 * u2, left - u1 + TRACK_WIDTH / 2 * u2]) / 0.8
        )
        ground = np.clip(wheels, -3, 3) * (
            1 - 0.2 * (1 + 0.1 * attack["true"][min(step, steps - 1)])
        )
        x, y, phi = arc(x, y, phi, ground.mean(), (ground[0] - ground[1]) / TRACK_WIDTH)
        X, Y, PHI = arc(X, Y, PHI, (right + left) / 2, (right - left) / TRACK_WIDTH)
    return errors


def test_the_reported_margin_is_that_of_a_world_frame_simulation(paper_design, searched):
    worst = searched.worst["error"]
    E = paper_design.problem.error_set
    assert np.all(np.abs(worst.attack["true"]) <= 1)
    errors = world_frame_lap(paper_design, worst.attack, SHORT)
    slack = E.offsets[worst.facet] - E.normals[worst.facet] @ errors[worst.step]
    assert worst.margin == pytest.approx(slack, abs=FALSIFY_REPLAY)
    assert worst.usage == pytest.approx(1 - worst.margin / E.offsets[worst.facet], abs=ROUNDING)
    # It is the worst of its own lap, and no worse lap was met on the way.
    assert np.max(errors[1:] @ E.normals.T / E.offsets) == pytest.approx(
        worst.usage, abs=FALSIFY_REPLAY
    )
    assert searched.reach["error"].max() == pytest.approx(worst.usage, abs=FALSIFY_REPLAY)


@pytest.mark.parametrize("process", ["iid", pytest.param("constant", marks=pytest.mark.slow)])
def test_everything_bounded_is_searched_and_stays_within_bounds(gain, robot, error_limit, process):
    noise = jnp.array([0.01, 0.02, 0.03])
    slips = near_nominal(np.array([0.2, 0.2]), 0.1, "both")
    plant = dataclasses.replace(robot, noise=noise, slips=slips, process=process)
    starts = np.array([[0.1, 0, 0], [0, 0.1, 0.1], [-0.1, -0.1, 0], [0, 0, -0.1]])
    found = search_worst_cases(JudgedLoop(gain, plant, error_limit), starts, seconds=2, batch=32)
    attack = found.worst["error"].attack
    times = {"iid": SHORT, "constant": 1}[process]
    shapes = {"start": (1, 3), "true": (times, 2), "measured": (times, 2), "noise": (SHORT + 1, 3)}
    assert {name: values.shape for name, values in attack.items()} == shapes
    assert all(np.all(np.abs(attack[name]) <= 1) for name in ("true", "measured", "noise"))
    assert Polytope.from_vertices(starts).contains(attack["start"][0], tolerance=ROUNDING)
    lap = replay(gain, plant, attack, "error").trajectory
    np.testing.assert_allclose(
        lap.measured - lap.errors, (attack["noise"] * noise)[:, None], atol=ROUNDING
    )
    # Each of them is worth something: the same lap without it is not as bad.
    worst = found.worst["error"]
    for name in shapes:
        tamed = attack | {name: 0.5 * attack[name]}
        milder = dataclasses.replace(worst, attack=tamed)
        less = confirm(gain, plant, error_limit["error"], milder)
        assert less.usage < worst.usage


def test_steps_of_the_search_never_leave_the_polytope_of_starts(gain, robot, error_limit):
    starts = np.random.default_rng(3).normal(size=(12, 3)) * [0.1, 0.1, 0.2]
    sets = find_uncertainties(robot, starts)
    vertices = {name: jnp.asarray(each.vertices) for name, each in sets.items()}
    ascent = start_ascent(make_mean_attack(sets, 6))
    loop = JudgedLoop(gain, robot, error_limit)
    hull = Polytope.from_vertices(starts)
    moved = 0.0
    for sweep in range(5):
        # Aims change: vertices are left again.
        cell = jnp.asarray(np.arange(6) + 6 * 7 * sweep, jnp.int32)
        aim = CellAim(cell, jnp.zeros(6, jnp.int32))
        ascent = ascend(loop, vertices, ascent, aim).ascent
        ascent = ascent._replace(length=jnp.full(6, 0.7))
        candidates = np.asarray(ascent.candidate["start"][0])
        assert hull.margin(candidates).min() >= INSIDE_TUBE
        assert max(np.abs(np.asarray(ascent.candidate["true"])).max(), 0) <= 1
        moved = max(moved, np.abs(candidates - starts.mean(axis=0)).max())
    assert moved > 0.05


# ----------------------------------------------------------------------------- as good as it can be


def test_the_gradient_finds_what_twenty_thousand_drawn_laps_do_not(
    gain, robot, error_limit, start, searched
):
    drawn = sample(JudgedLoop(gain, robot, error_limit), start, seconds=60, laps=20_000)
    assert drawn.laps >= 20_000
    # Every facet at every step, most of them by far.
    assert np.all(searched.reach["error"] >= drawn.reach["error"])
    assert np.median(searched.reach["error"][20:] / drawn.reach["error"][20:]) > 1.2


def test_drawn_laps_are_those_of_the_rollout(gain, robot, error_limit, start):
    """The extremes of many laps agree with laps drawn by the rollout, to the spread of extremes."""
    drawn = sample(JudgedLoop(gain, robot, error_limit), start, seconds=60, laps=1024).reach[
        "error"
    ]
    laps = rollout(
        gain, robot, realisation_keys(7, 0, 1024), jnp.asarray(np.tile(start, (1024, 1)))
    ).errors
    normals, offsets = error_limit["error"].normals[0], error_limit["error"].offsets[0]
    other = np.max(np.asarray(laps[1:]) @ np.asarray(normals).T / np.asarray(offsets), axis=1)
    assert np.mean(drawn[20:]) == pytest.approx(np.mean(other[20:]), rel=EXTREMES)


def test_the_gradient_agrees_with_every_sequence_of_vertices(gain, robot, error_limit, start):
    plant = shortened(robot, 3)
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=6))).reshape(-1, 3, 2)
    acting = plant.under_script({"true": jnp.asarray(np.moveaxis(corners, 0, 1))})
    errors = np.asarray(
        rollout(gain, acting, None, jnp.asarray(np.tile(start, (len(corners), 1)))).errors
    )
    normals, offsets = (np.asarray(array[0]) for array in error_limit["error"][:2])
    exhaustive = np.max(errors[1:] @ normals.T / offsets, axis=1)
    found = search_worst_cases(JudgedLoop(gain, plant, error_limit), start, seconds=10, batch=18)
    # Inside the box nothing is much worse than at its corners; the search may find that little
    # more.
    assert np.all(found.reach["error"] >= exhaustive - FALSIFY_REPLAY)
    np.testing.assert_allclose(found.reach["error"], exhaustive, rtol=1e-3)


def test_the_gradient_of_the_usage_is_that_of_finite_differences(gain, robot, error_limit, start):
    def usage(attack):
        seen = play(gain, robot, None, attack["start"][0], {"true": attack["true"]})
        return jnp.sum(compute_usages(error_limit, seen)["error"][24, 1])

    generator = np.random.default_rng(5)
    attack = {
        "start": jnp.asarray(start[None]),
        "true": jnp.asarray(generator.uniform(-0.9, 0.9, (SHORT, 1, 2))),
    }
    along = {
        name: jnp.asarray(generator.normal(size=values.shape)) for name, values in attack.items()
    }
    slope = sum(jnp.sum(g * along[name]) for name, g in jax.jit(jax.grad(usage))(attack).items())
    moved = [
        {name: values + h * along[name] for name, values in attack.items()} for h in (1e-5, -1e-5)
    ]
    difference = (usage(moved[0]) - usage(moved[1])) / 2e-5
    assert abs(slope) > 1e-3
    assert float(slope) == pytest.approx(float(difference), rel=FALSIFY_SLOPE)


# ------------------------------------------------------------------------ tube-MPC with active rows


@pytest.mark.slow
def test_no_attack_within_the_assumptions_breaks_the_guarantee(robust_design):
    """Linear model, w in W, starts over the feasible set: E and U hold, and plans stay in their
    tube."""
    plant = shortened(components.linear_plant(robust_design), 30)
    controller = components.controllers(robust_design)["tube_mpc"]
    starts = falsify_setting.find_feasible_vertices(robust_design, 0)
    limits = falsify_setting.make_lap_limits(robust_design)
    del limits["wheels"]
    found = search_worst_cases(JudgedLoop(controller, plant, limits), starts, seconds=20)
    # Rows are active: the search works at the edge of what is allowed.
    assert all(0.9 < worst.usage <= 1 + 1e-8 for worst in found.worst.values())
    tube = {"tube": falsify_setting.make_tube_limits(robust_design)}
    followed = search_worst_cases(JudgedLoop(controller, plant, tube), starts, seconds=20)
    # Along any facet the first section is reached exactly; a replay by the function that follows
    # plans confirms it.
    assert followed.worst["tube"].usage == pytest.approx(1, abs=FALSIFY_CLOSED_FORM)
    assert followed.reach["tube"].max() == pytest.approx(1, abs=FALSIFY_CLOSED_FORM)


@pytest.mark.slow
def test_a_counterexample_with_active_rows_is_confirmed_by_its_replay(robust_design):
    plant = shortened(components.slipping_robot(robust_design), 30)
    controller = components.controllers(robust_design)["tube_mpc"]
    limits = {"error": falsify_setting.make_lap_limits(robust_design)["error"]}
    starts = falsify_setting.find_feasible_vertices(robust_design, 0)
    found = search_worst_cases(JudgedLoop(controller, plant, limits), starts, seconds=20)
    worst = found.worst["error"]
    assert worst.usage > 1
    assert found.reach["error"].max() == pytest.approx(worst.usage, rel=1e-6)


# ------------------------------------------------------------------------------------------ refused


def test_what_cannot_be_searched_is_refused(paper_design, gain, robot, error_limit, start):
    walking = dataclasses.replace(robot, process="walk")
    with pytest.raises(ValueError, match=r'slip.process = "walk".*"iid"'):
        search_worst_cases(JudgedLoop(gain, walking, error_limit), start)
    with pytest.raises(ValueError, match="limits"):
        both = error_limit | {"tube": error_limit["error"]}
        search_worst_cases(JudgedLoop(gain, robot, both), start)
    with pytest.raises(ValueError, match="wheels"):
        linear = components.linear_plant(paper_design)
        wheels = {"wheels": error_limit["error"]}
        search_worst_cases(JudgedLoop(gain, linear, wheels), start)
    with pytest.raises(ValueError, match="centre"):
        make_limit(np.eye(2), np.ones(2), [2.0, 0.0])
