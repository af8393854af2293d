"""Laws of the initial errors: uniform in their polytope, a function of the key alone, refused where
there is none."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import ConvexHull
from tolerances import ROUNDING

from jaxtube.simulation.rollout import realisation_keys
from jaxtube.simulation.starts import FixedStart, uniform_start
from sets.polytope import Polytope

COUNT = 40_000
SHARE = 4.5  # standard deviations of a share of the draws


@pytest.fixture(scope="module", params=["random", "lopsided", "cube"])
def points(request):
    """Corners of a polytope around the origin: flat in one direction, the origin close to a facet,
    coplanar corners."""
    random = np.random.default_rng(3)
    if request.param == "cube":
        return np.array(np.meshgrid([-1, 1], [-2, 2], [-0.1, 0.3])).reshape(3, -1).T
    found = random.normal(size=(60, 3)) * [0.3, 0.3, 0.02]
    return found if request.param == "random" else found + np.array([0.15, -0.1, 0.005])


@pytest.fixture(scope="module")
def draws(points):
    return np.asarray(jax.jit(uniform_start(points).draw)(realisation_keys(7, 0, COUNT)))


def check_share(inside, expected):
    assert abs(inside.mean() - expected) <= SHARE * np.sqrt(expected * (1 - expected) / len(inside))


def test_starts_lie_in_the_polytope_and_differ(points, draws):
    hull = Polytope.from_vertices(points)
    assert hull.margin(draws).min() >= -ROUNDING * np.abs(points).max()
    assert draws.dtype == np.float64 and len(np.unique(draws, axis=0)) == COUNT


def test_a_polytope_t_times_as_large_holds_a_share_t_cubed(points, draws):
    hull = Polytope.from_vertices(points)
    reach = np.max(draws @ hull.normals.T / hull.offsets, axis=1)
    for t in (0.2, 0.5, 0.7, 0.9, 0.99):
        check_share(reach <= t, t**3)


def test_half_spaces_hold_the_share_of_their_volume(points, draws):
    hull = Polytope.from_vertices(points)
    random = np.random.default_rng(5)
    for _ in range(12):
        direction = random.normal(size=3) / np.ptp(points, axis=0)
        level = np.quantile(points @ direction, random.uniform(0.2, 0.8))
        part = hull.intersect(Polytope(direction[None], np.array([level])))
        check_share(draws @ direction <= level, part.volume() / ConvexHull(points).volume)


def test_a_start_is_a_function_of_its_key(points, draws):
    start = uniform_start(points)
    keys = realisation_keys(7, 0, 100)
    order = np.random.default_rng(0).permutation(100)
    draw = jax.jit(start.draw)
    np.testing.assert_allclose(draw(keys[order]), draws[order], rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(draw(keys[37:38]), draws[37:38], rtol=0, atol=ROUNDING)
    assert np.all(np.asarray(draw(realisation_keys(8, 0, 100))) != draws[:100])


def test_a_polytope_without_the_origin_is_refused():
    points = np.random.default_rng(3).normal(size=(60, 3))
    with pytest.raises(
        ValueError, match="starts: points do not surround the origin; give points on all sides"
    ) as told:
        uniform_start(points + np.array([9.0, 0.0, 0.0]))
    assert "\n" not in str(told.value)


def test_a_fixed_start_is_the_same_for_all():
    error = np.array([0.1, -0.2, 0.03])
    np.testing.assert_array_equal(
        FixedStart(jnp.asarray(error)).draw(realisation_keys(0, 0, 5)), np.tile(error, (5, 1))
    )


def test_starts_on_the_edge_are_projections_of_those_inside(points, draws):
    hull = Polytope.from_vertices(points)
    edge = np.asarray(jax.jit(uniform_start(points, edge=True).draw)(realisation_keys(7, 0, COUNT)))
    np.testing.assert_allclose(
        np.max(edge @ hull.normals.T / hull.offsets, axis=1), 1.0, atol=1e3 * ROUNDING
    )
    reach = np.max(draws @ hull.normals.T / hull.offsets, axis=1)
    np.testing.assert_allclose(edge * reach[:, None], draws, atol=1e3 * ROUNDING)
