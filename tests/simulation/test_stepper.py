"""Laws of the controller of one robot: it commands what a batch of one is commanded, from programs
that are compiled once."""

import dataclasses

import jax
import numpy as np
import pytest
from tolerances import CLOSED_LOOP

import jaxtube as jt
from jaxtube import qp

SHORT = "reference.duration_s=2"


@pytest.fixture(scope="module")
def design(uncertified):
    """One whose laps meet active rows, in regions that it knows."""
    return uncertified("tuned", SHORT)


@pytest.fixture(scope="module")
def stepper(design):
    return jt.Stepper(design)


def follow(stepper: jt.Stepper, laps: jt.Laps) -> list[jt.Step]:
    """Return what the stepper commands on the errors of the first of some laps."""
    stepper.restart()
    return [stepper(errors) for errors in np.asarray(laps.trajectory.measured)[:-1, 0]]


def require_same(steps: list[jt.Step], laps: jt.Laps) -> None:
    trajectory = laps.trajectory
    found = trajectory.diagnostics
    expected = (trajectory.demanded, trajectory.inputs, found.residual)
    for name, values in zip(("wheels", "inputs", "residual"), expected, strict=True):
        given = np.array([getattr(step, name) for step in steps])
        np.testing.assert_allclose(given, np.asarray(values)[:, 0], rtol=0, atol=CLOSED_LOOP)
    for name in ("status", "active", "backup"):
        given = np.array([getattr(step, name) for step in steps])
        assert np.array_equal(given, np.asarray(getattr(found, name))[:, 0])


def test_one_robot_is_commanded_what_a_batch_of_one_is(design, stepper):
    laps = jt.simulate(design, laps=1)
    steps = follow(stepper, laps)
    assert any(step.active for step in steps)
    require_same(steps, laps)


def test_steps_in_known_regions_need_no_solver(design, monkeypatch):
    stepper = jt.Stepper(design)
    solved = []
    act = stepper._act

    def count(*arguments):
        solved.append(arguments)
        return act(*arguments)

    monkeypatch.setattr(stepper, "_act", count)
    steps = follow(stepper, jt.simulate(design, laps=1))
    assert len(solved) < sum(step.active for step in steps)


def test_active_rows_and_lost_plans_are_those_of_a_batch_of_one(design, stepper, edge_starts):
    inside = edge_starts(design, 64, edge_share=1.0)
    active = np.asarray(jt.simulate(design, starts=inside).trajectory.diagnostics.active)[0]
    kinds = set()
    for start in (inside[active][0], 1.3 * inside[0]):
        laps = jt.simulate(design, starts=start[None])
        steps = follow(stepper, laps)
        require_same(steps, laps)
        kinds |= {(step.is_solved, step.active) for step in steps}
    assert kinds == {(True, False), (True, True), (False, False)}


@pytest.mark.parametrize(
    "controller", [pytest.param("plain_mpc", marks=pytest.mark.slow), "local_gain", "compensated"]
)
def test_other_controllers_step_as_well(design, controller):
    laps = jt.simulate(design, controller, laps=1)
    require_same(follow(jt.Stepper(design, controller), laps), laps)


@pytest.mark.slow
def test_a_nominal_error_that_is_never_reset_is_remembered(uncertified):
    design = uncertified("certified", SHORT, "controller.restart=false")
    laps = jt.simulate(design, laps=1)
    require_same(follow(jt.Stepper(design), laps), laps)


def test_nothing_is_traced_and_nothing_grows_from_step_to_step(design):
    traced = []

    def law(errors, reference_wheels):
        traced.append(errors.shape)
        return -0.5 * errors[:, :2]

    stepper = jt.Stepper(design, law)
    stepper(np.zeros(3))
    times = len(traced)
    arrays = len(jax.live_arrays())
    for _ in range(10):
        step = stepper(np.array([0.1, 0.0, 0.0]))
    assert np.allclose(step.inputs, [-0.05, 0.0])
    assert len(traced) == times
    assert len(jax.live_arrays()) == arrays


def test_measured_slips_are_compensated(design, stepper):
    stepper.restart()
    nominal = stepper(np.zeros(3))
    stepper.restart()
    slip = np.array([0.3, 0.1])
    measured = stepper(np.zeros(3), slip)
    assert np.allclose(measured.wheels * (1 - slip), nominal.wheels * (1 - 0.2))


def test_it_computes_in_64_bits_whatever_jax_is_configured_to(design, stepper):
    stepper.restart()
    expected = stepper(np.array([0.01, 0.0, 0.0]))
    stepper.restart()
    with jax.enable_x64(False):
        found = stepper(np.array([0.01, 0.0, 0.0]))
    assert np.array_equal(found.inputs, expected.inputs)


def test_any_period_may_be_the_next_one(design, stepper):
    laps = jt.simulate(design, laps=1)
    errors = np.asarray(laps.trajectory.measured)[7, 0]
    stepper.restart(7)
    assert np.allclose(stepper(errors).inputs, laps.trajectory.inputs[7, 0], atol=CLOSED_LOOP)
    assert stepper.next == 8


def test_what_is_no_number_gives_no_plan_and_no_silent_number(stepper):
    stepper.restart()
    step = stepper(np.full(3, np.nan))
    assert step.status == qp.UNSOLVED
    assert step.backup


def test_the_end_of_the_reference_and_other_shapes_are_refused(stepper):
    stepper.restart(stepper.periods - 1)
    with pytest.raises(ValueError, match=r"errors, slip: shapes \(1, 3\) and \(2,\)"):
        stepper(np.zeros((1, 3)))
    stepper(np.zeros(3))
    with pytest.raises(ValueError, match="the reference ended after"):
        stepper(np.zeros(3))
    for period in (-1, 1.5, stepper.periods):
        with pytest.raises(ValueError, match=f"period = {period}: the reference has 0 to"):
            stepper.restart(period)


def test_what_is_no_design_is_refused():
    with pytest.raises(ValueError, match="design"):
        jt.Stepper(dataclasses.make_dataclass("Other", [])())
