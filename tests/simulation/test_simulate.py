"""Laws of `simulate`: own controllers, plants and slips, and what it refuses."""

import dataclasses
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tolerances import CLOSED_LOOP

import jaxtube as jt
from jaxtube import qp
from jaxtube.control import mpc
from jaxtube.precision import require_64_bits
from jaxtube.simulation import components

SHORT = "reference.duration_s=2"
LAPS = 4


@pytest.fixture(scope="module")
def design(uncertified):
    return uncertified("certified", SHORT)


@pytest.fixture(scope="module")
def gain_laps(design):
    """Laps of the tube's gain, by name."""
    return jt.simulate(design, "local_gain", laps=LAPS)


class Remembering:
    """The law of `local_gain`, written as a user would: no pytree, and it counts its periods."""

    def __init__(self, design):
        problem = design.problem
        schedule = problem.schedule[: problem.reference.steps]
        self.gains = design.tube_gain.along(schedule)
        self.wheel_map = components.make_wheel_map(problem)

    def initial(self, errors):
        return jnp.zeros(len(errors), errors.dtype)

    def act(self, step, memory, measurement, reference_wheels):
        gain = jnp.asarray(self.gains)[step]
        inputs = measurement.errors @ gain.T
        command = self.wheel_map.command(inputs, measurement, reference_wheels)
        return command, memory + 1, mpc.no_diagnostics(measurement.errors)


def test_an_own_object_drives_as_the_same_law_of_the_library(design, gain_laps):
    own = jt.simulate(design, Remembering(design), laps=LAPS)
    assert own.controller == "own"
    np.testing.assert_allclose(own.errors, gain_laps.errors, rtol=0, atol=CLOSED_LOOP)


def test_an_own_law_is_a_function_of_measured_errors(design):
    K = design.tube_gain.nominal
    laps = jt.simulate(design, lambda errors, wheels: errors @ K.T, laps=LAPS)
    expected = laps.trajectory.measured[:-1] @ K.T
    np.testing.assert_allclose(laps.trajectory.inputs, expected, rtol=0, atol=CLOSED_LOOP)


def test_laps_do_not_depend_on_how_many_there_are(design, gain_laps):
    fewer = jt.simulate(design, "local_gain", laps=2)
    np.testing.assert_array_equal(fewer.errors, gain_laps.errors[:, :2])


@dataclass(frozen=True)
class Worst:
    """Slips at their greatest error, all the time."""

    opposed = False

    def initial(self, key, dtype):
        return ()

    def draw(self, key, step, memory, situation):
        return jnp.ones(2, situation.errors.dtype), memory


def test_an_own_slip_process_moves_the_robot(design, gain_laps):
    pushed = jt.simulate(design, "local_gain", slip=Worst(), laps=LAPS)
    # Without noise all laps would be one: what differs between them is the noise alone.
    assert np.std(pushed.errors[-1], axis=0).max() < np.std(gain_laps.errors[-1], axis=0).max()
    assert np.abs(pushed.errors[-1, :, 0]).min() > 0


@pytest.mark.parametrize(
    ("choices", "words"),
    [
        ({"controller": "mpc"}, "controller = 'mpc': is unknown; choose one of"),
        ({"controller": 3}, "is neither a law"),
        ({"controller": lambda errors, wheels: errors}, r"shape \(batch, 3\)"),
        ({"plant": "car"}, "plant = 'car': is unknown"),
        ({"plant": "linear", "slip": "iid"}, "draws no slips"),
        ({"starts": "somewhere"}, "starts = 'somewhere'"),
        ({"starts": np.zeros(3)}, r"shape \(3,\) is not \(laps, 3\)"),
    ],
)
def test_what_cannot_run_is_refused_in_one_line(design, choices, words):
    with pytest.raises(ValueError, match=words) as refused:
        jt.simulate(design, laps=LAPS, **choices)
    assert "\n" not in str(refused.value)


def test_a_memory_that_changes_its_shape_is_refused(design):
    class Growing(Remembering):
        def act(self, step, memory, measurement, reference_wheels):
            command, memory, diagnostics = super().act(step, memory, measurement, reference_wheels)
            return command, jnp.concatenate([memory, memory]), diagnostics

    with pytest.raises(ValueError, match="a memory of another structure"):
        jt.simulate(design, Growing(design), laps=LAPS)


def test_functions_compute_in_64_bits_and_leave_the_configuration_alone(design, gain_laps):
    with jax.enable_x64(False):
        laps = jt.simulate(design, "local_gain", laps=LAPS)
        assert jnp.zeros(1).dtype == jnp.float32
    assert laps.errors.dtype == np.float64
    np.testing.assert_allclose(laps.errors, gain_laps.errors, rtol=0, atol=CLOSED_LOOP)


def test_a_controller_of_a_design_is_not_built_in_32_bits(design):
    with jax.enable_x64(False):
        with pytest.raises(RuntimeError, match="32 bits"):
            components.make_tube_mpc(design)
        with pytest.raises(RuntimeError, match="enable_x64"):
            require_64_bits("something")


def test_laps_say_what_they_came_to(gain_laps):
    assert repr(gain_laps).startswith(f"<Laps: no lap leaves E in {LAPS}; local_gain on the robot")
    spoilt = gain_laps.trajectory._replace(errors=np.full_like(gain_laps.errors, np.nan))
    lost = jt.Laps(gain_laps.design, "local_gain", "robot", 0, spoilt)
    assert lost.outside == LAPS


def test_laps_say_which_qps_were_not_solved_and_why(gain_laps):
    status = np.array(gain_laps.trajectory.diagnostics.status)
    status[3, :2] = qp.INFEASIBLE
    status[5, 1] = qp.UNSOLVED
    diagnostics = gain_laps.trajectory.diagnostics._replace(status=status)
    trajectory = gain_laps.trajectory._replace(diagnostics=diagnostics)
    laps = dataclasses.replace(gain_laps, trajectory=trajectory)
    verdict, infeasible, unsolved = repr(laps).splitlines()
    assert verdict.endswith("; 3 QPs without a plan")
    assert infeasible == f"2 QPs {qp.describe(qp.INFEASIBLE)}"
    assert unsolved == f"1 QP {qp.describe(qp.UNSOLVED)}>"
    assert repr(gain_laps).endswith("; 0 QPs without a plan>")


def test_laps_become_a_dataset_with_named_dimensions(gain_laps):
    dataset = gain_laps.to_xarray()
    assert dict(dataset.sizes) == {
        "instant": 21,
        "period": 20,
        "lap": LAPS,
        "coordinate": 3,
        "input": 2,
        "wheel": 2,
    }
    lateral = dataset["errors"].sel(coordinate="lateral").values
    np.testing.assert_array_equal(lateral, gain_laps.errors[:, :, 1])
    assert dataset.attrs == {"controller": "local_gain", "plant": "robot", "seed": 0}
