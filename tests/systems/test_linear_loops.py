"""Laws of the closed loops of linear systems: batched tube-MPC, Monte Carlo, falsification and
tuning, on one small system that all compile once."""

from dataclasses import replace

import daqp
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from linear_systems import varying_mass

import jaxtube as jt
from jaxtube.tuning.linear import _LinearTuner

GAIN = np.array([[-4.0, -3.0]])


@pytest.fixture(scope="module")
def design():
    """The design of the mass."""
    return jt.design(varying_mass(K=GAIN))


@pytest.fixture(scope="module")
def laps(design):
    """Laps from the edge of its feasible set."""
    return jt.simulate(design, laps=300, starts="edge")


def test_commands_are_those_of_a_program_solved_exactly(design, laps):
    system = design.system
    P = design.cost.cost
    qps = design.tube_qps
    active = 0
    for step in (0, 3, 8):
        window = design.windows.index[step]
        schedule = design.windows.schedules[window]
        for lap in range(0, 300, 10):
            x = laps.states[step, lap]
            H, f = _write_cost(system, P, schedule, x)
            on_plan = qps.factors.rows[window] * qps.factors.row_norms[window][:, None]
            offsets = qps.row_errors[window] @ x
            lower = np.maximum(qps.lower[window] - offsets, -1e30)
            upper = np.minimum(qps.upper[window] - offsets, 1e30)
            plan, _, flag, information = daqp.solve(H, f, on_plan, upper, lower)
            assert flag == 1
            active += int(np.any(information["lam"] != 0))
            np.testing.assert_allclose(laps.inputs[step, lap], plan[:1], atol=1e-6)
    assert active > 5


def _write_cost(system, P, schedule, x):
    """Return Hessian and gradient of the cost of a plan, by simulating unit vectors."""
    N = len(schedule)

    def play(plan):
        state = x if plan is None else np.zeros(2)
        inputs = np.zeros(N) if plan is None else plan
        states = []
        for th, u in zip(schedule, inputs, strict=True):
            A = sum(w * a for w, a in zip(th, system.A, strict=True))
            B = sum(w * b for w, b in zip(th, system.B, strict=True))
            state = A @ state + B[:, 0] * u
            states.append(state)
        return np.array(states)

    free = play(None)
    forced = [play(unit) for unit in np.eye(N)]
    weights = [system.Q] * (N - 1) + [P]
    H = system.R[0, 0] * np.eye(N)
    f = np.zeros(N)
    for stage, weight in enumerate(weights):
        columns = np.array([moved[stage] for moved in forced]).T
        H += columns.T @ weight @ columns
        f += columns.T @ weight @ free[stage]
    return 2 * H, 2 * f


def test_laps_move_by_the_model_with_w_in_W_and_keep_every_limit(design, laps):
    system = design.system
    for step, th in enumerate(system.schedule):
        A = sum(w * a for w, a in zip(th, system.A, strict=True))
        B = sum(w * b for w, b in zip(th, system.B, strict=True))
        w = laps.states[step + 1] - laps.states[step] @ A.T - laps.inputs[step] @ B.T
        assert np.all(np.abs(w) <= np.array([0.002, 0.01]) + 1e-12)
    assert np.all(np.abs(laps.states) <= 1 + 1e-9)
    assert np.all(np.abs(laps.inputs) <= 2 + 1e-9)
    assert laps.outside == laps.inputs_outside == laps.without_plan == 0
    assert np.mean(np.abs(laps.states[0]).max(axis=1) > 0.9) > 0.2  # starts reach the edge


def test_a_lap_does_not_depend_on_those_beside_it(design, laps):
    fewer = jt.simulate(design, starts=laps.states[0, :40])
    np.testing.assert_allclose(fewer.states, laps.states[:, :40], atol=1e-12)


@pytest.mark.slow
def test_a_law_of_ones_own_acts_as_written(design):
    laps = jt.simulate(design, lambda x, th: x @ jnp.asarray(GAIN.T), laps=4)
    np.testing.assert_allclose(laps.inputs, laps.states[:-1] @ GAIN.T, atol=1e-14)
    local = jt.simulate(design, "local_gain", laps=4)
    np.testing.assert_allclose(local.states, laps.states, atol=1e-12)
    assert laps.cost().shape == (4,)
    stage = laps.states[:-1] ** 2 @ [1.0, 0.1] + 0.05 * laps.inputs[..., 0] ** 2
    np.testing.assert_allclose(laps.cost(), stage.mean(axis=0))


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"controller": "best"}, "tube_mpc"),
        ({"controller": lambda x, th: x}, r"return|inputs \(batch, 1\)"),
        ({"plant": "robot"}, "motion"),
        ({"plant": "motion"}, "has none"),
        ({"slip": "iid"}, "no slips"),
        ({"starts": np.zeros((3, 3))}, r"\(laps, 2\)"),
    ],
)
def test_what_a_linear_system_does_not_have_is_refused_in_one_line(design, asked, words):
    with pytest.raises(ValueError, match=words) as refused:
        jt.simulate(design, **asked)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("verb", [jt.Stepper, lambda design: jt.export(design, "nowhere")])
def test_verbs_that_need_a_robot_say_so(design, verb):
    with pytest.raises(ValueError, match="linear system"):
        verb(design)


@pytest.mark.slow  # compiles for long
def test_monte_carlo_counts_what_a_recount_of_its_laps_finds(design, laps):
    run = jt.montecarlo(design, laps=300, starts="edge")
    assert run.laps == 300
    assert run.counts["x_outside_E"] == run.counts["u_outside_U"] == 0
    assert run.counts["w_outside_W"] == run.counts["backup"] == run.counts["not_finite"] == 0
    assert run.counts["row_active"] == np.sum(laps.trajectory.diagnostics.active.any(axis=0))
    np.testing.assert_allclose(run.usage["U"], np.abs(laps.inputs).max() / 2, rtol=1e-9)
    np.testing.assert_allclose(run.usage["E"], np.abs(laps.states[1:]).max(), rtol=1e-9)
    share = run.share("x_outside_E")
    assert share.low == 0
    assert 0 < share.high < 0.02


def test_monte_carlo_sees_a_disturbance_that_is_not_in_W(design):
    wider = replace(design.system, W=design.system.disturbance_set.scale(40.0))
    laps = jt.simulate(design, "local_gain", plant=wider, laps=200)
    run = jt.montecarlo(design, "local_gain", plant=wider, laps=200)
    assert run.counts["w_outside_W"] == 200
    assert run.counts["x_outside_E"] == laps.outside > 0
    assert "qp_unsolved" not in run.counts
    with pytest.raises(ValueError, match="cannot occur"):
        run.share("qp_unsolved")


@pytest.mark.slow
def test_the_worst_case_of_a_static_gain_is_its_closed_form(design):
    found = jt.falsify(design, "local_gain", target="error", seconds=5)
    system = design.system
    loops = [
        sum(w * (a + b @ GAIN) for w, a, b in zip(th, system.A, system.B, strict=True))
        for th in system.schedule
    ]
    usage = 0.0
    for last in range(1, len(loops) + 1):
        transport = np.eye(2)
        reach = np.zeros(2)
        for loop in reversed(loops[:last]):
            reach += np.abs(transport) @ [0.002, 0.01]
            transport = transport @ loop
        usage = max(usage, float(np.max(np.abs(transport @ system.start) + reach)))
    assert found.worst.usage == pytest.approx(usage, rel=1e-6)
    assert not found.is_violated
    assert "no violation found" in found.verdict


@pytest.mark.slow  # compiles for long
def test_twice_the_disturbance_is_found_to_break_a_guarantee(design):
    kept = jt.falsify(design, target="error", starts="feasible", seconds=4)
    assert kept.worst.margin > 0
    broken = replace(design.system, W=design.system.disturbance_set.scale(2.0))
    found = jt.falsify(design, plant=broken, target="error", starts="feasible", seconds=4)
    assert found.is_violated
    assert found.worst.margin < -1e-3
    assert "violation found: of E" in found.verdict


def test_a_start_without_a_plan_is_refused(design):
    outside = jt.design(replace(design.system, start=np.array([0.9, 0.9])))
    with pytest.raises(jt.ScenarioError, match="start nearer"):
        jt.falsify(outside)


@pytest.mark.slow  # compiles for long
def test_the_gradient_of_tuning_is_that_of_finite_differences():
    def aim(x, u):
        return jnp.abs(x[:, 0]) + 0.02 * u[:, 0] ** 2

    with jax.enable_x64(True):
        tuner = _LinearTuner(varying_mass(K=GAIN), aim, laps=32, held_out=32, seed=0)
        start = tuner.start
        _, gradient = tuner.evaluate(start, 0)
        for i in (0, 2, 3):
            step = 1e-5 * np.eye(len(start))[i]
            above, _ = tuner.evaluate(start + step, 0)
            below, _ = tuner.evaluate(start - step, 0)
            assert gradient[i] == pytest.approx((above - below) / 2e-5, rel=1e-3, abs=1e-8)


@pytest.mark.slow  # compiles for long
def test_tuning_lowers_its_aim_and_keeps_the_certificate():
    system = varying_mass(K=GAIN)
    tuned = jt.tune(system, evaluations=8, laps=32, held_out=32, aim=_prefer_position)
    assert tuned.best.held_out < 0.99 * tuned.start.held_out
    assert tuned.is_certified
    np.testing.assert_allclose(tuned.system.K[0], GAIN)
    start = jt.design(system)
    for one, other in zip(start.tube, tuned.design.tube, strict=True):
        np.testing.assert_allclose(one.support(np.eye(2)), other.support(np.eye(2)))


def _prefer_position(x, u):
    return jnp.abs(x[:, 0]) + 0.02 * u[:, 0] ** 2
