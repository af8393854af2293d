"""Laws of the witness for noise: it finds no more than what W counts on, nearly all of it, and
refutes what leaves a cause of it out."""

import functools

import numpy as np
import pytest
from tolerances import RESIDUAL_ROUNDING

import sets.robot.latency
from jaxtube.scenario import error_box, load
from jaxtube.scenario.error_box import error_vector
from jaxtube.synthesis.certificate.noise import changes_noise, find_noise
from jaxtube.synthesis.certificate.robot import check_disturbance_set
from jaxtube.synthesis.disturbance import complete_problem
from jaxtube.synthesis.problem import make_problem

WORLD = ("noise.frame=world", "noise.longitudinal_m=0.003", "noise.heading_deg=0.5")
CASES = {
    "lag": ("certified_lag",),
    "delay": ("certified", "robot.command_delay_s=[0.1, 0.16]"),
    "path": ("certified_lag", "reference.certified_for=path"),
    "world": ("certified", *WORLD),
    "world and lag": ("certified_lag", *WORLD),
    "husky": ("husky",),
    "tracked": ("tracked",),
    "indoor": ("indoor",),
}


@functools.cache
def make_case(name):
    base, *settings = CASES[name]
    return make_problem(load(base, settings))


@pytest.mark.parametrize("name", CASES)
def test_noise_found_is_nearly_all_that_is_counted_on_and_no_more(name):
    problem = make_case(name)
    found = find_noise(problem)
    assert changes_noise(problem)
    assert np.all(found <= problem.noise + RESIDUAL_ROUNDING)
    assert np.all(found >= 0.7 * problem.noise)
    assert np.all(found[:2] > error_vector(problem.scenario.noise)[:2])


def without(name, monkeypatch):
    """Take a cause of noise out of what is counted on."""
    commit = sets.robot.latency.bound_committed_noise
    target = "sets.robot.latency.bound_committed_noise"
    causes = {
        "latency": lambda noise, latency, fastest, yaw_rate: noise,
        "swing": lambda noise, latency, fastest, yaw_rate: commit(noise, latency, 0.0, yaw_rate),
        "turn": lambda noise, latency, fastest, yaw_rate: commit(noise, latency, fastest, 0.0),
    }
    if name in causes:
        monkeypatch.setattr(target, causes[name])
    elif name == "all":
        monkeypatch.setattr(error_box, "bound_pose_noise", lambda scenario: np.zeros(3))
    elif name == "world":
        monkeypatch.setattr(
            error_box, "bound_pose_noise", lambda scenario: error_vector(scenario.noise)
        )
    else:
        monkeypatch.setattr(error_box, "bound_pose_noise", keep_reach_alone)


def keep_reach_alone(scenario):
    """Return noise in the world's frame, the error that a wrong heading turns left out."""
    x, y, heading = error_vector(scenario.noise)
    return np.array([np.hypot(x, y), np.hypot(x, y), heading])


@pytest.mark.parametrize(
    ("name", "cause"),
    [
        ("lag", "all"),
        ("lag", "latency"),
        ("lag", "swing"),
        ("lag", "turn"),
        ("delay", "swing"),
        ("delay", "turn"),
        ("world", "all"),
        ("world", "world"),
        ("world", "turned error"),
        ("husky", "all"),
        ("husky", "latency"),
        ("husky", "world"),
        ("husky", "turned error"),
        ("tracked", "turned error"),
        ("indoor", "latency"),
    ],
)
def test_noise_with_a_cause_left_out_is_refuted(name, cause, monkeypatch):
    problem = make_case(name)
    without(cause, monkeypatch)
    condition = check_disturbance_set(problem)
    assert not condition.holds
    assert condition.margin < 0
    assert condition.sentence.startswith("The noise that W counts on is refuted: the measured ")
    of_committed = "error of the committed pose may be off" in condition.sentence
    assert of_committed is not problem.scenario.robot.obeys_at_once


def test_w_made_of_too_little_noise_is_refuted_too(monkeypatch):
    """W, tube and error set are all made of what is counted on."""
    without("latency", monkeypatch)
    condition = check_disturbance_set(complete_problem(load("certified_lag")))
    assert condition.sentence.startswith("The noise that W counts on is refuted")


def test_what_was_found_is_told_where_noise_is_not_the_scenarios():
    told = check_disturbance_set(complete_problem(load("certified_lag"))).sentence
    assert told.endswith("of the bound, noise 98.2% to 100.0% of what is counted on.")
    as_given = complete_problem(load("certified"))
    assert not changes_noise(as_given)
    assert "noise" not in check_disturbance_set(as_given).sentence
