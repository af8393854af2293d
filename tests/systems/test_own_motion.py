"""Laws of a motion of a user's own: what is proved of it, and that the same function moves."""

import functools
import math
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from jaxtube.plant.own_motion import OwnMotion
from jaxtube.scenario.refusal import ScenarioError
from jaxtube.synthesis.certificate.linear import certify_linear
from jaxtube.synthesis.linear_design import design_linear
from jaxtube.systems.motion import Motion, mix
from jaxtube.systems.system import LinearSystem
from sets.interval import cos, reciprocal, sin, sinc, square, tan
from sets.polytope import Polytope


def make_system(function, uncertainty=(0.01,), **changes):
    """Return a scalar system x+ = x / 2 + u, which a motion stands for."""
    fields = {"A": [[0.5]], "B": [[1.0]], "E": [0.6], "U": [0.5], "Q": [[1.0]], "R": [[1.0]]}
    return LinearSystem(**(fields | {"motion": Motion(function, uncertainty)} | changes))


def swing(x, u, th, d):
    """Return the motion of a pendulum with two uncertain vertices of its length."""
    length = th[0] * 1.0 + th[1] * 1.5
    speed = x[1] * 0.9 - sin(x[0]) * 0.1 / length + u[0] * 0.1 + d[0]
    return [x[0] + x[1] * 0.1, speed]


@functools.cache
def make_pendulum():
    """Return the pendulum with the Jacobians of both lengths; its W takes seconds to prove."""
    A = [[[1.0, 0.1], [-0.1 / length, 0.9]] for length in (1.0, 1.5)]
    return LinearSystem(
        A=A,
        B=[[0.0], [0.1]],
        E=[0.5, 1.0],
        U=[3.0],
        Q=np.eye(2),
        R=[[0.1]],
        schedule=[[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]],
        horizon=4,
        motion=Motion(swing, [0.01]),
    )


@pytest.mark.parametrize(
    ("added", "least", "greatest"),
    [
        (lambda x, d: d, -0.01, 0.01),
        (lambda x, d: x * x, 0.0, 0.36),
        (lambda x, d: square(x) * -1.0, -0.36, 0.0),
        (lambda x, d: x * 0.0 + 0.25, 0.0, 0.25),
        (lambda x, d: sin(x) - x, math.sin(0.6) - 0.6, 0.6 - math.sin(0.6)),
        (lambda x, d: cos(x) - 1.0, math.cos(0.6) - 1, 0.0),
        (lambda x, d: tan(x) - x, 0.6 - math.tan(0.6), math.tan(0.6) - 0.6),
        (lambda x, d: sinc(x) - 1.0, math.sin(0.6) / 0.6 - 1, 0.0),
        (lambda x, d: reciprocal(x + 2.0) - 0.5, 1 / 2.6 - 0.5, 1 / 1.4 - 0.5),
        (lambda x, d: x * d, -0.006, 0.006),
    ],
)
def test_w_is_what_the_motion_adds_to_the_model_and_at_most_1_percent_more(added, least, greatest):
    system = make_system(lambda x, u, th, d: [x[0] * 0.5 + u[0] + added(x[0], d[0])])
    upper, lower = system.disturbance_set.support(np.array([[1.0], [-1.0]]))
    assert greatest <= upper <= 1.02 * greatest + 1e-9
    assert -least <= lower <= -1.02 * least + 1e-9


def test_a_row_that_is_constant_is_no_row_without_disturbance():
    system = LinearSystem(
        A=[[0.5, 0.0], [0.0, 0.0]],
        B=[[1.0], [0.0]],
        E=[1.0, 1.0],
        U=[1.0],
        Q=np.eye(2),
        R=[[1.0]],
        motion=Motion(lambda x, u, th, d: [x[0] * 0.5 + u[0], 0.125], [0.0]),
    )
    assert system.disturbance_set.support(np.array([0.0, 1.0])) >= 0.125


def test_w_holds_samples_of_the_motion():
    system = make_pendulum()
    random = np.random.default_rng(0)
    count = 20_000
    x = random.uniform(-1, 1, (2, count)) * [[0.5], [1.0]]
    u = random.uniform(-1, 1, (1, count)) * 3.0
    share = random.random(count)
    d = random.uniform(-1, 1, (1, count)) * 0.01
    th = np.stack([1 - share, share])
    following = np.stack(
        [
            x[0] + 0.1 * x[1],
            0.9 * x[1] - 0.1 * np.sin(x[0]) / (th[0] + 1.5 * th[1]) + 0.1 * u[0] + d[0],
        ]
    )
    predicted = np.einsum("vc,vij,jc->ic", th, system.A, x) + np.array([[0.0], [0.1]]) @ u
    added = following - predicted
    used = np.abs(added[1]).max() / system.disturbance_set.support(np.array([0.0, 1.0]))
    assert 0.9 < used <= 1.0
    assert np.abs(added[0]).max() < 1e-12


@pytest.mark.parametrize(
    ("function", "cure"),
    [
        (lambda x, u, th, d: [x[0] ** 2], "square"),
        (lambda x, u, th, d: [math.sin(x[0])], "sin"),
        (lambda x, u, th, d: [np.sin(x[0])], "sin"),
        (lambda x, u, th, d: [sin(x[0] * 10.0)], "narrow E"),
        (lambda x, u, th, d: [u[0] / x[0]], "narrow E"),
        (lambda x, u, th, d: [x[0], u[0]], "give 1"),
    ],
)
def test_what_has_no_bound_is_refused_in_one_line(function, cure):
    with pytest.raises(ScenarioError) as refused:
        make_system(function)
    message = str(refused.value)
    assert message.startswith("system: motion")
    assert cure in message
    assert "\n" not in message


def test_the_function_that_is_proved_is_the_one_that_moves():
    system = make_pendulum()
    random = np.random.default_rng(2)
    x = random.uniform(-0.5, 0.5, (7, 2))
    u = random.uniform(-1, 1, (7, 1))
    d = random.uniform(-0.01, 0.01, (7, 1))
    th = np.array([0.25, 0.75])
    plant = OwnMotion(jnp.asarray(th)[None], jnp.asarray([[0.01], [-0.01]]), swing)
    moved = plant.move(0, jnp.asarray(x), jnp.asarray(u), jnp.asarray(d)).errors
    speed = 0.9 * x[:, 1] - 0.1 * np.sin(x[:, 0]) / 1.375 + 0.1 * u[:, 0] + d[:, 0]
    np.testing.assert_allclose(moved[:, 0], x[:, 0] + 0.1 * x[:, 1], atol=1e-15)
    np.testing.assert_allclose(moved[:, 1], speed, atol=1e-15)
    assert system.motion is not None
    on_host = system.motion(x.T, u.T, np.tile(th[:, None], 7), d.T)
    np.testing.assert_allclose(on_host.T, moved, atol=1e-15)


@pytest.mark.parametrize("vertices", [1, 2, 3, 4])
def test_shares_between_0_and_1_make_every_mixture(vertices):
    random = np.random.default_rng(vertices)
    shares = random.random((vertices - 1, 1000))
    weights = np.array(np.broadcast_arrays(*mix(list(shares)))) if vertices > 1 else np.ones((1, 1))
    assert np.min(weights) >= 0
    np.testing.assert_allclose(weights.sum(axis=0), 1, atol=1e-14)
    for vertex in np.eye(vertices):
        # Every vertex is the mixture of shares 1 at it and 0 before.
        found = mix([float(weight) for weight in vertex[:-1]])
        np.testing.assert_allclose(found, vertex)


def test_a_motion_is_certified_with_the_w_that_is_proved_and_with_no_smaller_one():
    design = design_linear(make_pendulum())
    assert design.certificate.holds_for_robot
    W = design.system.disturbance_set
    smaller = replace(design.system, W=W.scale(0.97))
    certificate = certify_linear(replace(design, problem=replace(design.problem, system=smaller)))
    assert certificate.failing == ["disturbance_set_proved"]
    assert "NOT CERTIFIED for the motion: disturbance_set_proved" in certificate.verdict


def test_a_motion_whose_schedule_is_unknown_is_proved_for_every_mixture():
    known = make_pendulum()
    unknown = replace(known.without_schedule(), W=None)
    # Beside the model of the mean each vertex differs by 0.1 / 3 (1 - 1 / 1.5) / 2 of x.
    added = 0.1 * abs(1 - 1 / 1.5) / 2 * 0.5
    wider = unknown.disturbance_set.support(np.array([0.0, 1.0]))
    assert wider >= 0.01 + added - 0.1 * (0.5 - math.sin(0.5))
    assert wider <= known.disturbance_set.support(np.array([0.0, 1.0])) + 1.05 * added
    assert isinstance(unknown.disturbance_set, Polytope)
