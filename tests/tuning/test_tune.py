"""Laws of `tune`: it returns the best certified iterate, designed anew, and says so in a line."""

import dataclasses
import re

import jax.numpy as jnp
import numpy as np
import pytest
import stand_ins
from figure_checks import assert_presentable

import jaxtube as jt
from jaxtube.scenario import ScenarioError, load
from jaxtube.synthesis.disturbance import complete_problem
from jaxtube.tuning.run import NoProgress, Settings
from jaxtube.tuning.tune import assumption, run_tuner, tune
from jaxtube.tuning.tuner import make_tuner
from jaxtube.tuning.watch import Stop

SHORT = ("reference.duration_s=3", "controller.tracking_gains=[3.0,6.5,6.5]")
FEW = {"laps": 4, "held_out": 4}


class Recorder(NoProgress):
    """Progress that counts."""

    def __init__(self):
        self.evaluations = 0
        self.best = []

    def on_evaluation(self):
        self.evaluations += 1

    def on_iterate(self, judgement, is_best):
        if is_best:
            self.best.append(judgement)


@pytest.fixture(scope="module")
def progress():
    return Recorder()


@pytest.fixture(scope="module")
def result(progress):
    """A start that is certified, tuned on laps that cost nothing."""
    with pytest.MonkeyPatch.context() as patch:
        stand_ins.patch_tuner(patch)
        tuner = make_tuner(load("untuned", SHORT), **FEW)
        return run_tuner(tuner, Settings(method="adam", evaluations=2), progress=progress)


@pytest.fixture(scope="module")
def uncertified():
    """A start that is not certified, and that a single step leaves so."""
    with pytest.MonkeyPatch.context() as patch:
        stand_ins.patch_tuner(patch)
        scenario = load("untuned", SHORT[:1])
        return tune(scenario, method="adam", evaluations=1, **FEW)


def test_the_best_certified_iterate_is_returned(result):
    held_out = [judgement.held_out for judgement in result.descent.judged]
    certified = result.descent.certified
    assert certified.any() and len(held_out) == 3
    assert result.best.held_out == np.min(np.array(held_out)[certified])
    weights = result.tuner.parameters.weights(jnp.asarray(result.best.point))
    np.testing.assert_array_equal(result.scenario.controller.tracking_gains, weights.kappa)
    assert result.start is result.descent.judged[0] and result.best is not result.start


def test_its_design_is_that_of_its_scenario_and_certified(result):
    assert result.is_certified and result.failing == () and result.is_rechecked
    assert result.design.problem.scenario == result.scenario
    assert result.design.certificate.holds_for_robot


def test_progress_is_told_of_every_evaluation_and_every_better_certified_iterate(result, progress):
    assert progress.evaluations == result.descent.outcome.evaluations == 2
    held_out = [judgement.held_out for judgement in progress.best]
    assert held_out == sorted(held_out, reverse=True)
    assert progress.best[-1] is result.best


def test_a_result_says_its_verdict_first_and_in_one_line(result):
    text = repr(result)
    assert text.startswith("<Tuned: CERTIFIED: every required condition holds; checked once more")
    before = 1e3 * result.start.lateral
    after = 1e3 * result.best.lateral
    assert f"lateral RMS {before:.3f} -> {after:.3f} mm at the last step of 4 held-out laps" in text
    assert "2 evaluations, stopped: budget" in text and result.stop is Stop.BUDGET
    assert len(text) < 250 and "\n" not in text


def test_a_result_says_where_its_laps_have_settled(result):
    problem = complete_problem(load("untuned", "reference.duration_s=12"))
    tuner = dataclasses.replace(result.tuner, problem=problem)
    longer = dataclasses.replace(result, tuner=tuner)
    assert "after 10 s of 4 held-out laps" in repr(longer)


def test_without_a_certified_iterate_nothing_is_returned_and_what_it_lacks_is_told(uncertified):
    assert not uncertified.is_certified
    assert uncertified.best is uncertified.scenario is uncertified.design is None
    assert "terminal_set_invariant" in uncertified.failing
    assert repr(uncertified).startswith("<Tuned: NOT CERTIFIED: terminal_set_invariant")


def assert_same_judgements(one, other):
    assert len(one.judged) == len(other.judged)
    for judgement, again in zip(one.judged, other.judged, strict=True):
        np.testing.assert_array_equal(judgement.point, again.point)
        assert judgement.arrays().keys() == again.arrays().keys()
        for name, values in judgement.arrays().items():
            np.testing.assert_array_equal(values, again.arrays()[name])


@pytest.mark.parametrize("kind", ["result", "uncertified"])
def test_a_result_is_read_as_it_was_saved(kind, request, tmp_path, monkeypatch):
    saved = request.getfixturevalue(kind)
    designed = []

    def restore(scenario, arrays):
        designed.append(scenario)
        again = saved.design.with_arrays(arrays)
        return dataclasses.replace(again, certificate=saved.design.certificate)

    monkeypatch.setattr("jaxtube.tuning.tune.restore_design", restore)
    again = jt.read(saved.save(tmp_path))
    assert repr(again) == repr(saved)
    assert again.sentence == saved.sentence
    assert again.failing == saved.failing
    assert again.scenario == saved.scenario
    assert designed == ([] if saved.scenario is None else [saved.scenario])
    assert again.tuner.parameters.moves == saved.tuner.parameters.moves
    assert_same_judgements(again.descent, saved.descent)
    np.testing.assert_array_equal(again.descent.objective, saved.descent.objective)
    for name in ("best_certified", "best_uncertified"):
        iterate = getattr(saved.descent.outcome, name)
        same = getattr(again.descent.outcome, name)
        assert (iterate and iterate.rank) == (same and same.rank)


def test_a_result_draws_its_descent(result, uncertified):
    assert_presentable(result.plot())
    assert_presentable(uncertified.plot())


def test_an_uncertified_iterate_is_chosen_only_when_accepted(uncertified):
    descent = uncertified.descent
    assert descent.best() is None
    best = descent.best(accept_uncertified=True)
    assert best.held_out == min(judgement.held_out for judgement in descent.judged)


@pytest.mark.parametrize(
    "settings, told",
    [
        ({"laps": 0}, "laps = 0"),
        ({"held_out": 0}, "held_out = 0"),
        ({"evaluations": 0}, "evaluations = 0"),
        ({"patience": -1}, "patience = -1"),
        ({"learning_rate": 0.0}, "learning_rate = 0.0"),
        ({"laps": 2.5}, "laps = 2.5"),
        ({"method": "newton"}, "method = 'newton'"),
    ],
)
def test_settings_out_of_range_are_refused_before_anything_is_computed(settings, told):
    with pytest.raises(ValueError, match=told):
        tune(load("untuned"), **settings)


@pytest.mark.parametrize("function", [jt.tune, jt.design])
@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("untuned", "scenario = 'untuned': is a name or a path; give jt.load('untuned')"),
        (None, "scenario: is a NoneType; give what jt.load returns"),
    ],
)
def test_what_is_no_scenario_is_refused(function, value, words):
    with pytest.raises(ScenarioError, match=re.escape(words)):
        function(value)


def test_a_scenario_without_gains_is_refused():
    with pytest.raises(ScenarioError, match="no gains to tune"):
        tune(load("paper"))


def test_a_certificate_for_an_assumed_w_is_one_for_the_linear_model_and_says_so(result):
    problem = complete_problem(load("tuned", ['disturbance.bound="assumed"']))
    assert assumption(problem).startswith(" for the linear model with w in W, which is assumed")
    tuner = dataclasses.replace(result.tuner, problem=problem)
    assumed = dataclasses.replace(result, tuner=tuner)
    assert assumed.verdict.startswith("CERTIFIED for the linear model with w in W")
