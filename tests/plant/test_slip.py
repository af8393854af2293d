"""Laws of the random slips: drawn by index, uniform, bounded, each process true to its name."""

import pickle
from dataclasses import dataclass
from functools import cache, partial
from typing import get_args, get_type_hints

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import chisquare, kstest
from tolerances import LEAST_P_VALUE, ROUNDING

from jaxtube.plant import slip
from jaxtube.plant.robot import Robot
from jaxtube.plant.slip_bounds import near_nominal
from jaxtube.plant.slip_processes import PATCH_SIZE, PROCESSES, STEP_SIZE, find_process
from jaxtube.plant.slipping import SlippingRobot
from jaxtube.scenario.tree import Slip

CORRELATION = 0.08
"""Over four standard deviations of the correlation of 3000 independent pairs."""

SEED = jax.random.key(20)
HERE = slip.Situation(jnp.zeros((2, 2)), jnp.array([0.1, -0.2, 0.3]))
UNIFORM = ("iid", "constant", "walk", "patches")
DRAWN = (*UNIFORM, "vertex")  # and the adversary chooses
STEPS = 41


def one_run(process, uncertain_slip, steps, index_low, situation=HERE, index_high=0):
    """Deviations (steps, 2) of the true and the measured slip of one realisation."""
    # With every argument given, so that calls share their compilation.
    return scan_run(process, uncertain_slip, steps, index_low, situation, index_high)


@partial(jax.jit, static_argnames=("process", "uncertain_slip", "steps"))
def scan_run(process, uncertain_slip, steps, index_low, situation, index_high):
    key = slip.realisation_key(SEED, index_high, index_low)

    def body(state, step):
        true, measured, state = slip.draw_slip(key, step, state, situation, process, uncertain_slip)
        return state, (true, measured)

    return jax.lax.scan(
        body, slip.initial_slip(key, process, situation.errors.dtype), jnp.arange(steps)
    )[1]


def many_runs(process, uncertain_slip, steps, count):
    """Deviations (runs, steps, 2) of the true and the measured slip."""
    return jax.jit(jax.vmap(lambda i: one_run(process, uncertain_slip, steps, i)))(
        jnp.arange(count, dtype=jnp.uint32)
    )


def is_uniform(samples, low=-1.0, high=1.0):
    """Whether the Kolmogorov-Smirnov test lets independent samples pass as uniform."""
    return kstest(np.ravel(samples), "uniform", (low, high - low)).pvalue > LEAST_P_VALUE


@cache
def runs(name):
    """3000 runs of STEPS steps of a process."""
    return np.asarray(many_runs(PROCESSES[name], "both", STEPS, 3000))


@pytest.mark.parametrize("name", UNIFORM)
def test_deviations_are_uniform_and_bounded_at_the_first_and_at_late_steps(name):
    deviations = runs(name)
    assert np.all(np.abs(deviations) <= 1.0)
    for step in (0, 40):
        # One wheel a run, for on one patch both wheels share their slip.
        assert is_uniform(deviations[:, :, step, 0]) and is_uniform(deviations[:, :, step, 1])


@pytest.mark.parametrize("name", DRAWN)
def test_true_and_measured_slips_are_independent(name):
    true, measured = runs(name)
    assert abs(np.corrcoef(true[:, 7, 0], measured[:, 7, 0])[0, 1]) < CORRELATION


@pytest.mark.parametrize("name", DRAWN)
def test_wheels_and_runs_are_independent(name):
    true, _ = runs(name)
    assert abs(np.corrcoef(true[1:, 7, 0], true[:-1, 7, 0])[0, 1]) < CORRELATION
    if name != "patches":
        assert abs(np.corrcoef(true[:, 7, 0], true[:, 7, 1])[0, 1]) < CORRELATION


@pytest.mark.parametrize("name", PROCESSES)
def test_draws_do_not_depend_on_the_batch(name):
    alone = np.asarray(one_run(PROCESSES[name], "both", STEPS, 2345))
    among = runs(name)[:, 2345]
    # A walk adds numbers up, and compilers may fuse that; all else is the same bits.
    np.testing.assert_allclose(alone, among, rtol=0.0, atol=ROUNDING if name == "walk" else 0.0)


@pytest.mark.parametrize("name", ["vertex", "adversarial"])
def test_extreme_deviations_are_extreme(name):
    np.testing.assert_array_equal(np.abs(runs(name)), 1.0)


def test_each_vertex_comes_up_a_quarter_of_the_time():
    true, measured = runs("vertex")
    for deviations in (true, measured):
        _, counts = np.unique(deviations.reshape(-1, 2), axis=0, return_counts=True)
        assert len(counts) == 4 and chisquare(counts).pvalue > LEAST_P_VALUE


@pytest.mark.parametrize("process", PROCESSES.values(), ids=PROCESSES)
def test_only_the_slip_that_is_random_deviates(process):
    both = np.asarray(one_run(process, "both", STEPS, 3))
    for uncertain_slip, (true, measured) in {
        "true": (1, 0),
        "measured": (0, 1),
        "both": (1, 1),
    }.items():
        np.testing.assert_array_equal(
            one_run(process, uncertain_slip, STEPS, 3), [both[0] * true, both[1] * measured]
        )


@pytest.mark.parametrize("process", PROCESSES.values(), ids=PROCESSES)
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_dtype_is_that_of_the_situation(process, dtype):
    here = jax.tree.map(lambda array: array.astype(dtype), HERE)
    run = partial(one_run, process, "both", STEPS, 3)
    assert all(array.dtype == dtype for array in jax.eval_shape(run, here))


@dataclass(frozen=True)
class Fading:
    """A process of a user: the right wheel loses its grip step by step, the left one by chance."""

    rate: float = 0.25
    opposed = False

    def initial(self, key, dtype):
        return jnp.zeros((), dtype)

    def draw(self, key, step, memory, situation):
        chance = jax.random.uniform(jax.random.fold_in(key, step), (), memory.dtype, -1.0, 1.0)
        return jnp.stack([memory, chance]), jnp.minimum(memory + self.rate, 1.0)


def test_a_process_of_a_user_drives_both_slips():
    process = find_process(Fading())
    true, measured = np.asarray(one_run(process, "both", 6, 4))
    for deviations in (true, measured):
        np.testing.assert_array_equal(deviations[:, 0], [0.0, 0.25, 0.5, 0.75, 1.0, 1.0])
    assert not np.any(true[:, 1] == measured[:, 1])


def test_equal_processes_share_one_compilation():
    for name, process in PROCESSES.items():
        copy = pickle.loads(pickle.dumps(process))
        assert copy == process and hash(copy) == hash(process) and find_process(name) is process


def test_scenarios_can_name_every_process_and_no_other():
    fields = get_type_hints(Slip)
    assert set(get_args(fields["process"])) == {*PROCESSES, "recorded"}
    assert set(get_args(fields["random"])) == set(slip.UNCERTAIN_SLIPS)


def test_realisations_around_2_to_the_31_and_2_to_the_32_are_distinct():
    indices = [0, 1, 2**31 - 1, 2**31, 2**31 + 1, 2**32 - 1, 2**32, 2**32 + 1, 2**33, 2**63]
    words = [divmod(index, 2**32) for index in indices]
    first = [
        tuple(
            np.ravel(
                one_run(PROCESSES["iid"], "both", 1, jnp.uint32(low), index_high=jnp.uint32(high))
            )
        )
        for high, low in words
    ]
    assert len(set(first)) == len(indices)


@pytest.mark.parametrize("name", ["iid", "vertex"])
def test_fresh_draws_forget_the_step_before(name):
    true, _ = runs(name)
    assert abs(np.corrcoef(true[:, 0, 0], true[:, 1, 0])[0, 1]) < CORRELATION


def test_constant_is_constant_in_a_run():
    true, measured = runs("constant")
    for deviations in (true, measured):
        np.testing.assert_array_equal(
            deviations, np.broadcast_to(deviations[:, :1], deviations.shape)
        )


def test_walk_takes_uniform_steps_and_is_reflected():
    true, _ = runs("walk")
    moves = true[:, 1:] - true[:, :-1]
    assert np.all(np.abs(true) <= 1.0)
    assert np.all(np.abs(moves) <= STEP_SIZE + ROUNDING)
    assert is_uniform(true[:, -1])
    far_from_walls = np.abs(true[:, 7]) < 1.0 - STEP_SIZE
    assert is_uniform(moves[:, 7][far_from_walls], -STEP_SIZE, STEP_SIZE)
    # Reflection, not clipping: nobody sticks to a wall.
    assert not np.any(np.abs(true) == 1.0)


def test_patches_meet_the_same_slip_on_the_same_ground_at_any_time():
    process = PROCESSES["patches"]
    size = PATCH_SIZE
    key = slip.realisation_key(SEED, 0, 5)

    @jax.jit
    def draw(positions, step, run_key):
        situation = HERE._replace(wheel_positions=positions)
        return slip.draw_slip(run_key, step, ((), ()), situation, process, "true")[0]

    def at(x, y, step=0, run_key=key):
        return np.asarray(draw(jnp.array([[x, y], [x + 7.0, y]]), step, run_key))

    corners = (np.stack(np.meshgrid(np.arange(-6, 6), np.arange(-6, 6)), -1).reshape(-1, 2)) * size
    right, left = np.array([at(*corner) for corner in corners + 0.01]).T
    assert len(set(right)) == len(corners)  # every patch its own slip, those of negative index too
    later = np.array([at(*corner, step=99) for corner in corners + 0.99 * size])
    np.testing.assert_array_equal(later, np.stack([right, left], -1))
    # The left wheel, 7 m to the side, finds what the right wheel finds there: the ground is one.
    assert at(0.1 + 7.0, 0.1)[0] == at(0.1, 0.1)[1]
    assert at(0.1, 0.1, run_key=slip.realisation_key(SEED, 0, 6))[0] != at(0.1, 0.1)[0]


def test_pose_noise_is_uniform_in_its_box_and_new_at_each_step():
    half_widths = jnp.array([0.001, 0.002, 0.0])
    draw = jax.vmap(
        lambda i, step: slip.pose_noise(slip.realisation_key(SEED, 0, i), step, half_widths),
        (0, None),
    )
    now = np.asarray(draw(jnp.arange(3000), 0))
    next_ = np.asarray(draw(jnp.arange(3000), 1))
    assert (
        is_uniform(now[:, 0], -0.001, 0.001)
        and is_uniform(now[:, 1], -0.002, 0.002)
        and np.all(now[:, 2] == 0.0)
    )
    assert abs(np.corrcoef(now[:, 0], next_[:, 0])[0, 1]) < CORRELATION
    assert abs(np.corrcoef(now[:, 0], now[:, 1])[0, 1]) < CORRELATION


def test_a_robot_measures_its_error_with_the_noise_of_the_instant():
    half_widths = jnp.array([0.001, 0.002, 0.003])
    robot = SlippingRobot(
        robot=Robot(track_width=0.5, wheel_speed_min=-1.0, wheel_speed_max=1.0),
        dt=0.1,
        reference_wheels=jnp.zeros((2, 2)),
        reference_poses=jnp.zeros((3, 3)),
        slips=near_nominal(np.zeros(2), 0.1, "true"),
        noise=half_widths,
    )
    keys = jax.vmap(lambda i: slip.realisation_key(SEED, 0, i))(jnp.arange(5))
    errors = jnp.linspace(-0.2, 0.2, 15).reshape(5, 3)
    measure = jax.jit(robot.measure_errors)
    for step in range(3):
        noise = [slip.pose_noise(key, step, half_widths) for key in keys]
        np.testing.assert_array_equal(measure(keys, step, errors), errors + jnp.stack(noise))


def test_noise_and_slips_use_different_streams():
    key = slip.realisation_key(SEED, 0, 9)
    noise = np.asarray(slip.pose_noise(key, 0, jnp.ones(3)))
    drawn = np.ravel(one_run(PROCESSES["iid"], "both", 1, 9))
    assert len({*noise, *drawn}) == 7


@pytest.mark.parametrize(
    "refused, message",
    [
        (lambda: find_process("wlak"), "slip: process = 'wlak' .*choose one of iid, constant"),
        (
            lambda: one_run(PROCESSES["iid"], "neither", 1, 0),
            "slip: random = 'neither' .*true, measured, both",
        ),
    ],
)
def test_bad_settings_are_refused_in_one_line(refused, message):
    with pytest.raises(ValueError, match=message) as caught:
        refused()
    assert "\n" not in str(caught.value)
