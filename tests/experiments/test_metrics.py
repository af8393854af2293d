"""Laws of the numbers that are reported: they are plain statistics of what was simulated."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from oracles import TIGHT, model
from tolerances import CLOSED_LOOP, PAPER_GAIN, ROUNDING

from jaxtube import qp
from jaxtube.control.mpc import Diagnostics
from jaxtube.coordinates import KEYS
from jaxtube.experiments.paper import stress
from jaxtube.experiments.run import metrics
from jaxtube.simulation import batches
from jaxtube.simulation.rollout import Trajectory
from sets.certificate import Certificate, Condition
from sets.tubes import sequence_tube

STEPS = 300
RUNS = 12
LIMITS = np.array([0.3, 0.3, np.deg2rad(20)])
DEGREES = np.array([1, 1, 180 / np.pi])


def made_up(seed=0):
    """Return a trajectory of random numbers inside E, in arrays that tests can break."""
    generator = np.random.default_rng(seed)
    errors = 0.9 * LIMITS * generator.uniform(-1, 1, (STEPS + 1, RUNS, 3))
    # Larger at the start than later, so that the transient matters.
    errors[100:] *= 0.5
    demanded = generator.uniform(0.5, 1.9, (STEPS, RUNS, 2))
    outcomes = [qp.SOLVED, qp.INFEASIBLE, qp.UNSOLVED]
    status = generator.choice(outcomes, p=[0.9, 0.06, 0.04], size=(STEPS, RUNS))
    diagnostics = Diagnostics(
        status=status,
        residual=generator.uniform(0, 1e-8, status.shape),
        active=generator.random(status.shape) < 0.2,
        backup=status != qp.SOLVED,
    )
    return Trajectory(
        errors=errors,
        measured=errors.copy(),
        inputs=generator.normal(size=(STEPS, RUNS, 2)),
        wheels=np.minimum(demanded, 1.8),
        demanded=demanded,
        diagnostics=diagnostics,
    )


def numbers(values):
    return [values[name] for name in KEYS]


# -------------------------------------------------------------------------------------- controllers


def test_violations_count_every_run_that_is_not_inside_and_nan_is_not(paper_design):
    trajectory = made_up()
    assert metrics.controller_metrics(paper_design, trajectory)["violating_realisations"] == 0
    trajectory.errors[7, 0, 0] = 0.3 + 1e-9
    trajectory.errors[300, 1, 1] = -0.31
    trajectory.errors[0, 2, 2] = -np.deg2rad(20.001)
    trajectory.errors[5, 3, 1] = np.nan
    trajectory.errors[5:9, 4] = np.inf
    trajectory.errors[5, 5, 1] = 0.3
    found = metrics.controller_metrics(paper_design, trajectory)
    assert found["realisations"] == RUNS
    assert found["violating_realisations"] == 5
    assert found["violation_share"] == pytest.approx(5 / RUNS)
    np.testing.assert_allclose(
        numbers(found["violation_share_by_coordinate"]), np.array([2, 3, 2]) / RUNS
    )


@pytest.mark.parametrize(("span", "first"), [("whole_run", 0), ("after_10_s", 100)])
def test_errors_are_summed_up_run_by_run(paper_design, span, first):
    trajectory = made_up()
    found = metrics.controller_metrics(paper_design, trajectory)
    largest = np.zeros((RUNS, 3))
    rms = np.zeros((RUNS, 3))
    for run in range(RUNS):
        later = trajectory.errors[first:, run] * DEGREES
        for i, column in enumerate(later.T):
            largest[run, i] = max(abs(value) for value in column)
            rms[run, i] = np.sqrt(sum(value**2 for value in column) / len(column))
    for key, values in (("max_error", largest), ("rms_error", rms)):
        ordered = np.sort(values, axis=0)
        median = (ordered[RUNS // 2 - 1] + ordered[RUNS // 2]) / 2
        # The 95 % quantile of 12 values lies 0.45 of the way from the eleventh to the twelfth.
        p95 = ordered[10] + 0.45 * (ordered[11] - ordered[10])
        for statistic, expected in (("median", median), ("p95", p95), ("worst", ordered[-1])):
            np.testing.assert_allclose(
                numbers(found[key][span][statistic]), expected, rtol=1e2 * ROUNDING
            )


def test_wheels_and_status_are_counted(paper_design):
    trajectory = made_up()
    trajectory.wheels[3, 4, 1] = -2.5
    found = metrics.controller_metrics(paper_design, trajectory)
    assert found["wheel_speed_max_mps"] == 2.5
    mean = trajectory.wheels.sum() / (STEPS * RUNS * 2)
    assert found["wheel_speed_mean_mps"] == pytest.approx(mean)
    clipped = (trajectory.demanded > 1.8).any(axis=2)
    clipped[3, 4] = True
    assert found["saturated_share"] == pytest.approx(clipped.mean())
    status = trajectory.diagnostics.status.ravel().tolist()
    assert found["qp_status"] == {
        "solved": status.count(qp.SOLVED),
        "infeasible": status.count(qp.INFEASIBLE),
        "unsolved": status.count(qp.UNSOLVED),
    }
    assert sum(found["qp_status"].values()) == STEPS * RUNS
    active = trajectory.diagnostics.active.sum() / (STEPS * RUNS)
    assert found["active_share"] == pytest.approx(active)
    assert found["backup_share"] == pytest.approx(1 - status.count(0) / len(status))
    assert found["qp_residual_max"] == trajectory.diagnostics.residual.max()


def test_a_run_shorter_than_the_transient_is_judged_by_where_it_ends(paper_design):
    whole = made_up()
    diagnostics = Diagnostics(*(array[:30] for array in whole.diagnostics))
    short = Trajectory(*(array[:31] for array in whole[:5]), diagnostics)
    found = metrics.controller_metrics(paper_design, short)
    expected = np.abs(short.errors[-1] * DEGREES).max(axis=0)
    np.testing.assert_allclose(numbers(found["max_error"]["after_10_s"]["worst"]), expected)


# ------------------------------------------------------------------------------------- disturbances


def test_residuals_are_what_the_model_does_not_predict(paper_design):
    trajectory = made_up()
    problem = paper_design.problem
    disturbances = batches.model_disturbances(paper_design, trajectory)
    for step in (0, 57, 114, 299):
        A, B = model(problem, problem.schedule[step])
        for run in (0, 7):
            expected = trajectory.measured[step + 1, run] - A @ trajectory.measured[step, run]
            expected = expected - B @ trajectory.inputs[step, run]
            np.testing.assert_allclose(disturbances[step, run], expected, atol=CLOSED_LOOP)


def test_disturbances_outside_W_are_counted_step_by_step(paper_design):
    widths = np.array([0.005, 0.005, np.deg2rad(0.2)])
    disturbances = widths * np.random.default_rng(1).uniform(-0.9, 0.9, (STEPS, RUNS, 3))
    inside = metrics.disturbance_metrics(paper_design, disturbances)
    assert inside["share_of_steps_outside"] == 0
    assert inside["runs_with_every_w_inside"] == RUNS
    assert inside["margin"] == pytest.approx(np.min(widths - np.abs(disturbances)))
    disturbances[3, 0] = widths * [1.5, 0.5, -3.0]
    disturbances[4, 0, 1] = -1.2 * widths[1]
    disturbances[4, 1, 2] = np.nan
    found = metrics.disturbance_metrics(paper_design, disturbances)
    steps = STEPS * RUNS
    assert found["steps"] == steps
    assert found["share_of_steps_outside"] == pytest.approx(3 / steps)
    np.testing.assert_allclose(
        numbers(found["share_of_steps_outside_by_coordinate"]), np.array([1, 1, 2]) / steps
    )
    assert found["runs_with_every_w_inside"] == RUNS - 2
    disturbances[4, 1, 2] = 0
    found = metrics.disturbance_metrics(paper_design, disturbances)
    np.testing.assert_allclose(numbers(found["largest"]), [0.0075, 0.006, 0.6])
    np.testing.assert_allclose(numbers(found["allowed"]), [0.005, 0.005, 0.2])
    assert found["margin"] == pytest.approx(-2 * widths[2])


def test_deviations_are_judged_by_the_section_of_their_stage(paper_design):
    sections = paper_design.tubes["paper"][1:]
    generator = np.random.default_rng(2)
    mixtures = []
    for section in sections:
        vertices = section.vertices()
        mixtures.append(generator.dirichlet(np.ones(len(vertices)), 50) @ vertices)
    deviations = np.stack(mixtures)
    found = metrics.deviation_metrics(paper_design, deviations)
    assert found["plans"] == 50
    assert found["samples"] == 250
    assert found["share_outside"] == 0
    assert np.all(found["margin_by_stage"] >= 0)
    # One tip of a section is outside the one before, and NaN is outside.
    vertices = sections[2].vertices()
    tip = vertices[np.argmax(vertices[:, 1])]
    deviations[1, 0] = tip
    deviations[2, 0] = 0.999 * tip
    deviations[4, 3] = np.nan
    found = metrics.deviation_metrics(paper_design, deviations)
    np.testing.assert_allclose(found["share_outside_by_stage"], [0, 0.02, 0, 0, 0.02])
    assert found["share_outside"] == pytest.approx(2 / 250)
    expected = paper_design.tubes["paper"][2].polytope().margin(tip)
    assert expected < 0
    assert found["margin_by_stage"][1] == pytest.approx(expected)


# ------------------------------------------------------------------------------------------- design


def test_design_metrics_are_the_known_numbers_of_the_paper(paper_design):
    certificate = Certificate((Condition("condition", -0.1, "It fails.", "model"),))
    found = metrics.design_metrics(dataclasses.replace(paper_design, certificate=certificate))
    np.testing.assert_allclose(
        found["lqr_gain"], [[-0.951249, 0, 0], [0, -0.936687, -1.305797]], atol=PAPER_GAIN
    )
    np.testing.assert_allclose(
        found["tube_half_widths"]["paper"][-1], [0.020675, 0.038934, 1.05251], atol=1e-5
    )
    np.testing.assert_allclose(
        found["tube_half_widths"]["hull"][-1], [0.020675, 0.036638, 1.04106], atol=1e-5
    )
    assert found["tube_volume"]["paper"] == pytest.approx(9.8017e-05, rel=1e-4)
    assert found["tube_volume"]["hull"] == pytest.approx(9.1322e-05, rel=1e-4)
    np.testing.assert_allclose(
        found["input_support"]["paper"], [0, 0.0175, 0.0378, 0.0606, 0.0856, 0.1124], atol=6e-5
    )
    np.testing.assert_allclose(found["input_set_p_q"], [[-0.84, 2.54]] * 2, atol=ROUNDING)
    tubes = {"paper", "hull", "summed", "sequence"}
    assert set(found["tube_volume"]) == tubes
    assert set(found["tube_half_widths"]) == tubes
    for widths in found["tube_half_widths"].values():
        assert widths.shape == (6, 3)
        assert np.all(widths[0] == 0)
        assert np.all(np.diff(widths, axis=0) > 0)
    assert found["terminal_facets_maximal"] >= found["terminal_facets"]
    assert 0 < found["terminal_volume_share"] <= 1
    np.testing.assert_array_less(found["terminal_half_widths"], LIMITS * DEGREES * (1 + ROUNDING))
    assert not found["certified"]
    keys = {"holds", "margin", "required", "scope", "sentence"}
    assert set(found["certificate"]["condition"]) == keys


def test_the_widest_section_along_the_reference_is_reported_for_the_sequence_tube(paper_design):
    W = paper_design.problem.disturbance_set
    tubes = [sequence_tube(loops, W) for loops in paper_design.windows.loops]
    by_window = [[section.support(np.eye(3)) for section in tube] for tube in tubes]
    expected = np.max(by_window, axis=0) * DEGREES
    found = metrics.tube_half_widths(paper_design, "sequence")
    np.testing.assert_allclose(found, expected, atol=CLOSED_LOOP)


def test_where_there_is_no_terminal_set_its_numbers_are_missing(uncertified):
    found = metrics.design_metrics(uncertified("robust", *TIGHT))
    assert found["terminal_facets"] is None
    assert found["terminal_volume_share"] is None
    assert found["terminal_fallback"]
    assert found["terminal_constraint_facets"] == 6


# ------------------------------------------------------------------------------------------- stress


def test_stress_metrics_tell_runs_apart_by_whether_every_w_was_in_W(paper_design):
    """Four runs of the model itself: quiet; a kick out of W; out of E by its start; without plans
    for a while."""
    problem = paper_design.problem
    errors = np.zeros((STEPS + 1, 4, 3))
    errors[0, 2, 1] = 0.35
    status = np.zeros((STEPS, 4), int)
    status[50:53, 3] = qp.INFEASIBLE
    status[70:75, 3] = qp.INFEASIBLE
    status[299, 1] = qp.UNSOLVED
    status[10, 1] = qp.INFEASIBLE
    for step in range(STEPS):
        errors[step + 1] = errors[step] @ model(problem, problem.schedule[step])[0].T
        errors[step + 1, 1, 0] += 0.4 * (step == 20)
    active = np.zeros_like(status, bool)
    active[:5, 0] = True
    active[20:26, 2] = True
    no_wheels = np.full((STEPS, 4, 2), np.nan)
    diagnostics = Diagnostics(status, np.zeros(status.shape), active, status != qp.SOLVED)
    inputs = np.zeros((STEPS, 4, 2))
    trajectory = Trajectory(errors, errors, inputs, no_wheels, no_wheels, diagnostics)
    runs = SimpleNamespace(runs={"case": {"tube_mpc": trajectory}})
    found = stress.metrics(paper_design, runs)["case"]["tube_mpc"]
    outside = ~np.all(np.abs(errors) <= LIMITS, axis=(0, 2))
    assert list(outside) == [False, True, True, False]
    assert found == {
        "runs": 4,
        "runs_outside_E": 2,
        "share_outside_E": 0.5,
        "runs_with_every_w_in_W": 3,
        "runs_outside_E_with_every_w_in_W": 1,
        "infeasible_QPs": 9,
        "unsolved_QPs": 1,
        "runs_with_infeasible_QP": 2,
        "runs_with_infeasible_QP_and_every_w_in_W": 1,
        "runs_recovered": 1,
        "longest_backup_steps": 5,
        "share_of_steps_with_active_row": pytest.approx(11 / (4 * STEPS)),
        "share_of_first_10_steps_with_active_row": pytest.approx(5 / 40),
    }
