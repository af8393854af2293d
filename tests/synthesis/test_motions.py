"""Laws of the second proof of a certificate's bounds: it confirms them, a motion that passes one
fails the certificate, and a search that gives up is told without deciding anything."""

import dataclasses
from fractions import Fraction

import pytest

from jaxtube.scenario import load
from jaxtube.synthesis.certificate import motions
from jaxtube.synthesis.certificate.motions import check_motions
from jaxtube.synthesis.disturbance import complete_problem, prove_bound
from sets.exact_supremum import Room


@pytest.fixture(scope="module")
def husky():
    """A robot with slip in intervals, sideslip, lag, noise and an observer."""
    return complete_problem(load("husky"))


def test_a_robot_with_every_cause_is_confirmed(husky):
    condition = check_motions(husky)
    assert condition.holds
    assert condition.scope == "robot"
    assert "the 30 bounds" in condition.sentence


def test_a_motion_beyond_a_bound_fails_the_certificate(husky, monkeypatch):
    bound = prove_bound(husky)
    narrow = dataclasses.replace(bound, box=bound.box * [1.0, 0.9, 1.0])
    monkeypatch.setattr(motions, "prove_bound", lambda _: narrow)
    condition = check_motions(husky)
    assert not condition.holds
    assert condition.scope == "robot"
    assert condition.sentence == "Exact integer arithmetic does not confirm: y."


def test_a_search_that_gives_up_decides_nothing(husky, monkeypatch):
    rooms = {"x": Room(Fraction(1), Fraction(1)), "y": Room(Fraction(-1, 8), Fraction(1, 8))}
    monkeypatch.setattr(motions, "find_disturbance_rooms", lambda *_: rooms)
    condition = check_motions(husky)
    assert not condition.required
    assert "gave up 0.125 short of y" in condition.sentence


def test_a_robot_that_turns_too_far_decides_nothing(husky, monkeypatch):
    def refuse(*_):
        raise ValueError("angle: too wide")

    monkeypatch.setattr(motions, "find_disturbance_rooms", refuse)
    condition = check_motions(husky)
    assert not condition.required
    assert condition.sentence == "Not proved a second time: angle: too wide."
