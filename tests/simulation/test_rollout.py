"""Laws of the closed loops: exact motion, draws by index, wheels that saturate, slip and noise
within bounds."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from doubtful import Doubtful
from oracles import PlainMpc
from scipy.integrate import solve_ivp
from tolerances import CLOSED_LOOP, ROUNDING, WORLD_FRAME

from jaxtube import qp
from jaxtube.plant.slip_bounds import near_nominal
from jaxtube.simulation import batches, components
from jaxtube.simulation.rollout import realisation_keys, rollout, run_laps

BATCH = batches.BATCH
DT = 0.1
TRACK_WIDTH = 0.5
STEPS = 300


@pytest.fixture(scope="module")
def paper_controllers(paper_design):
    return components.controllers(paper_design)


@pytest.fixture(scope="module")
def paper_plant(paper_design):
    return components.slipping_robot(paper_design)


@pytest.fixture(scope="module")
def tracked(paper_design, paper_controllers, paper_plant):
    """256 laps of the linear law with slip compensation: the controller that compiles fastest."""
    starts = np.tile(paper_design.problem.initial_error, (BATCH, 1))
    return batches.run_realisations(paper_controllers["compensated"], paper_plant, starts, 0)


# ------------------------------------------------------------------------------- the short program


def test_laps_that_the_short_program_leaves_are_those_of_the_whole_one(
    paper_controllers, paper_plant
):
    whole = Doubtful(paper_controllers["compensated"], jnp.array(0.1))
    starts = jnp.array([[0.0, 0.0, 0.0], [0.0, 0.15, 0.0], [0.05, 0.0, 0.0]])
    arguments = (paper_plant, realisation_keys(0, 0, len(starts)), starts)
    found = run_laps(whole, *arguments)
    expected = rollout(whole, *arguments)
    short = rollout(whole.without_rounds(), *arguments)
    left = np.asarray(short.diagnostics.status == qp.UNSOLVED).any(axis=0)
    assert left.tolist() == [False, True, False]
    assert not np.any(found.diagnostics.status == qp.UNSOLVED)
    for name in ("errors", "wheels", "inputs"):
        part, of_whole, of_short = (getattr(laps, name) for laps in (found, expected, short))
        np.testing.assert_array_equal(part[:, left], of_whole[:, left])
        np.testing.assert_array_equal(part[:, ~left], of_short[:, ~left])
        assert not np.array_equal(part[:, ~left], of_whole[:, ~left])


# --------------------------------------------------------------------------------- world-frame laps


def eight(step):
    """Reference wheel speeds (right, left) of the two circles of 2.5 m at 1.36 m/s."""
    turn = 1.36 / 2.5 * (1 if int(step * 1.36 * DT / (2 * np.pi * 2.5)) % 2 == 0 else -1)
    return np.array([1.36 + turn * TRACK_WIDTH / 2, 1.36 - turn * TRACK_WIDTH / 2])


def tracking_law(error, reference):
    """The linear law with double poles at 0.6 rad/s: k1 = k3 = 2 a, k2 = (a^2 - Om^2) / V."""
    speed = reference.mean()
    turn = (reference[0] - reference[1]) / TRACK_WIDTH
    return np.array([-1.2 * error[0], -(0.36 - turn**2) / speed * error[1] - 1.2 * error[2]])


def plain_controllers(design):
    """(virtual input as a function of step and error, slip it compensates) by name."""
    tube = PlainMpc(design)
    plain = PlainMpc(design, with_tube=False)
    return {
        "uncompensated": (lambda step, error: tracking_law(error, eight(step)), 0.0),
        "compensated": (lambda step, error: tracking_law(error, eight(step)), 0.2),
        "tube_mpc": (lambda step, error: tube.qp(step).plan(error)[0][0], 0.2),
        "plain_mpc": (lambda step, error: plain.qp(step).plan(error)[0][0], 0.2),
    }


def error_in_robot_frame(robot, reference):
    """Eq. (3), robots along the last axis."""
    (x, y) = reference[:2] - robot[:2]
    phi = robot[2]
    return np.stack(
        [np.cos(phi) * x + np.sin(phi) * y, -np.sin(phi) * x + np.cos(phi) * y, reference[2] - phi]
    )


def unicycles(poses, speeds, turns):
    """Rates of the poses (x, y, phi) of many unicycles."""
    return np.stack([speeds * np.cos(poses[2]), speeds * np.sin(poses[2]), turns + 0 * poses[2]])


def world_frame_lap(controllers, cosine_free=False):
    """Integrate robots, the last unicycle being the reference, with wheels held over each period
    and slip 0.2 known.

    Returns the errors (steps + 1, 3, robots).
    """
    count = len(controllers)
    poses = np.zeros((3, count + 1))
    poses[:2, :count] = 0.1
    errors = [error_in_robot_frame(poses[:, :count], poses[:, count:])]
    for step in range(STEPS):
        reference = eight(step)
        speeds = []
        turns = []
        for (control, compensated), error in zip(controllers, errors[-1].T, strict=True):
            u1, u2 = control(step, error)
            u1 += reference.mean() * (1 - np.cos(error[2])) if cosine_free else 0
            deficits = np.array([u1 + TRACK_WIDTH / 2 * u2, u1 - TRACK_WIDTH / 2 * u2])
            ground = np.clip((reference - deficits) / (1 - compensated), -3, 3) * (1 - 0.2)
            speeds.append(ground.mean())
            turns.append((ground[0] - ground[1]) / TRACK_WIDTH)
        speeds = np.append(speeds, reference.mean())
        turns = np.append(turns, np.diff(reference[::-1]) / TRACK_WIDTH)
        rate = lambda t, flat, v=speeds, w=turns: unicycles(flat.reshape(3, -1), v, w).ravel()  # noqa: E731
        poses = (
            solve_ivp(rate, (0, DT), poses.ravel(), "DOP853", rtol=1e-12, atol=1e-13)
            .y[:, -1]
            .reshape(3, -1)
        )
        errors.append(error_in_robot_frame(poses[:, :count], poses[:, count:]))
    return np.array(errors)


def test_noise_free_laps_are_those_of_a_world_frame_simulation(paper_design, paper_controllers):
    plant = components.exact_robot(paper_design)
    start = paper_design.problem.initial_error[None]
    controllers = plain_controllers(paper_design)
    expected = world_frame_lap(controllers.values())
    for number, name in enumerate(controllers):
        errors = batches.run_realisations(paper_controllers[name], plant, start, 0).errors[:, 0]
        np.testing.assert_allclose(errors, expected[:, :, number], atol=WORLD_FRAME, err_msg=name)


@pytest.mark.slow
def test_a_cosine_free_lap_with_the_exact_model_is_that_of_a_world_frame_simulation(uncertified):
    settings = (
        "input_map=cosine_free",
        "model=consistent",
        "discretisation=zoh",
        "tube=summed",
        "lmi_objective=logdet",
    )
    design = uncertified("robust", *(f"controller.{setting}" for setting in settings))
    plain = plain_controllers(design)["tube_mpc"]
    expected = world_frame_lap([plain], cosine_free=True)[:, :, 0]
    controller = components.controllers(design)["tube_mpc"]
    start = design.problem.initial_error[None]
    errors = batches.run_realisations(controller, components.exact_robot(design), start, 0).errors[
        :, 0
    ]
    np.testing.assert_allclose(errors, expected, atol=WORLD_FRAME)


# ------------------------------------------------------------------------------ indices and batches


def test_a_trajectory_has_time_first_then_realisations_and_starts_at_the_start(
    paper_design, paper_laps
):
    t = paper_laps
    assert t.errors.shape == t.measured.shape == (STEPS + 1, BATCH, 3)
    assert t.inputs.shape == t.wheels.shape == t.demanded.shape == (STEPS, BATCH, 2)
    assert {field.shape for field in t.diagnostics} == {(STEPS, BATCH)}
    np.testing.assert_array_equal(
        t.errors[0], np.tile(paper_design.problem.initial_error, (BATCH, 1))
    )


def test_a_realisation_does_not_depend_on_its_companions(robust_design, stressed, edge_starts):
    """The same keys and starts in reverse order: other neighbours in every block that the solver
    gathers."""
    controller = components.controllers(robust_design)["tube_mpc"]
    plant = components.linear_plant(robust_design)
    order = np.random.default_rng(1).permutation(BATCH)
    starts = edge_starts(robust_design, BATCH)
    mixed = run_laps(
        controller, plant, realisation_keys(5, 0, BATCH)[order], jnp.asarray(starts[order])
    )
    np.testing.assert_allclose(
        mixed.errors, stressed["tube_mpc"].errors[:, order], atol=CLOSED_LOOP
    )
    np.testing.assert_array_equal(
        mixed.diagnostics.active, stressed["tube_mpc"].diagnostics.active[:, order]
    )


def check_alone(loop, plant, trajectory, seed, run):
    alone = rollout(
        loop, plant, realisation_keys(seed, run, 1), jnp.asarray(trajectory.errors[0, run])[None]
    )
    np.testing.assert_allclose(alone.errors[:, 0], trajectory.errors[:, run], atol=CLOSED_LOOP)


def test_a_realisation_alone_is_the_one_in_the_batch(paper_controllers, paper_plant, tracked):
    check_alone(paper_controllers["compensated"], paper_plant, tracked, 0, 37)


@pytest.mark.slow
def test_a_realisation_of_the_mpc_alone_is_the_one_in_the_batch(robust_design, stressed):
    controller = components.controllers(robust_design)["tube_mpc"]
    plant = components.linear_plant(robust_design)
    busiest = int(stressed["tube_mpc"].diagnostics.active.sum(axis=0).argmax())
    check_alone(controller, plant, stressed["tube_mpc"], 5, busiest)


def test_longer_runs_begin_with_the_shorter_ones_and_go_on_by_index(
    paper_controllers, paper_plant, tracked
):
    starts = np.tile(tracked.errors[0, 0], (BATCH + 5, 1))
    longer = batches.run_realisations(paper_controllers["compensated"], paper_plant, starts, 0)
    np.testing.assert_array_equal(longer.errors[:, :BATCH], tracked.errors)
    direct = rollout(
        paper_controllers["compensated"],
        paper_plant,
        realisation_keys(0, 5, BATCH),
        jnp.asarray(starts[5:]),
    )
    np.testing.assert_array_equal(longer.errors[:, BATCH:], direct.errors[:, BATCH - 5 :])
    finals = longer.errors[-1, :, 1]
    assert len(np.unique(finals)) == BATCH + 5


def test_seeds_reproduce_and_differ(paper_controllers, paper_plant, tracked):
    starts = tracked.errors[0]
    again = batches.run_realisations(paper_controllers["compensated"], paper_plant, starts, 0)
    other = batches.run_realisations(paper_controllers["compensated"], paper_plant, starts, 1)
    np.testing.assert_array_equal(again.errors, tracked.errors)
    assert np.all(np.any(other.errors[1:] != tracked.errors[1:], axis=(0, 2)))


def test_keys_follow_the_index_beyond_32_bits():
    def find_words(first, count):
        return np.asarray(jax.random.key_data(realisation_keys(3, first, count)))

    across = find_words(2**32 - 2, 4)
    low = find_words(0, 4)
    high = find_words(2**32, 1)
    np.testing.assert_array_equal(across[2:3], high)
    assert len(np.unique(np.concatenate([across, low]), axis=0)) == 8


def test_progress_counts_every_run(paper_controllers, paper_plant, tracked):
    counts = []
    batches.run_realisations(
        paper_controllers["compensated"],
        paper_plant,
        np.tile(tracked.errors[0, 0], (BATCH + 5, 1)),
        0,
        counts.append,
    )
    assert counts == [BATCH, 5]


# ----------------------------------------------------------------------------------- slipping robot


def ground_speeds(trajectory, reference):
    """Yaw rates of the robots from the headings alone: e_th+ = e_th + T (Om - w)."""
    turns = (reference[:STEPS, 0] - reference[:STEPS, 1]) / TRACK_WIDTH
    return turns[:, None] - np.diff(trajectory.errors[..., 2], axis=0) / DT


def test_the_true_slip_stays_within_its_bounds_of_the_measured_one(paper_design, tracked):
    """Per wheel ground = wheel (1 - i); the yaw rate tells (ground_r - ground_l) / b, hence bounds
    on it."""
    yaw = ground_speeds(tracked, paper_design.problem.schedule)
    right, left = np.moveaxis(tracked.wheels, -1, 0)
    most = (right * 0.82 - left * 0.78) / TRACK_WIDTH
    least = (right * 0.78 - left * 0.82) / TRACK_WIDTH
    assert np.all((least - ROUNDING <= yaw) & (yaw <= most + ROUNDING))
    spread = (yaw - least) / (most - least)
    assert spread.min() < 0.05 and spread.max() > 0.95


@pytest.mark.parametrize(
    ("uncertain_slip", "least", "most"), [("true", 0.2, 0.2), ("measured", 0.18, 0.22)]
)
def test_wheels_are_commanded_with_the_measured_slip(
    paper_design, paper_controllers, paper_plant, tracked, uncertain_slip, least, most
):
    """Eqs. (7)-(8) solved for the slip that the controller divides by."""
    slips = near_nominal(np.array([0.2, 0.2]), 0.1, uncertain_slip)
    plant = dataclasses.replace(paper_plant, slips=slips)
    trajectory = batches.run_realisations(
        paper_controllers["compensated"], plant, tracked.errors[0], 0
    )
    deficits = trajectory.inputs @ np.array([[1, 1], [TRACK_WIDTH / 2, -TRACK_WIDTH / 2]])
    slips = 1 - (paper_design.problem.schedule[:STEPS, None] - deficits) / trajectory.demanded
    assert slips.min() >= least - ROUNDING and slips.max() <= most + ROUNDING
    assert np.ptp(slips) >= 0.99 * (most - least)


def test_without_compensation_wheels_ignore_the_slip(
    paper_design, paper_controllers, paper_plant, tracked
):
    trajectory = batches.run_realisations(
        paper_controllers["uncompensated"], paper_plant, tracked.errors[0], 0
    )
    deficits = trajectory.inputs @ np.array([[1, 1], [TRACK_WIDTH / 2, -TRACK_WIDTH / 2]])
    expected = paper_design.problem.schedule[:STEPS, None] - deficits
    np.testing.assert_allclose(trajectory.demanded, expected, atol=1e2 * ROUNDING)


def test_wheels_saturate_and_the_robot_moves_as_they_do(
    paper_design, paper_controllers, paper_plant, tracked
):
    slow = dataclasses.replace(paper_plant.robot, wheel_speed_max=1.7, wheel_speed_min=1.5)
    plant = dataclasses.replace(paper_plant, robot=slow, slips=paper_plant.slips.without_errors())
    trajectory = batches.run_realisations(
        paper_controllers["compensated"], plant, tracked.errors[0], 0
    )
    np.testing.assert_array_equal(trajectory.wheels, np.clip(trajectory.demanded, 1.5, 1.7))
    assert np.mean(trajectory.demanded > 1.7) > 0.1
    moved = ground_speeds(trajectory, paper_design.problem.schedule)
    right, left = np.moveaxis(0.8 * trajectory.wheels, -1, 0)
    np.testing.assert_allclose(moved, (right - left) / TRACK_WIDTH, atol=1e2 * ROUNDING)


def test_controllers_see_the_error_with_noise_within_its_bounds(
    paper_controllers, paper_plant, tracked
):
    bounds = np.array([0.01, 0.02, 0.03])
    noisy = dataclasses.replace(paper_plant, noise=jnp.asarray(bounds))
    trajectory = batches.run_realisations(
        paper_controllers["local_gain"], noisy, tracked.errors[0], 0
    )
    noise = (trajectory.measured - trajectory.errors) / bounds
    assert np.abs(noise).max() <= 1 and np.all(np.abs(noise).max(axis=(0, 1)) > 0.99)
    assert np.all(np.abs(noise.mean(axis=(0, 1))) < 0.01) and np.all(
        noise.reshape(-1, 3).std(axis=0) > 0.57
    )
    gains = np.asarray(paper_controllers["local_gain"].gains)
    np.testing.assert_allclose(
        trajectory.inputs,
        np.einsum("kij,kbj->kbi", gains, trajectory.measured[:-1]),
        atol=CLOSED_LOOP,
    )
    np.testing.assert_array_equal(tracked.measured, tracked.errors)
