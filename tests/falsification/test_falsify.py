"""`falsify` takes controllers, plants and slips of a user's own, or refuses them in one line."""

import dataclasses
import re
from types import SimpleNamespace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from figure_checks import assert_presentable
from tolerances import FALSIFY_REPLAY

import jaxtube as jt
from jaxtube import results
from jaxtube.control.protocol import Feedback
from jaxtube.falsification.falsify import search_setting
from jaxtube.falsification.setting import find_plan_steps, make_loop_limits, make_setting
from jaxtube.falsification.worst import Worst
from jaxtube.simulation import components
from jaxtube.simulation.usage import Replay


@pytest.fixture(scope="module")
def design(uncertified):
    """Three seconds of the paper's reference."""
    return uncertified("paper", "reference.duration_s=3", "controller.tube=summed")


class Damped:
    """An own controller with a memory, no pytree: u = K e, a little of the last input kept."""

    def __init__(self, design):
        gain = jnp.asarray(design.lqr_gain)
        wheel_map = components.make_wheel_map(design.problem)
        self.feedback = Feedback(lambda errors, wheels: errors @ gain.T, wheel_map)

    def initial(self, errors):
        return jnp.zeros_like(errors[:, :2])

    def act(self, step, memory, measurement, reference_wheels):
        command, _, diagnostics = self.feedback.act(step, (), measurement, reference_wheels)
        inputs = 0.9 * command.inputs + 0.1 * memory
        wheel_map = self.feedback.wheel_map
        return (
            wheel_map.command(inputs, measurement, reference_wheels),
            inputs,
            diagnostics,
        )


@pytest.fixture(scope="module")
def of_own_controller(design):
    return jt.falsify(design, Damped(design), target="error", slip="constant", seconds=0.5)


def test_a_controller_of_ones_own_is_falsified(design, of_own_controller):
    worst = of_own_controller.worst
    assert list(of_own_controller.rows) == ["error"]
    assert worst.limit == "error"
    assert worst.attack["true"].shape == (1, 2)
    row = of_own_controller.rows["error"]
    lap = row.played.trajectory
    E = design.problem.error_set
    usage = lap.errors[1:, 0] @ E.normals.T / E.offsets
    assert np.max(usage) == pytest.approx(worst.usage, abs=FALSIFY_REPLAY)
    assert worst.usage >= row.sampled.usage("error") - FALSIFY_REPLAY


def test_the_verdict_comes_first(of_own_controller):
    shown = repr(of_own_controller).splitlines()
    assert shown[0] == f"<Falsification: {of_own_controller.verdict}"
    assert shown[1].startswith("own on the robot; ")
    assert "certificate of the design's tube-MPC, not of this controller: " in shown[1]
    assert len(shown) == 2


@pytest.fixture
def of_a_tube(design, of_own_controller):
    """Worst cases of a controller that keeps a tube, invented."""
    row = of_own_controller.rows["error"]
    case = row.worst
    worst = Worst("tube", 0.9, 0.1, 2, 0, 1, case.attack)
    search = dataclasses.replace(row.search, worst={"tube": worst}, course=[])
    played = Replay(row.played.trajectory, np.full((design.problem.horizon, 3), 1e-4))
    limits = make_loop_limits(design, "tube_mpc", "robot", ["error", "tube"])
    rows = {"error": row, "tube": row._replace(worst=worst, search=search, played=played)}
    return dataclasses.replace(of_own_controller, limits=limits, rows=rows)


def test_worst_cases_are_drawn(of_own_controller, of_a_tube):
    assert_presentable(of_own_controller.plot())
    assert_presentable(of_a_tube.plot("tube"))
    with pytest.raises(ValueError, match="limit = 'wheels': was not searched"):
        of_a_tube.plot("wheels")


@pytest.mark.parametrize(
    ("facet", "words"),
    [
        (0, "longitudinal error above its limit of 0.3 m by 0.1 m at step 7"),
        (5, "heading error below its limit of -20 deg by 5.73 deg at step 7"),
    ],
)
def test_a_violation_says_on_which_side_of_which_limit(of_own_controller, facet, words):
    row = of_own_controller.rows["error"]
    worst = dataclasses.replace(row.worst, usage=1.5, margin=-0.1, step=7, facet=facet)
    rows = {"error": row._replace(worst=worst)}
    assert dataclasses.replace(of_own_controller, rows=rows).verdict == f"violation found: {words}"


def test_a_violated_tube_names_its_section(of_a_tube):
    row = of_a_tube.rows["tube"]
    worst = dataclasses.replace(row.worst, usage=1.5, margin=-0.1)
    rows = {"tube": row._replace(worst=worst)}
    verdict = dataclasses.replace(of_a_tube, rows=rows).verdict
    assert "beyond its section at stage 1 of the plan of step 1, facet 0 of R_1" in verdict
    # Which facet the search ends at, of a length or of an angle, is for the processor to say.
    assert verdict.endswith((", by 0.1 m at step 2", ", by 5.73 deg at step 2"))


@pytest.mark.parametrize("kind", ["of_own_controller", "of_a_tube"])
def test_worst_cases_are_read_as_they_were_saved(kind, request, design, tmp_path, monkeypatch):
    monkeypatch.setattr(results, "design", lambda scenario: design)
    saved = request.getfixturevalue(kind)
    with jax.enable_x64(False):
        again = jt.read(saved.save(tmp_path))
    assert repr(again) == repr(saved)
    assert again.seed == saved.seed
    assert list(again.rows) == list(saved.rows)
    for name, row in saved.rows.items():
        same = again.rows[name]
        assert_same(same.worst, row.worst)
        assert_same(same.search.worst[name], row.search.worst[name])
        assert same.search.course == row.search.course
        assert same.sampled.laps == row.sampled.laps
        for leaf, other in zip(
            jax.tree.leaves(same.played), jax.tree.leaves(row.played), strict=True
        ):
            np.testing.assert_array_equal(leaf, other)
        assert same.search.reach.keys() == row.search.reach.keys()
        np.testing.assert_array_equal(same.sampled.reach["error"], row.sampled.reach["error"])


def assert_same(worst, other):
    assert worst.attack.keys() == other.attack.keys()
    for name, values in worst.attack.items():
        np.testing.assert_array_equal(values, other.attack[name])
    assert dataclasses.replace(worst, attack={}).__dict__ == {**other.__dict__, "attack": {}}


def test_a_law_that_answers_nan_violates(design):
    def law(errors, reference_wheels):
        broken = jnp.abs(errors[:, :1]) > 0.05
        return jnp.where(broken, jnp.nan, errors[:, :2])

    calls = []
    setting = make_setting(design, law, "exact")
    result = search_setting(setting, "error", seconds=0.1, on_progress=lambda: calls.append(1))
    assert len(calls) == 2
    assert result.is_violated
    assert result.worst.usage == np.inf
    assert result.verdict.startswith("violation found: longitudinal error above its limit of")


def turn_hard(errors, reference_wheels):
    """Keep the caps on u1 and u2 of `certified`, and not the one that couples u2 to e_x."""
    return jnp.stack([-errors[:, 0], jnp.full_like(errors[:, 0], 1.09)], axis=1)


def test_a_law_that_breaks_the_coupling_alone_violates_the_limit_of_inputs(uncertified):
    coupled = uncertified("certified", "reference.duration_s=1")
    rows = coupled.problem.input_rows
    found = jt.falsify(coupled, turn_hard, target="input", seconds=0.2)
    row = found.rows["input"]
    lap = row.played.trajectory
    u = lap.inputs[:, 0]
    assert np.all(coupled.problem.input_set.contains(u))
    used = (u @ rows.inputs.T + lap.measured[:-1, 0] @ rows.errors.T) / rows.offsets
    assert row.worst.usage == pytest.approx(np.max(used), abs=FALSIFY_REPLAY)
    assert row.worst.usage > 1.1
    section = coupled.problem.scenario.operating
    assert -row.worst.margin == pytest.approx(
        (row.worst.usage - 1) * section.turning_yaw_rate_radps, abs=FALSIFY_REPLAY
    )
    assert re.search(
        r"violation found: coupled cap, .* its limit of .* rad/s by .* rad/s at", found.verdict
    )


class Heading(NamedTuple):
    """A plant that can be simulated and not searched."""

    reference_wheels: jnp.ndarray


class Drift:
    """A slip process of ones own."""


@pytest.mark.parametrize(
    ("choices", "fragment"),
    [
        ({"target": "pose"}, "choose one of ['all', 'error', 'input', 'tube']"),
        ({"target": "tube", "controller": "local_gain"}, 'choose "tube_mpc"'),
        ({"target": "tube", "controller": lambda errors, wheels: errors[:, :2]}, "own keeps no"),
        ({"starts": "edge"}, 'choose "scenario" or "feasible"'),
        ({"seconds": 0.0}, "give a positive number"),
        ({"slip": Drift()}, 'slip.process = "Drift": is not searched; choose "iid"'),
        ({"slip": "walk"}, 'slip.process = "walk": is not searched; choose "iid"'),
        ({"plant": Heading(jnp.ones((30, 2)))}, "plant = Heading: has no has_wheels"),
    ],
)
def test_what_cannot_be_searched_is_refused_in_one_line(design, choices, fragment):
    with pytest.raises(ValueError, match=re.escape(fragment)) as refused:
        jt.falsify(design, **choices)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("controller", "plant", "limits"),
    [
        ("tube_mpc", "robot", ["error", "input", "wheels", "tube"]),
        ("tube_mpc", "linear", ["error", "input", "tube"]),
        ("plain_mpc", "robot", ["error", "input", "wheels"]),
    ],
)
def test_limits_are_those_that_the_loop_has(design, controller, plant, limits):
    assert make_setting(design, controller, plant).limits.choose_names("all") == limits


@pytest.mark.parametrize(
    ("duration", "fragment"),
    [
        (0.4, "reference.duration_s = 0.4: 4 steps are fewer than controller.horizon = 5"),
        (None, "reference.file: the 4 steps of the recording are fewer"),
    ],
)
def test_a_reference_shorter_than_the_horizon_is_refused(duration, fragment):
    reference = SimpleNamespace(steps=4)
    scenario = SimpleNamespace(reference=SimpleNamespace(duration_s=duration))
    problem = SimpleNamespace(reference=reference, horizon=5, scenario=scenario)
    with pytest.raises(jt.ScenarioError, match=re.escape(fragment)) as refused:
        find_plan_steps(SimpleNamespace(problem=problem))
    assert "None" not in str(refused.value)
