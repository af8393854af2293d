"""Laws of the tube-MPC on line: exact answers, honest status, the guarantee on the linear plant,
and the backup."""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import SEQUENCE, TIGHT, PlainMpc, terminal_gain, tube_gain
from tolerances import KKT, LINEAR_PROGRAM, ROUNDING

from jaxtube import qp
from jaxtube.control import planning
from jaxtube.scenario import load
from jaxtube.simulation import batches, components
from jaxtube.synthesis.design import design as make_design

EXACT_SOLVER = 1e-6
"""First inputs of the batched solver, residual 1e-8, against an active-set method."""
SINGLE_PRECISION = 1e-4
"""The same in float32."""
SINGLE_KKT = 2e-5
"""`KKT` in float32."""

BATCH = 256
ONE_SIDED = ("robot.wheel_speed_max_mps=2.2",)

planned = jax.jit(planning.plan)


def plan_in_blocks(design, step, starts, dtype=float):
    """Solve the QPs of one step from many starts, BATCH at a time, and return numpy arrays."""
    window = planning.take_qp(design.tube_qps, design.windows.index[step])
    window = jax.tree.map(lambda array: jnp.asarray(array, dtype), window)
    answers = [planned(window, jnp.asarray(block, dtype)) for block in starts.reshape(-1, BATCH, 3)]
    return jax.tree.map(lambda *arrays: np.concatenate(arrays), *answers)


def recorded(trajectory, count, seed, steps=None):
    """Choose (step, realisation) pairs of closed loops at random."""
    generator = np.random.default_rng(seed)
    total, runs = trajectory.inputs.shape[:2]
    return generator.integers(steps or total, size=count), generator.integers(runs, size=count)


def compare_recorded(design, trajectory, chosen, with_tube=True):
    """Return (error of each input against DAQP, number of active rows) of recorded QPs; all must
    have a plan."""
    plain = PlainMpc(design, with_tube)
    errors = []
    active = []
    for step, run in zip(*chosen, strict=True):
        inputs, multipliers = plain.qp(step).solve(trajectory.measured[step, run])
        errors.append(np.abs(inputs[:2] - trajectory.inputs[step, run]).max())
        active.append(np.sum(multipliers > 0))
    return np.array(errors), np.array(active)


# ------------------------------------------------------------------------------------ exact answers


def test_inputs_of_the_papers_laps_are_those_of_an_exact_solver(paper_design, paper_laps):
    errors, _ = compare_recorded(paper_design, paper_laps, recorded(paper_laps, 1000, 1))
    assert errors.max() <= EXACT_SOLVER
    assert paper_laps.diagnostics.residual.max() <= KKT


@pytest.mark.parametrize("name", ["tube_mpc", "plain_mpc"])
def test_inputs_from_the_edge_of_the_feasible_set_are_those_of_an_exact_solver(
    robust_design, stressed, name
):
    trajectory = stressed[name]
    steps, runs = recorded(trajectory, 600, 2, steps=6)
    solved = trajectory.diagnostics.status[steps, runs] == qp.SOLVED
    errors, active = compare_recorded(
        robust_design, trajectory, (steps[solved], runs[solved]), name == "tube_mpc"
    )
    assert errors.max() <= EXACT_SOLVER
    assert trajectory.diagnostics.residual[steps, runs][solved].max() <= KKT
    np.testing.assert_array_equal(trajectory.diagnostics.active[steps, runs][solved], active > 0)


def hard_starts(design, edge_starts, count, seed):
    """Starts at the edge of the feasible set of step 0, a third of them pushed beyond it by up to
    30 %."""
    starts = edge_starts(design, count, edge_share=1.0)
    generator = np.random.default_rng(seed)
    return (
        starts
        * np.where(generator.random(count) < 1 / 3, 1 + 0.3 * generator.random(count), 1.0)[:, None]
    )


class Comparison(NamedTuple):
    """Batched plans beside the exact solver's, instance by instance; errors and active rows where
    both have a plan."""

    errors: np.ndarray
    active: np.ndarray
    feasible: np.ndarray
    status: np.ndarray

    def __str__(self):
        counts = [
            np.bincount(self.status[chosen], minlength=3).tolist()
            for chosen in (self.feasible, ~self.feasible)
        ]
        return (
            f"solved, infeasible, unsolved: {counts[0]} of the feasible and {counts[1]} of the "
            f"infeasible ones; worst error {self.errors.max(initial=0):.2g}; by active rows "
            f"{np.bincount(self.active).tolist()}"
        )


def compare_plans(design, step, starts, dtype=float, residual=KKT):
    """Compare plans with the exact solver; whatever is claimed, that there is a plan or none, must
    be true."""
    problem = PlainMpc(design).qp(step)
    found = plan_in_blocks(design, step, starts, dtype)
    plans = found.status == qp.SOLVED
    exact = [problem.solve(start) for start in starts]
    feasible = np.array([answer is not None for answer in exact])
    inputs = np.array([answer[0] if answer else np.zeros(2 * problem.horizon) for answer in exact])
    active = np.array([np.sum(answer[1] > 0) if answer else 0 for answer in exact])
    allowance = LINEAR_PROGRAM + residual
    for flagged in np.flatnonzero(found.status == qp.INFEASIBLE):
        assert problem.shortfall(starts[flagged]) > -allowance
    for claimed in np.flatnonzero(plans & ~feasible):
        assert problem.shortfall(starts[claimed]) < allowance
    scale = np.maximum(1, np.abs(starts @ problem.linear.T).max(axis=1))
    assert np.all(found.residual[plans] <= residual * scale[plans] * (1 + ROUNDING))
    both = plans & feasible
    errors = np.abs(found.inputs.reshape(inputs.shape) - inputs)[both].max(axis=1)
    return Comparison(errors, active[both], feasible, found.status)


@pytest.mark.parametrize("overrides", [TIGHT, ONE_SIDED])
def test_plans_with_many_active_rows_are_exact_and_infeasible_ones_are_flagged(
    uncertified, edge_starts, overrides
):
    design = uncertified("robust", *overrides)
    found = compare_plans(design, 0, hard_starts(design, edge_starts, 2 * BATCH, 6))
    assert found.errors.max() <= EXACT_SOLVER, str(found)
    assert np.mean(found.active > 0) >= 0.2 and found.active.max() >= 5, str(found)
    assert np.sum(~found.feasible) > BATCH / 8 and np.all(
        found.status[~found.feasible] != qp.UNSOLVED
    ), str(found)
    assert np.mean(found.status[found.feasible] == qp.SOLVED) >= 0.999, str(found)


def test_an_error_that_no_input_can_bring_back_has_no_plan(uncertified):
    design = uncertified("robust", *TIGHT)
    # One step ahead the lateral error is e_y + T (V e_th - Om e_x), whatever the input.
    limit = design.problem.error_set.offsets[1] - design.tightening.error_reach[0, 1, 1]
    ahead = 0.1 * design.problem.reference.wheels[0].mean()
    headings = np.linspace(0, 0.3, BATCH)
    beyond = np.where(np.arange(BATCH) % 2 == 0, 1e-6, -1e-6)
    starts = np.stack([np.zeros(BATCH), limit + beyond - ahead * headings, headings], axis=1)
    starts[np.arange(BATCH) % 4 >= 2] *= -1
    status = plan_in_blocks(design, 0, starts).status
    assert np.all(status[beyond > 0] == qp.INFEASIBLE)
    assert np.any(status[beyond < 0] == qp.SOLVED)


# ---------------------------------------------------------------------------------------- guarantee


def check_guarantee(design, tube, plain):
    limits = design.problem.error_set.offsets[:3]
    assert np.all(np.abs(tube.errors) <= limits)
    assert np.all(tube.diagnostics.status == qp.SOLVED) and not tube.diagnostics.backup.any()
    assert np.all(
        tube.inputs @ design.problem.input_set.normals.T <= design.problem.input_set.offsets
    )
    leaving = np.any(np.abs(plain.errors) > limits, axis=(0, 2))
    assert 0 < leaving.sum() < leaving.size


def test_with_w_in_W_the_tube_mpc_keeps_E_and_a_plan_for_ever_and_mpc_without_tube_does_not(
    robust_design, stressed
):
    assert robust_design.certificate.holds_for_model
    check_guarantee(robust_design, stressed["tube_mpc"], stressed["plain_mpc"])


def test_the_guarantee_holds_with_the_terminal_gain_in_the_tube_along_the_reference(
    uncertified, edge_starts
):
    design = uncertified("paper", *SEQUENCE)
    controllers = components.controllers(design)
    plant = components.linear_plant(design)
    starts = edge_starts(design, 512)
    check_guarantee(
        design,
        *(
            batches.run_realisations(controllers[name], plant, starts, 7)
            for name in ("tube_mpc", "plain_mpc")
        ),
    )


@pytest.mark.slow
def test_the_guarantee_holds_in_thousands_of_runs(robust_design, uncertified, edge_starts):
    for design in (robust_design, uncertified("paper", *SEQUENCE)):
        controllers = components.controllers(design)
        plant = components.linear_plant(design)
        starts = edge_starts(design, 2000, edge_share=0.8)
        check_guarantee(
            design,
            *(
                batches.run_realisations(controllers[n], plant, starts, 8)
                for n in ("tube_mpc", "plain_mpc")
            ),
        )


# ------------------------------------------------------------------------------------------- backup


@pytest.fixture(scope="module")
def disturbed(robust_design, edge_starts):
    """The tube-MPC of `robust` under ten times W; many starts are beyond its feasible set, one is
    not a number."""
    controllers = components.controllers(robust_design)
    plant = components.linear_plant(robust_design)
    plant = dataclasses.replace(plant, disturbance_vertices=10 * plant.disturbance_vertices)
    starts = edge_starts(robust_design, BATCH)
    starts[: BATCH // 4] *= 1.5
    starts[0] = np.nan
    return batches.run_realisations(controllers["tube_mpc"], plant, starts, 9)


def test_without_a_plan_the_status_says_so_and_inputs_stay_finite(disturbed):
    status = disturbed.diagnostics.status
    backup = disturbed.diagnostics.backup
    assert np.mean(status[0, 1 : BATCH // 4] == qp.INFEASIBLE) > 0.5
    assert np.all(status[0, BATCH // 4 :] == qp.SOLVED)
    np.testing.assert_array_equal(backup, status != qp.SOLVED)
    assert np.all(np.isfinite(disturbed.inputs[:, 1:])) and np.all(
        np.isfinite(disturbed.errors[:, 1:])
    )
    recovered = backup.any(axis=0) & ~backup[-1]
    assert recovered.sum() > BATCH / 4


def test_a_start_that_is_not_a_number_is_never_taken_for_a_plan(disturbed):
    assert np.all(disturbed.diagnostics.status[:, 0] == qp.UNSOLVED) and np.all(
        disturbed.diagnostics.backup[:, 0]
    )
    assert np.all(disturbed.diagnostics.status[:, 1:] != qp.UNSOLVED)


def test_the_backup_follows_the_last_plan_then_the_terminal_gain(robust_design, disturbed):
    problem = robust_design.problem
    plain = PlainMpc(robust_design)
    backup = disturbed.diagnostics.backup
    used = dict(plan=0, gain=0)
    for run in range(1, BATCH, 2):
        inputs = None
        errors = None
        age = 0
        for step in range(100):
            error = disturbed.measured[step, run]
            wheels = problem.schedule[step]
            if not backup[step, run]:
                inputs, errors = plain.qp(step).plan(error)
                age = 0
            if inputs is not None and age < problem.horizon:
                expected = inputs[age] + tube_gain(robust_design, wheels) @ (error - errors[age])
                used["plan"] += age > 0
            else:
                expected = terminal_gain(robust_design, wheels) @ error
                used["gain"] += 1
            np.testing.assert_allclose(disturbed.inputs[step, run], expected, atol=EXACT_SOLVER)
            age += 1
    assert used["plan"] > 100 and used["gain"] > 20


# ------------------------------------------------------------------------------------ without reset


@pytest.mark.slow
def test_without_restart_the_nominal_trajectory_knows_nothing_of_disturbances(paper_design):
    """Eqs. (12)-(15), (31): u = g_0 + K(th) (e - e_nominal), and g_0 is a function of e_nominal
    alone."""
    controller = dataclasses.replace(
        components.controllers(paper_design)["tube_mpc"], restart=False
    )
    starts = np.tile(paper_design.problem.initial_error, (BATCH, 1))
    trajectory = batches.run_realisations(
        controller, components.slipping_robot(paper_design), starts, 10
    )
    problem = paper_design.problem
    plain = PlainMpc(paper_design)
    nominal = starts[0]
    for step, wheels in enumerate(problem.schedule[: problem.reference.steps]):
        inputs, errors = plain.qp(step).plan(nominal)
        expected = (
            inputs[0] + (trajectory.measured[step] - nominal) @ tube_gain(paper_design, wheels).T
        )
        np.testing.assert_allclose(trajectory.inputs[step], expected, atol=EXACT_SOLVER)
        nominal = errors[1]
    assert np.abs(nominal).max() < 1e-3 < np.abs(trajectory.errors[-1]).max()
    assert np.ptp(trajectory.errors[-1, :, 1]) > 1e-3


# ------------------------------------------------------------------------------------- ten thousand


@pytest.mark.slow
def test_ten_thousand_recorded_qps_are_solved_exactly(paper_design, paper_laps):
    errors, _ = compare_recorded(paper_design, paper_laps, recorded(paper_laps, 10_000, 11))
    assert errors.max() <= EXACT_SOLVER


@pytest.mark.slow
@pytest.mark.parametrize(
    ("dtype", "residual", "tolerance", "least_share"),
    [(np.float64, KKT, EXACT_SOLVER, 0.999), (np.float32, SINGLE_KKT, SINGLE_PRECISION, 0.9)],
)
def test_ten_thousand_hard_qps_are_solved_or_flagged(
    uncertified, edge_starts, dtype, residual, tolerance, least_share
):
    cases = [("robust", ()), ("robust", TIGHT), ("robust", ONE_SIDED), ("paper", SEQUENCE)]
    comparisons = []
    for name, overrides in cases:
        design = uncertified(name, *overrides)
        steps = np.unique(design.windows.index, return_index=True)[1]
        starts = hard_starts(design, edge_starts, 10 * BATCH, 12).reshape(len(steps), -1, 3)
        comparisons += [
            compare_plans(design, step, block, dtype, residual)
            for step, block in zip(steps, starts, strict=True)
        ]
    found = Comparison(*(np.concatenate(parts) for parts in zip(*comparisons, strict=True)))
    assert len(found.status) >= 10_000
    assert found.errors.max() <= tolerance, str(found)
    assert np.mean(found.active > 0) >= 0.2 and np.sum(found.active >= 5) > 100, str(found)
    assert np.mean(found.status[found.feasible] == qp.SOLVED) >= least_share, str(found)


# Measured errors on the edge of the feasible set from which a predictor-corrector method without
# safeguard cycles.
CYCLING = np.array(
    [
        [-0.06755624, -0.19846809, -0.12548356],
        [-0.07504854, -0.20960052, -0.09111139],
        [-0.07696922, -0.21222436, -0.08290838],
        [-0.05574496, -0.18295387, -0.17434202],
        [-0.06699427, -0.19755656, -0.12807088],
    ]
)


@pytest.mark.slow
def test_plans_from_the_edge_of_a_certified_design_are_found():
    found = make_design(load("certified"))
    window = planning.take_qp(jax.device_put(found.tube_qps), found.windows.index[0])
    plan = jax.jit(planning.plan)(window, jnp.asarray(CYCLING))
    np.testing.assert_array_equal(plan.status, qp.SOLVED)
