"""Laws of the prediction model: it is a Jacobian of the plant, and has the structure the paper
gives it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from continuous_time import error_rate
from scipy.linalg import solve_discrete_are
from tolerances import PAPER_GAIN, ROUNDING

from jaxtube.plant import error_dynamics, robot
from jaxtube.plant.model import make_model

DT = 0.1
TRACK_WIDTH = 0.5
SLIP = np.array([0.2, 0.15])
BOX = (np.array([0.2, 0.2]), np.array([1.5, 1.5]))
SCHEDULES = np.array(
    [[1.496, 1.224], [1.0, 1.0], [1.0, 1.0 + 1e-9], [0.2, 1.5], [2.5, -0.8], [0.0, 0.0]]
)


def made(model="consistent", discretisation="euler", slip=SLIP, box=BOX):
    return make_model(model, discretisation, DT, TRACK_WIDTH, slip, box)


def jacobians(step, schedule):
    """Jacobians by error and by virtual input at zero; the wheels compensate their slip."""

    def next_error(error, deficits):
        wheels = robot.wheel_commands(deficits, jnp.array(schedule), jnp.array(SLIP), TRACK_WIDTH)
        return step(error, wheels, jnp.array(SLIP), jnp.array(schedule))

    return jax.jacobian(next_error, argnums=(0, 1))(jnp.zeros(3), jnp.zeros(2))


def euler_step(error, wheels, slip, schedule):
    return error + DT * error_rate(error, wheels, slip, schedule, TRACK_WIDTH)


def exact_step(error, wheels, slip, schedule):
    return error_dynamics.advance(error, wheels, slip, schedule, TRACK_WIDTH, DT)


@pytest.mark.parametrize("discretisation, step", [("euler", euler_step), ("zoh", exact_step)])
@pytest.mark.parametrize("schedule", SCHEDULES, ids=str)
def test_consistent_model_is_the_jacobian_of_the_compensated_plant(discretisation, step, schedule):
    A, B = made(discretisation=discretisation).matrices(schedule)
    A_plant, B_plant = jacobians(step, schedule)
    np.testing.assert_allclose(A, A_plant, atol=10 * ROUNDING)
    np.testing.assert_allclose(B, B_plant, atol=10 * ROUNDING)


def test_papers_model_is_the_jacobian_at_uncompensated_wheels_but_for_the_speed():
    # With wheels = reference the robot turns with the slipped yaw rate, the factor in the paper's
    # A.
    schedule = np.array([1.3, 0.9])
    A, _ = made("paper").matrices(schedule)
    step = jax.jacobian(
        lambda e: euler_step(e, jnp.array(schedule), jnp.array(SLIP), jnp.array(schedule))
    )
    np.testing.assert_allclose(A, step(jnp.zeros(3)), atol=ROUNDING)


@pytest.mark.parametrize(
    "schedule, error, mismatch", [((1.54, 1.26), 0.3, 3.4e-3), ((1.5, 0.2), 0.3, 15.6e-3)]
)
def test_papers_model_misses_the_plant_by_the_slip_times_the_turn(schedule, error, mismatch):
    slip = np.array([0.2, 0.2])
    difference = (
        made("paper", slip=slip).matrices(schedule)[0] - made(slip=slip).matrices(schedule)[0]
    )
    turn = DT * 0.2 * (schedule[0] - schedule[1]) / TRACK_WIDTH
    np.testing.assert_allclose(difference, [[0, -turn, 0], [turn, 0, 0], [0, 0, 0]], atol=ROUNDING)
    assert abs(difference[0, 1]) * error == pytest.approx(mismatch, abs=5e-5)


def test_euler_and_zoh_agree_to_second_order():
    def find_gaps(dt):
        """Return by how much A and B differ."""
        euler = make_model("paper", "euler", dt, TRACK_WIDTH, SLIP, BOX)
        exact = make_model("paper", "zoh", dt, TRACK_WIDTH, SLIP, BOX)
        wheels = BOX[1] * [1.0, 0.3]
        pairs = zip(euler.matrices(wheels), exact.matrices(wheels), strict=True)
        return np.array([np.abs(one - other).max() for one, other in pairs])

    np.testing.assert_allclose(find_gaps(2e-3) / find_gaps(1e-3), 4.0, rtol=0.01)


def test_vertices_are_those_of_the_paper():
    model = made("paper")
    A_r, A_l = model.slopes
    A_n = np.eye(3) + A_r * model.centre[0] + A_l * model.centre[1]
    (m_r, m_l) = -model.half_widths
    (M_r, M_l) = model.half_widths
    # Eqs. (34)-(37).
    expected = [
        A_n + A_r * m_r + A_l * M_l,
        A_n + A_r * m_r + A_l * m_l,
        A_n + A_r * M_r + A_l * m_l,
        A_n + A_r * M_r + A_l * M_l,
    ]
    np.testing.assert_allclose(model.matrices(model.vertices)[0], expected, atol=ROUNDING)


def test_slopes_and_gains_have_the_papers_entries():
    g_r = DT * 0.8 / TRACK_WIDTH
    g_l = DT * 0.85 / TRACK_WIDTH
    d = DT / 2
    model = made("paper")
    np.testing.assert_allclose(
        model.slopes[0], [[0, g_r, 0], [-g_r, 0, d], [0, 0, 0]], atol=ROUNDING
    )
    np.testing.assert_allclose(
        model.slopes[1], [[0, -g_l, 0], [g_l, 0, d], [0, 0, 0]], atol=ROUNDING
    )
    K_r, K_l = model.compensating_gains()
    np.testing.assert_allclose(K_r, [[0, -g_r / DT, 0], [0, 0, 0]], atol=ROUNDING)
    np.testing.assert_allclose(K_l, [[0, g_l / DT, 0], [0, 0, 0]], atol=ROUNDING)


@pytest.mark.parametrize("kind", ["paper", "consistent"])
def test_compensated_closed_loop_is_affine_with_slopes_in_the_lateral_row_only(kind):
    model = made(kind)
    K_n = np.array([[-0.95, 0.1, 0.0], [0.05, -0.94, -1.3]])
    K_r, K_l = model.compensating_gains()
    A_n, B = model.matrices(model.centre)
    g_r, g_l = DT * model.slip_factors / TRACK_WIDTH
    lateral_r, lateral_l = np.zeros((2, 3, 3))
    lateral_r[1] = [-g_r, 0.0, DT / 2]
    lateral_l[1] = [g_l, 0.0, DT / 2]
    for schedule in np.random.default_rng(7).uniform(*BOX, (20, 2)):
        deviation_r, deviation_l = schedule - model.centre
        K = K_n + K_r * deviation_r + K_l * deviation_l
        closed_loop = model.matrices(schedule)[0] + B @ K
        affine = A_n + B @ K_n + lateral_r * deviation_r + lateral_l * deviation_l
        np.testing.assert_allclose(closed_loop, affine, atol=ROUNDING)


@pytest.mark.parametrize(
    "box", [BOX, (np.array([0.2, 0.7]), np.array([1.5, 0.7])), (BOX[1], BOX[1])]
)
def test_weights_reproduce_schedule_and_matrix(box):
    model = made("paper", box=box)
    schedules = np.random.default_rng(8).uniform(*box, (5, 40, 2))
    weights = model.weights(schedules)
    assert weights.shape == (5, 40, 4) and np.all(weights >= 0.0)
    np.testing.assert_allclose(weights.sum(axis=-1), 1.0, atol=ROUNDING)
    np.testing.assert_allclose(weights @ model.vertices, schedules, atol=ROUNDING)
    vertex_matrices, _ = model.matrices(model.vertices)
    combined = np.tensordot(weights, vertex_matrices, axes=1)
    np.testing.assert_allclose(combined, model.matrices(schedules)[0], atol=ROUNDING)


def test_weights_are_the_vertices_own_and_bilinear():
    model = made()
    np.testing.assert_allclose(model.weights(model.vertices), np.eye(4), atol=ROUNDING)
    np.testing.assert_allclose(model.weights(model.centre), 0.25, atol=ROUNDING)
    quarter = BOX[0] + (BOX[1] - BOX[0]) * [0.25, 0.5]
    np.testing.assert_allclose(model.weights(quarter), [0.375, 0.375, 0.125, 0.125], atol=ROUNDING)


def test_nominal_regulator_of_the_paper_is_reproduced():
    model = made("paper", slip=np.array([0.2, 0.2]))
    A, B = model.matrices(model.centre)
    P = solve_discrete_are(A, B, np.diag([1.0, 1.0, 0.01]), np.eye(2))
    K = -np.linalg.solve(np.eye(2) + B.T @ P @ B, B.T @ P @ A)
    np.testing.assert_allclose(K, [[-0.951249, 0, 0], [0, -0.936687, -1.305797]], atol=PAPER_GAIN)


def test_zoh_refuses_slopes():
    with pytest.raises(ValueError, match=r"discretisation = 'zoh' has no slopes.*use 'euler'"):
        _ = made(discretisation="zoh").slopes


@pytest.mark.parametrize(
    "changed, message",
    [
        ({"model": "papers"}, "model = 'papers' .*paper, consistent"),
        ({"discretisation": "rk4"}, "discretisation = 'rk4' .*euler, zoh"),
        ({"dt": 0.0}, "dt = 0.0"),
        ({"track_width": float("nan")}, "track_width = nan"),
        ({"nominal_slip": [0.2, 1.0]}, r"nominal_slip = \[0.2, 1.0\] .*\(-1, 1\)"),
        ({"nominal_slip": 0.2}, "nominal_slip = 0.2"),
        ({"box": BOX[::-1]}, "box = .*lower ones first"),
        ({"box": ([0.2, float("nan")], [1.5, 1.5])}, "box = .*finite"),
    ],
)
def test_bad_settings_are_refused_in_one_line(changed, message):
    good = dict(
        model="paper",
        discretisation="euler",
        dt=DT,
        track_width=TRACK_WIDTH,
        nominal_slip=SLIP,
        box=BOX,
    )
    with pytest.raises(ValueError, match=message) as caught:
        make_model(**{**good, **changed})
    assert "\n" not in str(caught.value)
