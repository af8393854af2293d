"""Verdicts on spans of known truth, against linear programs and against the deviations that made
them."""

import numpy as np
import pytest
from made_spans import make_spans
from scipy.optimize import linprog

from jaxtube.witness.motion import find_reach, measure_disturbance
from jaxtube.witness.verdict import judge

LINEAR_PROGRAM = 1e-6
"""Relative; answers of a linear program."""


def judge_made(frame, pieces, **made):
    allowed, spans, deviations = make_spans(frame, pieces, **made)
    measured = measure_disturbance(spans, allowed)
    reach = find_reach(spans, allowed)
    return judge(spans, allowed, reach, measured), deviations, (spans, allowed, reach, measured)


@pytest.mark.parametrize("frame", ["robot", "world"])
@pytest.mark.parametrize("pieces", [1, 4])
def test_whatever_is_allowed_is_explained(frame, pieces):
    verdict, _, _ = judge_made(frame, pieces, count=40)
    assert verdict.explained.all()
    assert not verdict.refuted.any() and not verdict.undecided.any()
    assert np.all(verdict.excess == 0.0)


def test_extremes_of_all_that_is_allowed_are_never_refuted():
    allowed, spans, deviations = make_spans("robot", 1, count=30, seed=4)
    reach = find_reach(spans, allowed)
    corners = np.sign(deviations)
    measured = reach.centre + np.einsum("kiv,kv->ki", reach.generators, corners)
    verdict = judge(spans, allowed, reach, measured)
    assert not verdict.refuted.any()


@pytest.mark.parametrize("pieces", [1, 3])
def test_usage_is_the_least_scale_that_explains_by_linear_programs(pieces):
    verdict, _, (_, _, reach, measured) = judge_made("world", pieces, spread=3.0)
    for k, usage in enumerate(verdict.usage):
        count = reach.generators.shape[2]
        one = np.ones((count, 1))
        eye = np.eye(count)
        answer = linprog(
            np.append(np.zeros(count), 1.0),
            A_ub=np.block([[eye, -one], [-eye, -one]]),
            b_ub=np.zeros(2 * count),
            A_eq=np.hstack([reach.generators[k], np.zeros((3, 1))]),
            b_eq=measured[k] - reach.centre[k],
            bounds=[(None, None)] * count + [(0.0, None)],
        )
        assert usage == pytest.approx(answer.fun, rel=LINEAR_PROGRAM)


def test_what_lies_beyond_is_refuted_and_said_by_how_much():
    allowed, spans, _ = make_spans("robot", 1, count=30)
    reach = find_reach(spans, allowed)
    away = reach.half_widths + reach.remainder
    for axis in range(3):
        measured = reach.centre.copy()
        measured[:, axis] += away[:, axis] + 0.01
        verdict = judge(spans, allowed, reach, measured)
        assert verdict.refuted.all() and not verdict.explained.any()
        np.testing.assert_allclose(verdict.excess[:, axis], 0.01, atol=1e-12)
        others = np.delete(verdict.excess, axis, axis=1)
        assert np.all(others == 0.0)


def test_nothing_in_the_middle_is_undecided_and_little_near_the_edge():
    verdict, _, _ = judge_made("world", 1, count=150, spread=2.5, seed=9)
    is_near = np.abs(verdict.usage - 1.0) < 0.1
    assert not verdict.undecided[~is_near].any()
    assert verdict.explained[verdict.usage < 0.9].all()
    assert verdict.refuted[verdict.usage > 1.1].all()
    assert verdict.refuted.any() and verdict.explained.any()


def test_what_is_no_number_is_refuted():
    allowed, spans, _ = make_spans("robot", 1)
    reach = find_reach(spans, allowed)
    measured = measure_disturbance(spans, allowed)
    measured[3, 1] = np.nan
    verdict = judge(spans, allowed, reach, measured)
    assert verdict.refuted[3] and not verdict.explained[3]
    assert verdict.explained[np.arange(len(measured)) != 3].all()
