"""Laws of a scenario's tuner: what has no design, what a judgement depends on, and which draws it
uses."""

import dataclasses

import jax
import numpy as np
import pytest
import stand_ins
import tuned

from jaxtube.scenario import ScenarioError
from jaxtube.simulation import components
from jaxtube.synthesis.design import finish, prepare, refuse_infeasible_start
from jaxtube.synthesis.problem import with_controller
from jaxtube.tuning import tuner as tuners
from jaxtube.tuning.objective import make_aim
from jaxtube.tuning.parameters import make_parameters
from jaxtube.tuning.tuner import COMPARED, HELD_OUT, NO_DESIGN, Tuner

LAPS = 4  # held-out ones too: one shape, one compilation


def make(problem):
    plant = tuned.shortened(components.robot_of(problem), 12)
    aim = make_aim(problem.scenario, 5)
    return Tuner(problem, plant, make_parameters(problem), aim, LAPS, LAPS)


def fresh(tuner, **changes):
    """Return a tuner that has seen nothing."""
    return dataclasses.replace(tuner, **changes)


@pytest.fixture(
    scope="module", params=["no_laps", pytest.param("true_laps", marks=pytest.mark.slow)]
)
def tuner(request):
    """A tuner that compiles nothing, and one that runs its laps."""
    with pytest.MonkeyPatch.context() as patch:
        if request.param == "no_laps":
            stand_ins.patch_tuner(patch)
        yield make(tuned.problem_of("decoupled"))


def moved(tuner, **factors):
    """Return the start with some parameters multiplied, those that count by their logarithms."""
    point = tuner.parameters.vector.copy()
    for name, factor in factors.items():
        point[tuner.parameters.free_names.index(name)] += np.log(factor)
    return point


WITHOUT_DESIGN = {
    "weak gains": (dict(k1=1e-3, k2=1e-3, k3=1e-3), ""),
    "unbounded": (dict(k2=0.02), "is not bounded"),
    "unstable": (dict(k1=3.0, k3=3.0), "share no quadratic cost"),
    "sets left empty": (dict(k1=1.9), "U_3 is empty"),
    "weights without end": (dict(Q11=1e200), ""),
}


@pytest.mark.parametrize("name", list(WITHOUT_DESIGN))
def test_what_has_no_design_says_why_and_is_worth_no_design(tuner, name):
    factors, told = WITHOUT_DESIGN[name]
    point = moved(tuner, **factors)
    candidate = tuner.candidate(point)
    assert candidate.constants is None and candidate.reason and told in candidate.reason
    value, gradient = tuner.evaluate(point, 0)
    assert value == tuner.value(point, 1) == NO_DESIGN and np.isfinite(NO_DESIGN)
    np.testing.assert_array_equal(gradient, np.zeros_like(point))
    judgement = tuner.inspect(point)
    assert judgement.held_out == np.inf and not judgement.certified and not judgement.has_laps
    assert judgement.failing == (candidate.reason,)
    with pytest.raises(ValueError, match="has no closed loop"):
        tuner.controller(point)


def test_a_judgement_is_a_function_of_the_point_alone(tuner):
    point = moved(tuner, Q11=2.0, R22=0.5)
    first = tuner.inspect(point)
    tuner.candidate(tuner.parameters.vector)
    tuner.value(point, 3)
    for other in (tuner.inspect(point.copy()), fresh(tuner).inspect(point)):
        assert other.failing == first.failing
        jax.tree.map(np.testing.assert_array_equal, other.arrays(), first.arrays())
    assert tuner.compare(point, LAPS).held_out != first.held_out != tuner.value(point, 0)


def test_a_point_that_changes_afterwards_is_another_point(tuner):
    point = tuner.parameters.vector.copy()
    value = tuner.value(point, 0)
    point += 0.1
    changed = tuner.value(point, 0)
    assert changed != value
    assert fresh(tuner).value(point, 0) == changed


def test_values_are_functions_of_point_and_index_of_draws(tuner):
    point = tuner.parameters.vector
    values = [tuner.value(point, draws) for draws in (0, 1, 2, 0)]
    assert len(set(values)) == 3 and values[0] == values[3]
    assert fresh(tuner, seed=1).value(point, 0) != values[0]


class Recorder:
    """The compiled programs of a tuner, which record the keys of each use."""

    def __init__(self):
        self.use = ""
        self.keys = {}

    def record(self, lap_inputs):
        data = np.asarray(jax.random.key_data(lap_inputs.keys)).tolist()
        self.keys.setdefault(self.use, []).extend(map(tuple, data))

    def run_laps(self, vector, constants, lap_inputs, *rest):
        self.record(lap_inputs)
        return stand_ins.run_laps(vector, constants, lap_inputs)

    def value_and_gradient(self, vector, constants, lap_inputs, *rest):
        self.record(lap_inputs)
        return 0.0, vector


def test_no_two_uses_share_a_realisation(tuner, monkeypatch):
    recorder = Recorder()
    monkeypatch.setattr(tuners, "_run_laps", recorder.run_laps)
    monkeypatch.setattr(tuners, "_value_and_gradient", recorder.value_and_gradient)
    tuner = fresh(tuner, laps=5, held_out=7)
    point = tuner.parameters.vector
    for draws in (0, 1, 2, 10**9):
        recorder.use = f"value {draws}"
        tuner.value(point, draws)
    recorder.use = "held out"
    tuner.inspect(point)
    recorder.use = "compared"
    tuner.compare(point, 9)
    assert [len(keys) for keys in recorder.keys.values()] == [5, 5, 5, 5, 10, 10]
    everything = [key for keys in recorder.keys.values() for key in keys]
    assert len(set(everything)) == len(everything)
    # Descents draw the same laps for value and gradient.
    recorder.use = "gradient"
    tuner.evaluate(point, 2)
    assert recorder.keys["gradient"] == recorder.keys["value 2"]
    assert HELD_OUT + 2**32 < COMPARED


def slow(case):
    return pytest.param(case, marks=pytest.mark.slow)


CERTIFIED = {
    "the start": {},
    "other weights": dict(Q11=3.0, R22=2.0),
    "weaker gains": dict(k1=0.6),
    "less": dict(k3=0.8),
}


@pytest.mark.parametrize(
    "name", ["the start", "weaker gains", *map(slow, ("other weights", "less"))]
)
def test_is_certified_where_the_certificate_holds_and_the_start_has_a_plan(tuner, name):
    point = moved(tuner, **CERTIFIED[name])
    scenario = tuner.parameters.scenario(tuner.problem.scenario, point)
    design = finish(prepare(with_controller(tuner.problem, scenario)))
    failing = set(design.certificate.failing)
    try:
        refuse_infeasible_start(design)
    except ScenarioError:
        failing.add("start_has_a_plan")
    judgement = tuner.inspect(point)
    assert judgement.certified == (not failing)
    assert set(judgement.failing) == failing
    if name in ("the start", "other weights"):
        assert judgement.certified


def test_a_start_without_plan_is_not_certified(tuner):
    far = 0.99 * tuner.problem.operating_set.offsets[:3]
    problem = dataclasses.replace(tuner.problem, initial_error=far)
    judgement = fresh(tuner, problem=problem).inspect(tuner.parameters.vector)
    assert not judgement.certified and judgement.failing == ("start_has_a_plan",)


@pytest.mark.parametrize(
    "tuner", [pytest.param("true_laps", marks=pytest.mark.slow)], indirect=True
)
def test_evaluation_is_the_value_and_the_slope_of_it(tuner):
    point = tuner.parameters.vector
    value, gradient = tuner.evaluate(point, 4)
    assert value == pytest.approx(tuner.value(point, 4), rel=1e-12)
    k = tuner.parameters.free_names.index("Q22")
    step = 1e-4 * np.eye(len(point))[k]
    above = tuner.value(point + step, 4)
    below = tuner.value(point - step, 4)
    assert gradient[k] == pytest.approx((above - below) / 2e-4, rel=1e-5)
