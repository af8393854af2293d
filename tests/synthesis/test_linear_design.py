"""Laws of the design of linear systems of any size, against oracles that share no code with it:
products of loops, vertices, closed forms, and programs written out."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from linear_systems import T, mixtures, random_system, stretch, varying_mass
from scipy.optimize import linprog

from jaxtube.scenario.refusal import ScenarioError
from jaxtube.synthesis.certificate.linear import certify_linear
from jaxtube.synthesis.linear_design import design_linear
from jaxtube.synthesis.linear_problem import make_linear_problem, mix_gains, pair_rows
from jaxtube.synthesis.tightening import EmptySetError
from sets.polytope import Polytope

SIZES = [(1, 1, 1), (2, 1, 2), (2, 2, 3), (3, 1, 1), (3, 2, 2), (4, 2, 1), (5, 3, 1)]
"""States, inputs and vertices."""


@pytest.mark.parametrize("tube", ["sequence", "summed"])
@pytest.mark.parametrize("size", SIZES)
def test_systems_of_any_size_are_designed_and_certified(size, tube):
    design = design_linear(random_system(1, *size, tube=tube))
    certificate = design.certificate
    assert certificate.holds_for_model, certificate.reasons
    assert "disturbance_set_proved" not in certificate.conditions
    assert certificate.verdict.startswith("CERTIFIED for the linear system with w in W")


@pytest.mark.parametrize("size", [(1, 1, 1), (2, 1, 2), (3, 2, 2), (5, 3, 1)])
def test_tubes_hold_sums_of_disturbances_and_no_more(size):
    design = design_linear(random_system(2, *size))
    system = design.system
    K = design.tube_gain.vertices
    rows = np.random.default_rng(0).normal(size=(5, system.states))
    corners = np.array(list(itertools.product((-1, 1), repeat=system.states)))
    W = corners * system.disturbance_set.support(np.eye(system.states))
    for window, schedule in enumerate(design.windows.schedules):
        loops = [
            sum(w * A for w, A in zip(th, system.A, strict=True))
            + sum(w * B for w, B in zip(th, system.B, strict=True))
            @ sum(w * k for w, k in zip(th, K, strict=True))
            for th in schedule
        ]
        reach = np.zeros(len(rows))
        for stage in range(1, system.horizon + 1):
            # A disturbance of j stages ago went through the last j loops of this stage.
            transport = np.eye(system.states)
            reach = np.zeros(len(rows))
            for loop in [*reversed(loops[1:stage]), None]:
                reach += np.max(rows @ transport @ W.T, axis=1)
                transport = transport if loop is None else transport @ loop
            found = design.tubes["sequence"].support(stage, rows)[window]
            np.testing.assert_allclose(found, reach, rtol=1e-10)


def test_a_tube_for_every_order_holds_all_products_of_vertex_loops():
    design = design_linear(random_system(3, 2, 1, 2, tube="summed"))
    loops = design.tube_gain.loops
    W = design.system.disturbance_set.vertices()
    rows = np.random.default_rng(0).normal(size=(6, 2))
    expected = np.zeros(len(rows))
    for stage in range(1, design.system.horizon + 1):
        products = [np.eye(2)]
        for _ in range(stage - 1):
            products = [product @ loop for product in products for loop in loops]
        expected += np.max([np.max(rows @ product @ W.T, axis=1) for product in products], axis=0)
        np.testing.assert_allclose(design.tube.support(stage, rows)[0], expected, rtol=1e-10)


@pytest.mark.parametrize("size", SIZES)
def test_terminal_sets_are_invariant_vertex_by_vertex_and_keep_the_limits(size):
    design = design_linear(random_system(1, *size))
    system = design.system
    omega = design.terminal.invariant
    assert omega is not None
    corners = omega.vertices()
    signs = np.array(list(itertools.product((-1, 1), repeat=system.states)))
    W = signs * system.disturbance_set.support(np.eye(system.states))
    assert np.max(np.abs(corners)) <= 1
    for A, B, th in mixtures(system, count=5):
        gain = sum(w * K for w, K in zip(th, design.tube_gain.vertices, strict=True))
        assert np.max(np.abs(corners @ gain.T)) <= 2
        following = (corners @ (A + B @ gain).T)[:, None] + W
        excess = following.reshape(-1, system.states) @ omega.normals.T - omega.offsets
        assert np.max(excess) <= 1e-9


def test_the_invariant_set_of_a_double_integrator_is_its_closed_form():
    # Deadbeat gains end every plan in two periods, so that two conditions are all:
    # x in E and K x in U, and the same of Phi x + w for all w; Phi (Phi x + w) is Phi w.
    A = np.array([[1.0, T], [0.0, 1.0]])
    B = np.array([[T**2 / 2], [T]])
    K = np.array([[-1 / T**2, -1.5 / T]])
    w = np.array([0.002, 0.01])
    system = varying_mass(A=A, B=B, K=K, E=[0.2, 3.0], U=[20.0], W=w, schedule=None)
    phi = A + B @ K
    np.testing.assert_allclose(phi @ phi, 0, atol=1e-12)
    limits = np.concatenate([np.eye(2) / [[0.2], [3.0]], K / 20])
    rows = np.concatenate([limits, limits @ phi])
    offsets = np.concatenate([np.ones(3), 1 - np.abs(limits) @ w])
    assert np.all(np.abs(limits @ phi) @ w + np.abs(limits) @ w < 1)
    closed = Polytope(np.concatenate([rows, -rows]), np.tile(offsets, 2))
    maximal = design_linear(system).terminal.maximal.polytope
    assert maximal is not None
    directions = np.random.default_rng(0).normal(size=(50, 2))
    found = maximal.support(directions)
    exact = closed.support(directions)
    assert np.all(found <= exact)
    np.testing.assert_allclose(found, exact, rtol=2e-4)


@pytest.mark.parametrize("size", [(1, 1, 1), (2, 1, 2), (3, 2, 2), (4, 3, 1)])
def test_the_rows_of_a_plan_are_those_of_a_program_written_out(size):
    design = design_linear(random_system(4, *size))
    system = design.system
    K = design.tube_gain.vertices
    qps = design.tube_qps
    random = np.random.default_rng(0)
    window = len(design.windows.schedules) - 1
    schedule = design.windows.schedules[window]
    for _ in range(20):
        x = random.uniform(-1, 1, system.states)
        plan = random.uniform(-2, 2, (system.horizon, system.inputs))
        feasible = _is_feasible(design, K, schedule, x, plan)
        on_plan = qps.factors.rows[window] * qps.factors.row_norms[window][:, None]
        values = qps.row_errors[window] @ x + on_plan @ plan.ravel()
        checks = qps.check_errors[window] @ x
        slack = 1e-6  # the back-off of the rows
        kept = (
            np.all(values <= qps.upper[window] + slack)
            and np.all(values >= qps.lower[window] - slack)
            and np.all(checks <= qps.check_upper[window] + slack)
            and np.all(checks >= qps.check_lower[window] - slack)
        )
        assert kept == feasible


def _is_feasible(design, K, schedule, x, plan):
    """Whether a plan keeps E and U less the reach of its tube, and ends in the terminal set less
    it; simulated period by period."""
    system = design.system
    signs = np.array(list(itertools.product((-1, 1), repeat=system.states)))
    points = [np.zeros((1, system.states))]
    W = signs * system.disturbance_set.support(np.eye(system.states))
    omega = design.terminal.invariant
    state = x
    for stage, (th, u) in enumerate(zip(schedule, plan, strict=True)):
        gain = sum(w * k for w, k in zip(th, K, strict=True))
        A = sum(w * a for w, a in zip(th, system.A, strict=True))
        B = sum(w * b for w, b in zip(th, system.B, strict=True))
        if stage > 0 and np.any(np.abs(state) > 1 - _reach(points, np.eye(system.states))):
            return False
        if np.any(np.abs(u) > 2 - _reach(points, gain)):
            return False
        state = A @ state + B @ u
        loop = A + B @ gain
        points = [W] if stage == 0 else [*(cloud @ loop.T for cloud in points), W]
    return bool(np.all(omega.normals @ state <= omega.offsets - _reach(points, omega.normals)))


def _reach(points, rows):
    """Return the support numbers of a sum of hulls."""
    return sum(np.max(rows @ cloud.T, axis=1) for cloud in points)


def test_loops_of_mixed_gains_are_mixtures_of_the_pairs():
    system = random_system(5, 3, 2, 3)
    gains = np.random.default_rng(0).normal(size=(3, 2, 3))
    gain = mix_gains(make_linear_problem(system), gains)
    loops, of_pairs = gain.pairs
    assert len(loops) == 6  # three vertices, three pairs of them
    joint = np.concatenate([loops.reshape(6, -1), of_pairs.reshape(6, -1)], axis=1)
    for A, B, th in mixtures(system, count=20):
        K = sum(w * k for w, k in zip(th, gains, strict=True))
        wanted = np.concatenate([(A + B @ K).ravel(), K.ravel()])
        found = linprog(
            np.zeros(6),
            A_eq=np.concatenate([joint.T, np.ones((1, 6))]),
            b_eq=np.append(wanted, 1),
        )
        assert found.status == 0


def test_one_gain_serves_all_vertices_where_the_input_matrix_varies():
    design = design_linear(varying_mass())
    assert len(np.unique(design.tube_gain.vertices, axis=0)) == 1
    assert design.certificate.holds_for_model
    P = design.cost.cost
    K = design.tube_gain.vertices[0]
    for A, B, _ in mixtures(design.system):
        loop = A + B @ K
        stage = design.system.Q + K.T @ design.system.R @ K
        assert np.min(np.linalg.eigvalsh(P - loop.T @ P @ loop - stage)) >= -1e-9


@pytest.mark.parametrize("factors", [(0.1, 1.0, 1.0), (3.0, 0.3, 5.0), (10.0, 10.0, 10.0)])
def test_units_change_no_verdict_and_no_set(factors):
    system = varying_mass(K=np.array([[-4.0, -3.0]]))
    states = np.array(factors[:2])
    inputs = np.array(factors[2:])
    design = design_linear(system)
    scaled = design_linear(stretch(system, states, inputs))
    assert design.certificate.holds_for_model
    assert scaled.certificate.holds_for_model
    widths = design.tube.half_widths()
    np.testing.assert_allclose(scaled.tube.half_widths(), widths * states, rtol=1e-9)
    directions = np.random.default_rng(0).normal(size=(20, 2))
    maximal = design.terminal.maximal.polytope.support(directions * states)
    found = scaled.terminal.maximal.polytope.support(directions)
    np.testing.assert_allclose(found, maximal, rtol=1e-4)  # the back-off has no unit


def test_units_far_apart_change_no_verdict():
    system = varying_mass(K=np.array([[-4.0, -3.0]]))
    apart = design_linear(stretch(system, np.array([100.0, 1.0]), np.array([0.01])))
    assert apart.certificate.failing == []


def test_rows_come_in_pairs_that_leave_the_set_as_it_is():
    triangle = Polytope(np.array([[1.0, 1.0], [-2.0, 0.5], [0.0, -1.0]]), np.array([1.0, 1.0, 0.5]))
    paired = pair_rows(triangle)
    half = len(paired.offsets) // 2
    np.testing.assert_allclose(paired.normals[:half], -paired.normals[half:])
    directions = np.random.default_rng(0).normal(size=(40, 2))
    np.testing.assert_allclose(paired.support(directions), triangle.support(directions))


def test_limits_that_are_no_boxes_are_kept_and_named():
    E = Polytope(np.array([[1.0, 1.0], [-1.0, 0.0], [0.0, -1.0]]), np.array([0.8, 0.6, 0.7]))
    design = design_linear(varying_mass(E=E))
    assert design.certificate.holds_for_model
    assert "+0.707 x1 +0.707 x2" in design.problem.error_names


def test_a_broken_design_is_not_certified():
    design = design_linear(varying_mass())
    doubled = replace(design.problem, disturbance_set=design.problem.disturbance_set.scale(2.0))
    certificate = certify_linear(replace(design, problem=doubled))
    assert not certificate.holds_for_model
    assert "tightening_covers_reach" in certificate.failing
    assert "terminal_set_invariant" in certificate.failing


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"B": np.zeros((2, 2, 1))}, ("system: B", "no gain stabilises", "actuator")),
        ({"K": np.array([[4.0, 3.0]])}, ("system: K", "spectral radius", "leave K out")),
    ],
)
def test_a_system_without_a_stable_loop_is_refused_in_one_line(changes, words):
    with pytest.raises(ScenarioError) as refused:
        design_linear(varying_mass(**changes))
    message = str(refused.value)
    assert "\n" not in message
    for word in words:
        assert word in message


def test_a_tube_that_is_too_wide_is_refused_by_the_name_of_its_row():
    with pytest.raises(EmptySetError, match=r"place .* shrink W"):
        design_linear(varying_mass(W=[0.4, 0.01], state_names=("place", "speed")))


def test_a_terminal_set_that_does_not_exist_is_said_and_not_certified():
    design = design_linear(varying_mass(W=[0.002, 0.09], U=[1.0]))
    assert "terminal_set_invariant" in design.certificate.failing
    assert "No invariant terminal set exists" in design.certificate.table().replace("\n", " ")
