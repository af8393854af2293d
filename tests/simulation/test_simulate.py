"""Laws of `simulate`: own controllers, plants and slips, and what it refuses."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from own_slips import Worst
from tolerances import CLOSED_LOOP

import jaxtube as jt
from jaxtube import qp
from jaxtube.arguments import require_count
from jaxtube.control import mpc
from jaxtube.control.own import adapt_controller
from jaxtube.control.protocol import WheelMap
from jaxtube.precision import require_64_bits
from jaxtube.simulation import components, memory
from jaxtube.simulation.choices import name_controller

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
    assert own.controller == "Remembering"
    np.testing.assert_allclose(own.errors, gain_laps.errors, rtol=0, atol=CLOSED_LOOP)


def test_an_own_law_is_a_function_of_measured_errors(design):
    K = design.tube_gain.nominal
    laps = jt.simulate(design, lambda errors, wheels: errors @ K.T, laps=LAPS)
    expected = laps.trajectory.measured[:-1] @ K.T
    np.testing.assert_allclose(laps.trajectory.inputs, expected, rtol=0, atol=CLOSED_LOOP)


def test_laps_do_not_depend_on_how_many_there_are(design, gain_laps):
    fewer = jt.simulate(design, "local_gain", laps=2)
    np.testing.assert_array_equal(fewer.errors, gain_laps.errors[:, :2])


def test_an_own_slip_process_moves_the_robot(design, gain_laps):
    pushed = jt.simulate(design, "local_gain", slip=Worst(), laps=LAPS)
    # Without noise all laps would be one: what differs between them is the noise alone.
    assert np.std(pushed.errors[-1], axis=0).max() < np.std(gain_laps.errors[-1], axis=0).max()
    assert np.abs(pushed.errors[-1, :, 0]).min() > 0


def gain(errors, reference_wheels):
    """A law with a name."""
    return errors[:, :2]


@pytest.mark.parametrize(
    ("controller", "name"),
    [("tube_mpc", "tube_mpc"), (gain, "gain"), (lambda errors, wheels: errors, "own")],
)
def test_a_controller_has_the_name_that_python_gives_it(controller, name):
    assert name_controller(controller) == name


def take_values(errors, reference_wheels):
    return np.asarray(errors)[:, :2]


def branch(errors, reference_wheels):
    return errors[:, :2] if errors[0, 0] > 0 else -errors[:, :2]


VALUES = "controller: needs the values of its arguments"


@pytest.mark.parametrize(
    ("controller", "words"),
    [
        (3, r"controller = 3: is neither a law nor an object"),
        (lambda errors, wheels: errors, r"returns shape \(batch, 3\)"),
        (lambda errors, wheels: 0.0, r"returns shape \(\)"),
        (lambda errors, wheels: None, "returns None"),
        (lambda errors, wheels: (errors[:, 0], errors[:, 1]), r"returns \(shape \(batch,\)"),
        (lambda errors: errors[:, :2], "raises TypeError: .* takes 1 positional argument"),
        (lambda errors, wheels: unknown, "raises NameError"),
        (take_values, VALUES),
        (branch, VALUES),
    ],
)
def test_what_is_no_law_is_refused_with_what_a_law_must_be(controller, words):
    with pytest.raises(ValueError, match=words) as refused:
        adapt_controller(controller, WheelMap(track_width=0.5, dt=0.1))
    told = str(refused.value)
    assert "\n" not in told and "to inputs (batch, 2), in jax.numpy" in told


class Answering:
    """An own object whose `act` returns whatever it is told to."""

    def __init__(self, make_answer):
        self.make_answer = make_answer

    def initial(self, errors):
        return ()

    def act(self, step, memory, measurement, reference_wheels):
        return self.make_answer(measurement.errors)


@pytest.mark.parametrize(
    ("make_answer", "words"),
    [
        (lambda errors: errors[:, :2], r"returns shape \(batch, 2\); return \(jaxtube.Command"),
        (lambda errors: (errors[:, :2], (), None), "return"),
        (
            lambda errors: (jt.Command(errors, errors), (), mpc.no_diagnostics(errors)),
            r"returns inputs of shape \(batch, 3\)",
        ),
    ],
)
def test_an_object_that_answers_something_else_is_refused(make_answer, words):
    with pytest.raises(ValueError, match=words) as refused:
        adapt_controller(Answering(make_answer), WheelMap(track_width=0.5, dt=0.1))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("laps", [0, -1, 2.5, np.nan, np.inf, True, "4", [4]])
def test_laps_are_counted_in_whole_numbers_from_1_up(laps):
    with pytest.raises(ValueError, match="is no whole number from 1 up"):
        require_count("laps", laps)


@pytest.mark.parametrize("laps", [100, 1e2, np.int32(100), np.float64(100)])
def test_whole_numbers_of_any_type_are_taken(laps):
    count = require_count("laps", laps)
    assert count == 100 and type(count) is int


def test_laps_beyond_the_memory_of_the_machine_are_refused_with_what_fits(monkeypatch):
    periods = 300
    monkeypatch.setattr(memory, "find_memory", lambda: 16e9)
    with pytest.raises(ValueError, match="laps = 1000000000: the laps kept need about") as refused:
        memory.refuse_laps_beyond_memory(10**9, periods)
    told = str(refused.value)
    assert "jt.montecarlo, which keeps counts alone" in told and "16 GB here" in told
    most = int(told.split("at most ")[1].split(", or")[0].replace(",", ""))
    memory.refuse_laps_beyond_memory(most, periods)
    with pytest.raises(ValueError, match="the laps kept need"):
        memory.refuse_laps_beyond_memory(most + 1, periods)


def test_the_memory_that_laps_need_is_estimated_from_what_they_keep(gain_laps):
    kept = sum(array.nbytes for array in gain_laps.trajectory.arrays().values())
    periods = len(gain_laps.errors)
    assert kept <= LAPS * periods * memory.BYTES_A_PERIOD <= 1.05 * kept


def test_the_memory_of_a_container_counts(monkeypatch, tmp_path):
    limit = tmp_path / "memory.max"
    monkeypatch.setattr(memory, "CGROUP", limit)
    installed = memory.find_memory()
    for text in ("max", ""):
        limit.write_text(text)
        assert memory.find_memory() == installed
    limit.write_text("1000000\n")
    assert memory.find_memory() == 1e6


@pytest.mark.parametrize(
    ("choices", "words"),
    [
        ({"controller": "mpc"}, "controller = 'mpc': is unknown; choose one of"),
        ({"controller": lambda errors, wheels: errors}, r"shape \(batch, 3\)"),
        ({"laps": 0}, "laps = 0: is no whole number"),
        ({"laps": 10**12}, "laps = 1000000000000: the laps kept need about"),
        ({"plant": "car"}, "plant = 'car': is unknown"),
        ({"plant": "linear", "slip": "iid"}, "draws no slips"),
        ({"starts": "somewhere"}, "starts = 'somewhere'"),
        ({"starts": np.zeros(3)}, r"shape \(3,\) is not \(laps, 3\)"),
        ({"starts": np.zeros((0, 3))}, r"shape \(0, 3\) is not \(laps, 3\)"),
        ({"starts": np.zeros((3, 3))}, "laps = 4: starts has 3 rows; leave laps out"),
        ({"starts": [[0, 0, 0], [0, np.nan, 0]]}, r"starts\[1\] = \[ 0. nan  0.\]: is not finite"),
    ],
)
def test_what_cannot_run_is_refused_in_one_line(design, choices, words):
    with pytest.raises(ValueError, match=words) as refused:
        jt.simulate(design, **{"laps": LAPS, **choices})
    assert "\n" not in str(refused.value)


def test_starts_given_one_by_one_say_how_many_laps_there_are(design):
    laps = jt.simulate(design, "local_gain", starts=np.zeros((2, 3)), name="gain")
    assert laps.errors.shape[1] == 2
    assert laps.controller == "gain"


@pytest.mark.parametrize("function", [jt.simulate, jt.montecarlo, jt.falsify])
@pytest.mark.parametrize(
    ("value", "words"),
    [
        (jt.load("certified"), r"design: is a Scenario; give jt.design\(scenario\)"),
        ("certified", r"design = 'certified': is a name; give jt.design\(jt.load\('certified'\)\)"),
        (None, r"design: is a NoneType"),
    ],
)
def test_what_is_no_design_is_refused(function, value, words):
    with pytest.raises(ValueError, match=words):
        function(value)


@pytest.mark.parametrize("other", ["tube_mpc", 3])
def test_only_laps_are_drawn_beside_laps(gain_laps, other):
    with pytest.raises(ValueError, match=r"is not Laps; give jt\.simulate"):
        gain_laps.plot(other)


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
    assert repr(gain_laps).startswith(
        f"<Laps: 0 of {LAPS} laps leave E; local_gain on the robot; RMS"
    )
    spoilt = gain_laps.trajectory._replace(errors=np.full_like(gain_laps.errors, np.nan))
    lost = jt.Laps(gain_laps.design, "local_gain", "robot", 0, spoilt)
    assert lost.outside == LAPS
    assert repr(lost).startswith(f"<Laps: {LAPS} of {LAPS} laps leave E")
    assert f"errors are not finite from step 0 in {LAPS} laps" in repr(lost)


def test_laps_say_since_when_inputs_are_not_finite(gain_laps):
    inputs = np.array(gain_laps.trajectory.inputs)
    inputs[7:, 1:3, 0] = np.nan
    inputs[9:, 3] = np.inf
    trajectory = gain_laps.trajectory._replace(inputs=inputs)
    laps = dataclasses.replace(gain_laps, trajectory=trajectory)
    assert "; inputs are not finite from step 7 in 3 laps; " in repr(laps)
    assert "RMS" not in repr(laps)


def test_laps_of_the_linear_plant_are_judged_by_the_caps_alone(design, gain_laps):
    """It is measured without noise, so the theorem is about what the controller keeps of E."""
    caps = design.problem.operating_set.offsets[:3]
    between = caps + design.problem.noise / 2
    errors = np.zeros_like(gain_laps.errors)
    errors[3, 0] = [0.0, between[1], 0.0]
    trajectory = gain_laps.trajectory._replace(errors=errors)
    on_robot = dataclasses.replace(gain_laps, trajectory=trajectory)
    on_model = dataclasses.replace(on_robot, plant="linear")
    assert on_robot.outside == 0
    assert on_model.outside == 1
    np.testing.assert_array_equal(on_model.error_limits, caps)
    np.testing.assert_allclose(on_robot.error_limits, caps + design.problem.noise)


def test_laps_say_which_qps_were_not_solved_and_why(gain_laps):
    status = np.array(gain_laps.trajectory.diagnostics.status)
    status[3, :2] = qp.INFEASIBLE
    status[5, 1] = qp.UNSOLVED
    diagnostics = gain_laps.trajectory.diagnostics._replace(status=status)
    trajectory = gain_laps.trajectory._replace(diagnostics=diagnostics)
    laps = dataclasses.replace(gain_laps, trajectory=trajectory, solves_qp=True)
    verdict, infeasible, unsolved = repr(laps).splitlines()
    assert verdict.endswith("; 3 QPs without a plan")
    assert infeasible == f"2 QPs {qp.describe(qp.INFEASIBLE)}"
    assert unsolved == f"1 QP {qp.describe(qp.UNSOLVED)}>"
    planned = dataclasses.replace(gain_laps, solves_qp=True)
    assert repr(planned).endswith("; 0 QPs without a plan>")


def test_of_controllers_that_solve_no_qp_none_is_told(design, gain_laps):
    of_law = jt.simulate(design, lambda errors, wheels: errors[:, :2], laps=2)
    for laps in (gain_laps, of_law):
        assert "QP" not in repr(laps)
    of_object = jt.simulate(design, Remembering(design), laps=2)
    assert repr(of_object).endswith("; 0 QPs without a plan>")


def test_laps_name_the_limits_that_they_are_judged_by(gain_laps):
    """Caps and pose noise: narrower than [constraints], with which they are easily confused."""
    along, across, heading = gain_laps.design.problem.error_set.offsets[:3]
    limits = f"|e_x| {along:.3g} m, |e_y| {across:.3g} m, |e_th| {np.rad2deg(heading):.3g} deg"
    assert f"E is {limits}" in repr(gain_laps)


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
