"""w of a span, against an integrator in the world frame, against the parts that W is made of, and
against the enclosure of all that it may be."""

import itertools

import numpy as np
import pytest
from made_spans import make_spans
from tolerances import EXACT_ARCS, ROUNDING

from jaxtube.witness.motion import add_disturbance, find_reach, measure_disturbance
from sets.robot import Kinematics, Operation, evaluate_disturbance

CASES = list(itertools.product(("robot", "world"), (1, 3)))


@pytest.mark.parametrize(("frame", "pieces"), CASES)
def test_w_is_that_of_the_deviations_that_made_it(frame, pieces):
    allowed, spans, deviations = make_spans(frame, pieces)
    middle, half = allowed.box(pieces)
    expected = add_disturbance(spans, allowed, list((middle + half * deviations).T))
    measured = measure_disturbance(spans, allowed)
    np.testing.assert_allclose(measured, np.stack(expected, axis=1), atol=EXACT_ARCS)


def test_w_is_that_of_a_controller_on_the_path_that_commands_those_wheels():
    allowed, spans, deviations = make_spans("robot", 1, steps=1)
    middle, half = allowed.box(1)
    right, left, sideslip, *noise = (middle + half * deviations).T
    for k, duration in enumerate(spans.duration):
        ground = spans.ways[k, 0] / duration * (1.0 - allowed.nominal)
        slip = np.array([right[k], left[k]])
        errors = (slip - allowed.nominal) / (1.0 - allowed.nominal)
        before = [noise[axis][k] for axis in range(3)]
        after = np.array([[noise[axis][k] for axis in range(3, 6)]])
        operation = Operation(
            errors=np.zeros((2, 3)),
            inputs=np.zeros((2, 2)),
            schedules=np.stack([ground, ground])[None],
            wheel_errors=np.stack([-np.abs(errors), np.abs(errors)]),
            noise=allowed.noise,
            dt=float(duration),
            track_width=allowed.track,
            sideslip=allowed.sideslip,
            lever_arm=allowed.lever_arm,
        )
        point = np.array([[0, 0, 0, 0, 0, *ground, *errors, sideslip[k], *before]])
        for input_map in ("x_exact", "cosine_free"):
            model = "exact_jacobian" if input_map == "x_exact" else "consistent"
            w, _, _ = evaluate_disturbance(operation, Kinematics(input_map, model), point, after)
            own = measure_disturbance(spans, allowed)[k]
            np.testing.assert_allclose(w[0], own, atol=EXACT_ARCS)


@pytest.mark.parametrize(("frame", "pieces"), CASES)
def test_all_that_w_may_be_lies_within_the_remainder_of_its_linear_part(frame, pieces):
    allowed, spans, _ = make_spans(frame, pieces, count=50)
    reach = find_reach(spans, allowed)
    middle, half = allowed.box(pieces)
    draw = np.random.default_rng(5)
    for extreme in (False, True):
        deviations = draw.uniform(-1.0, 1.0, (50, allowed.count(pieces)))
        deviations = np.sign(deviations) if extreme else deviations
        w = np.stack(add_disturbance(spans, allowed, list((middle + half * deviations).T)), axis=1)
        linear = reach.centre + np.einsum("kiv,kv->ki", reach.generators, deviations)
        assert np.all(np.abs(w - linear) <= reach.remainder + ROUNDING)
        assert np.all(np.abs(w - reach.centre) <= reach.half_widths + reach.remainder + ROUNDING)


def test_the_remainder_is_small_beside_what_w_may_be():
    allowed, spans, _ = make_spans("world", 1)
    reach = find_reach(spans, allowed)
    assert np.all(reach.remainder < 0.1 * reach.half_widths)
