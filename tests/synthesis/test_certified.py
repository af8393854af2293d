"""Designs certified for the slipping robot itself: W computed, caps, coupling, tracking gains,
optimiser."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import linprog
from tolerances import CERTIFICATE_MARGIN, CLOSED_LOOP, LINEAR_PROGRAM, ROUNDING

from jaxtube.scenario import ScenarioError, load
from jaxtube.synthesis.certificate import robot
from jaxtube.synthesis.certificate.certify import certify
from jaxtube.synthesis.certificate.fill import cap_shares, ultimate_bound, widest_tube
from jaxtube.synthesis.design import design, refuse_infeasible_start
from jaxtube.synthesis.disturbance import (
    complete_problem,
    ground_speed_limits,
    kinematics,
    operation,
    prove_bound,
)
from jaxtube.synthesis.estimate import Estimate
from jaxtube.synthesis.feasible import boundary, shortfall, true_starts
from jaxtube.synthesis.gains import decoupled_gain
from jaxtube.synthesis.optimise import optimise
from jaxtube.synthesis.problem import make_problem
from jaxtube.synthesis.starts import caps_and_gains
from jaxtube.synthesis.terminal import admissible_set
from sets.invariant import maximal_rpi, minimal_rpi_bound
from sets.robot.disturbance import evaluate_disturbance

# The reference design: its caps, gains, and the W, supports and volume that came with it.
REFERENCE = [
    *("operating.longitudinal_m=0.12", "operating.lateral_m=0.28", "operating.heading_deg=18.0"),
    *("operating.speed_deficit_min_mps=-0.27", "operating.speed_deficit_max_mps=0.40"),
    *("operating.yaw_rate_deficit_radps=0.9", "controller.tracking_gains=[3.0, 6.5, 6.5]"),
    *("operating.turning_longitudinal_m=1e3", "operating.turning_yaw_rate_radps=1e3"),
]
YAW = 0.0208
BOX = np.array([8.90e-3, 19.26e-3, np.deg2rad(0.04)])
SUPPORTS = np.array([29.7e-3, 191.4e-3, np.deg2rad(12.3)])
VOLUME = 0.0250


@pytest.fixture(scope="module")
def certified():
    return design(load("certified"))


@pytest.fixture(scope="module")
def reference():
    return complete_problem(load("certified", REFERENCE))


@pytest.mark.parametrize(
    "name, ratio",
    [
        ("certified", 0.60),
        ("certified_lag", 0.80),
        pytest.param("certified_20", 1.0, marks=pytest.mark.slow),
        pytest.param("certified_30", 1.0, marks=pytest.mark.slow),
    ],
)
def test_the_scenarios_are_certified_and_the_papers_start_has_a_plan(name, ratio):
    found = design(load(name))
    assert found.certificate.failing == []
    assert {"disturbance_bound_proved", "wheel_limits", "true_error_in_e"} <= set(
        found.certificate.conditions
    )
    assert max(cap_shares(found.problem, found.terminal.gains).values()) < ratio
    assert len(found.certificate.assumptions) == 6
    refuse_infeasible_start(found)


def test_w_of_the_reference_design_lies_in_the_one_that_came_with_it(reference):
    bound = reference.disturbance_bound
    assert bound is not None
    assert bound.yaw <= 1.01 * YAW
    assert np.all(bound.box <= 1.01 * BOX)


def test_with_its_own_w_the_reference_design_has_its_supports_and_its_terminal_set(reference):
    bound = dataclasses.replace(reference.disturbance_bound, yaw=YAW, box=BOX)
    problem = dataclasses.replace(
        reference, disturbance_bound=bound, disturbance_set=bound.polytope()
    )
    gain = decoupled_gain(problem, (3.0, 6.5, 6.5))
    loops = gain.loops
    caps = admissible_set(problem, gain)
    angles = np.linspace(0, 2 * np.pi, 120, endpoint=False)
    ring = np.stack([np.zeros(120), np.cos(angles) / 0.28, np.sin(angles) / 0.3], axis=1)
    minimal = minimal_rpi_bound(
        loops, bound.support, np.concatenate([caps.normals / caps.offsets[:, None], ring])
    )
    np.testing.assert_allclose(minimal.support(np.eye(3)), SUPPORTS, rtol=0.01)
    omega = maximal_rpi(loops, caps, bound.support).polytope
    assert omega.volume() == pytest.approx(VOLUME, rel=0.01)


def test_disturbances_of_the_coupled_operation_lie_in_w(certified):
    problem = certified.problem
    random = np.random.default_rng(1)
    count = 200_000
    where = operation(problem)
    bound = problem.disturbance_bound
    low, high = where.box
    points = random.uniform(low, high, (count, 13))
    extreme = random.random((count, 13)) < 0.5
    points = np.where(extreme, np.where(random.random((count, 13)) < 0.5, low, high), points)
    a, b = where.coupling
    room = a * (1 - np.abs(points[:, 4]) / b)
    kept = room > 0
    points[:, 0] = np.clip(points[:, 0], -room, room)  # many of them on the coupling's edge
    noise = random.choice([-1, 1], (count, 3)) * where.noise
    w, _, speeds = evaluate_disturbance(where, kinematics(problem), points[kept], noise[kept])
    assert problem.disturbance_set.margin(w).min() >= -ROUNDING
    assert np.all(speeds >= bound.ground_speeds[0]) and np.all(speeds <= bound.ground_speeds[1])
    reached = np.abs(w).max(axis=0) / bound.support(np.eye(3))
    assert np.all(reached >= 0.85)


def test_pieces_of_the_coupling_cover_the_operation_and_no_more(certified):
    where = operation(certified.problem)
    lower, upper = where.pieces()
    a, b = where.coupling
    turns = where.inputs[1, 1]
    half = where.errors[1, 0]
    for turn in np.linspace(-turns, turns, 41):
        at = (lower[4] <= turn + ROUNDING) & (turn <= upper[4] + ROUNDING)
        assert at.any()
        reach = lower[13, at] + lower[14, at] * turn
        np.testing.assert_allclose(reach, min(half, a * (1 - abs(turn) / b)), atol=ROUNDING)


def test_every_loop_of_the_box_is_a_mixture_of_the_vertex_loops(certified):
    problem = certified.problem
    gain = certified.tube_gain
    loops, gains = gain.pairs
    vertices = np.concatenate(
        [loops.reshape(len(loops), -1), gains.reshape(len(loops), -1)], axis=1
    )
    schedules = np.random.default_rng(2).uniform(*problem.regions[0], (60, 2))
    A, B = problem.model.matrices(schedules)
    K = gain.at(problem.model.weights(schedules))
    for one, law in zip(A + B @ K, K, strict=True):
        for points, wanted in (
            (loops.reshape(len(loops), -1), one),
            (vertices, np.append(one, law)),
        ):
            rows = np.vstack([points.T, np.ones(len(points))])
            answer = linprog(
                np.zeros(len(points)), A_eq=rows, b_eq=np.append(wanted, 1.0), bounds=(0, None)
            )
            assert answer.status == 0


def test_tracking_gains_decouple_the_longitudinal_error(certified):
    k1, _, _ = certified.problem.scenario.controller.tracking_gains
    loops = certified.tube_gain.loops
    np.testing.assert_allclose(
        loops[:, 0], np.tile([1 - 0.1 * k1, 0, 0], (len(loops), 1)), atol=ROUNDING
    )


def test_what_the_controller_keeps_and_the_noise_fill_the_promise(certified):
    problem = certified.problem
    noise = np.array([1e-3, 1e-3, np.deg2rad(0.02)])
    promised = problem.operating_set.support(np.eye(3)) + noise
    np.testing.assert_allclose(problem.error_set.support(np.eye(3)), promised, atol=ROUNDING)
    np.testing.assert_allclose(promised, [0.151, 0.2426, np.deg2rad(16.52)], atol=ROUNDING)


def test_noise_without_caps_takes_its_share_of_the_constraints():
    noisy = make_problem(load("paper", ["noise.lateral_m=0.05"]))
    np.testing.assert_allclose(
        noisy.error_set.support(np.eye(3)), [0.3, 0.3, np.deg2rad(20)], atol=ROUNDING
    )
    np.testing.assert_allclose(
        noisy.operating_set.support(np.eye(3)), [0.3, 0.25, np.deg2rad(20)], atol=ROUNDING
    )


def test_true_starts_have_a_plan_whatever_the_noise(certified):
    window = certified.tube_qps
    index = int(certified.windows.index[0])
    problem = certified.problem
    noise = problem.error_set.offsets[:3] - problem.operating_set.offsets[:3]
    corners = noise * np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
    for start in true_starts(window, index, problem)[::50]:
        assert max(shortfall(window, index, start + corner) for corner in corners) <= LINEAR_PROGRAM
    edge = boundary(window, index, problem.operating_set, 60)
    assert max(shortfall(window, index, 1.01 * point) for point in edge) > 0


@pytest.mark.parametrize(
    "change, condition",
    [
        (
            lambda bound: dataclasses.replace(bound, yaw=1.01 * bound.yaw),
            "disturbance_bound_proved",
        ),
        (
            lambda bound: dataclasses.replace(bound, box=bound.box * 1.01),
            "disturbance_bound_proved",
        ),
        (
            lambda bound: dataclasses.replace(bound, ground_speeds=1.01 * bound.ground_speeds),
            "wheel_limits",
        ),
    ],
)
def test_a_wider_bound_than_the_sets_were_made_for_fails(certified, change, condition, monkeypatch):
    bound = change(prove_bound(certified.problem))
    monkeypatch.setattr(robot, "prove_bound", lambda problem: bound)
    assert certify(certified).failing == [condition]


def test_a_wider_w_than_the_sets_were_made_for_fails_in_any_order_too(certified):
    wide = dataclasses.replace(
        certified.problem, disturbance_set=certified.problem.disturbance_set.scale(1.5)
    )
    invariant = certified.terminal.invariant.scale(0.5)
    terminal = dataclasses.replace(certified.terminal, invariant=invariant)
    tampered = dataclasses.replace(certified, problem=wide, terminal=terminal)
    certificate = certify(tampered)
    assert "any_order_of_wheel_speeds" in certificate.failing
    assert any("in the order of this path alone" in line for line in certificate.assumptions)


def test_wheels_that_may_not_turn_slowly_bind_under_the_least_slip():
    slow = complete_problem(load("certified"))
    least = float(slow.disturbance_bound.ground_speeds[0].min())
    bound = least / (
        1 - 0.2 * 0.9
    )  # a ground speed of `least` asks this of a wheel whose measured slip is least
    for factor, holds in ((1 - 1e-6, True), (1 + 1e-6, False)):
        problem = make_problem(load("certified", [f"robot.wheel_speed_min_mps={factor * bound!r}"]))
        assert (least >= ground_speed_limits(problem)[0].max()) == holds


def test_the_nested_bound_is_that_of_the_reference():
    path = complete_problem(load("certified", [*REFERENCE, "reference.certified_for=path"]))
    gain = decoupled_gain(path, (3.0, 6.5, 6.5))
    widths = ultimate_bound(path, gain)
    np.testing.assert_allclose(widths, [20.6e-3, 56.4e-3, np.deg2rad(4.2)], rtol=0.06)
    # With W of the first set alone, nothing nested, the tube is three times as wide.
    assert widest_tube(path, gain).support(np.eye(3))[1] > 2 * widths[1]
    capped = complete_problem(load("certified", ["operating.yaw_rate_deficit_radps=0.4"]))
    with pytest.raises(ValueError, match="outgrows a cap"):
        ultimate_bound(capped, decoupled_gain(capped, capped.scenario.controller.tracking_gains))


def test_a_promise_beyond_the_constraints_fails(certified):
    tight = load("certified", ["constraints.lateral_m=0.2427"])
    problem = dataclasses.replace(
        certified.problem, scenario=load("certified", ["constraints.lateral_m=0.3"])
    )
    kept = dataclasses.replace(problem, scenario=tight)
    assert certify(dataclasses.replace(certified, problem=kept)).failing == []
    wide = dataclasses.replace(problem, error_set=problem.error_set.scale(1.3))
    tampered = dataclasses.replace(certified, problem=wide)
    assert certify(tampered).failing == ["true_error_in_e"]


@pytest.mark.slow
def test_the_optimiser_finds_caps_and_gains_that_hold(reference):
    found = optimise(complete_problem(load("certified", ["slip.relative_error=0.15"])))
    problem = complete_problem(found.scenario)
    gain = decoupled_gain(problem, found.scenario.controller.tracking_gains)
    assert max(cap_shares(problem, gain).values()) == pytest.approx(found.ratio, rel=0.02)
    assert found.ratio < max(
        cap_shares(reference, decoupled_gain(reference, (3.0, 6.5, 6.5))).values()
    )
    result = design(found.scenario)
    assert result.certificate.failing == []
    refuse_infeasible_start(result)


def test_estimated_shares_are_those_of_the_rigorous_sets(certified):
    estimate = Estimate(certified.problem)
    own = estimate.to_point(caps_and_gains(certified.problem.scenario))
    estimated = estimate.shares(own).caps[0]
    rigorous = list(cap_shares(certified.problem, certified.tube_gain).values())
    # The speed deficit's two caps are rows of their own.
    merged = [*estimated[:3], max(estimated[3:5]), *estimated[5:]]
    np.testing.assert_allclose(merged, rigorous[:6], rtol=0.03)
    own[8] = np.log(2.5)
    assert estimate.shares(own) is None  # k1 T > 2: unstable


def test_the_papers_sets_gains_and_map_are_not_certified_with_a_computed_w():
    wide = ["disturbance.bound=computed", "controller.tube=summed", "controller.terminal=T-B"]
    with pytest.raises(Exception, match="empty"):
        design(load("paper", wide))


@pytest.mark.parametrize(
    "override, words",
    [
        ("operating.lateral_m=0.2999", "operating.lateral_m"),
        ("noise.lateral_m=0.3", "leaves nothing of constraints.lateral_m"),
        ("controller.tracking_gains=[1.0, 2.0]", "are not three"),
        ("controller.tube=summed", "terminal T-A with tube sequence"),
    ],
)
def test_caps_and_gains_that_make_no_sense_are_refused_in_one_line(override, words):
    with pytest.raises(ScenarioError, match=words) as refused:
        load("certified", [override])
    assert "\n" not in str(refused.value)


def test_caps_come_in_groups():
    with pytest.raises(ScenarioError, match="all three input caps"):
        load("paper", ["operating.yaw_rate_deficit_radps=0.9"])
    with pytest.raises(ScenarioError, match="both or none"):
        load("paper", ["operating.turning_longitudinal_m=0.9"])


def test_cost_of_the_gains_decreases_along_every_pair(certified):
    problem = certified.problem
    P = certified.cost.cost
    for loop, gain in zip(*certified.tube_gain.pairs, strict=True):
        stage = problem.error_weight + gain.T @ problem.input_weight @ gain
        assert np.linalg.eigvalsh(P - loop.T @ P @ loop - stage)[0] >= -CERTIFICATE_MARGIN
    assert np.all(np.abs(P - P.T) <= CLOSED_LOOP)


def test_the_share_of_a_refused_start_leaves_room_for_the_noise(certified):
    error = np.array([0.14, 0.2, 0.25])
    with pytest.raises(ScenarioError, match=r"at most \d+% as far") as refusal:
        refuse_infeasible_start(certified, error)
    share = int(str(refusal.value).split("at most ")[1].split("%")[0]) / 100
    refuse_infeasible_start(certified, share * error)
    with pytest.raises(ScenarioError):
        refuse_infeasible_start(certified, (share + 0.011) * error)


def test_a_start_within_the_caps_and_the_feasible_set_of_the_tube_alone_is_not_enough(certified):
    """Plans exist beyond the cap of the heading error, where W is not proved."""
    cap = certified.problem.operating_set.offsets[2]
    beyond = np.array([0.0, 0.0, 1.1 * cap])
    assert shortfall(certified.tube_qps, certified.first_window, beyond) <= 0
    with pytest.raises(ScenarioError, match="times as far as it may"):
        refuse_infeasible_start(certified, beyond)


def test_a_design_is_told_in_a_few_lines_with_its_verdict_first(certified):
    text = repr(certified)
    assert text.startswith("CERTIFIED: every required condition holds\n")
    assert len(text.splitlines()) <= 5
    assert len(text) < 500


def test_without_noise_along_the_path_nothing_is_negative():
    problem = complete_problem(load("certified", ["noise.longitudinal_m=0"]))
    np.testing.assert_array_equal(operation(problem).noise[0], 0.0)


def test_a_flat_w_is_refused_in_one_line():
    exact = ["slip.relative_error=0", "noise.longitudinal_m=0", "noise.lateral_m=0"]
    with pytest.raises(ScenarioError, match="W is flat") as refused:
        complete_problem(load("certified", [*exact, "noise.heading_deg=0"]))
    assert "\n" not in str(refused.value)
