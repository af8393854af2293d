"""Laws of the polygon around the minimal RPI set in (e_y, e_th): sums of supports, products of
loops, sizes, loops without a bounded tube."""

import itertools

import numpy as np
import pytest
from tolerances import ROUNDING

from jaxtube.synthesis.lateral_tube import HALF_TURN, Ring, reach, settle, solve

RING = Ring(0.8)
ROWS = np.array([[1.0, 0.0], [0.0, 1.0], [9.0, 9.0], [-3.0, 2.0]])
NARROW = 0.02
"""Of a polygon of as many sides beside the set inside it."""
SIDES = np.array([0.01, 0.02])
"""Half widths of the disturbance of one step, a box."""


def loop(c: float, lateral: float, heading: float) -> np.ndarray:
    """Return a loop of the lateral and the heading error, whose way in a period is c."""
    return np.array([[1 - c * lateral / 2, c * (1 - heading / 2)], [-lateral, 1 - heading]])


def supports_along(ring: Ring, loops: np.ndarray, rows: np.ndarray, sides: np.ndarray):
    images = ring.directions @ loops
    steps = np.abs(ring.directions) @ sides
    policy = settle(ring, images, steps, rows)
    if policy is None:
        return None
    supports = solve(ring, policy, images[None], steps[None])
    return reach(ring, policy.rows, supports, rows[None])[0]


def test_every_row_is_the_sum_of_the_two_directions_around_it():
    rows = np.random.default_rng(0).normal(size=(500, 2))
    cones = RING.locate(rows)
    alpha, beta = RING.shares(rows, cones)
    assert np.all(alpha >= -ROUNDING) and np.all(beta >= -ROUNDING)
    first = cones.sign[:, None] * RING.sides[cones.first]
    following = cones.sign[:, None] * RING.sides[cones.first + 1]
    np.testing.assert_allclose(alpha[:, None] * first + beta[:, None] * following, rows, atol=1e-12)


def test_of_one_loop_the_set_is_the_sum_of_what_disturbances_become():
    """Its support number is the sum of those of W along Phi^kT d: an oracle without polygons."""
    single = loop(0.136, 0.93, 0.93)
    exact = np.zeros(len(ROWS))
    images = ROWS.copy()
    for _ in range(400):
        exact += np.abs(images) @ SIDES
        images = images @ single
    found = supports_along(RING, single[None], ROWS, SIDES)
    assert found is not None
    assert np.all(found >= exact * (1 - 1e-9))
    assert np.all(found <= exact * (1 + NARROW))


def test_of_two_loops_it_holds_what_disturbances_become_in_any_order():
    loops = np.stack([loop(0.12, 0.9, 0.9), loop(0.15, 0.9, 0.9)])
    found = supports_along(RING, loops, ROWS, SIDES)
    assert found is not None
    for order in itertools.product((0, 1), repeat=8):
        images = ROWS.copy()
        reached = np.zeros(len(ROWS))
        for which in itertools.islice(itertools.cycle(order), 60):
            reached += np.abs(images) @ SIDES
            images = images @ loops[which]
        assert np.all(reached <= found * (1 + 1e-9))


def test_a_robot_of_another_size_has_the_same_set_in_its_units():
    loops = np.stack([loop(0.12, 0.9, 0.9), loop(0.15, 0.9, 0.9)])
    size = 1e-3
    lengths = np.array([size, 1.0])
    scaled = loops * lengths[:, None] / lengths
    usual = supports_along(RING, loops, ROWS, SIDES)
    small = supports_along(Ring(0.8 * size), scaled, ROWS / lengths, SIDES * lengths)
    assert usual is not None and small is not None
    np.testing.assert_allclose(small, usual, rtol=1e-9)


@pytest.mark.parametrize("heading", [-0.01, 2.5])
def test_loops_that_grow_have_no_bounded_tube(heading):
    assert supports_along(RING, loop(0.136, 0.5, heading)[None], ROWS, SIDES) is None
    assert len(RING.directions) == HALF_TURN
