"""Laws of the tree that guesses regions: on line it goes the way it went off line, and no errors,
however they lie, break its growth."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtube.qp.regions import DEEPEST, Regions, guess_region
from jaxtube.synthesis.region_tree import grow_tree

CUBES = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])


def split_octants(count):
    """Points in eight octants, their numbers, and the planes between them for each octant."""
    points = np.random.default_rng(2).uniform(-1.0, 1.0, (count, 3))
    region = (points > 0) @ np.array([4, 2, 1])
    planes = np.tile(np.eye(3, 4), (8, 1, 1)) * CUBES[..., None]
    return np.column_stack([points, np.ones(count)]), region, planes


def as_regions(tree):
    nothing = np.zeros((0, 0, 4))
    begin = jnp.int32(0)
    return Regions(begin, jnp.asarray(tree.planes), jnp.asarray(tree.following), *3 * (nothing,))


@pytest.mark.parametrize("accelerator", [False, True])
def test_the_tree_tells_regions_apart_off_line_and_on_line(accelerator, monkeypatch):
    monkeypatch.setattr("jaxtube.qp.regions.on_accelerator", lambda: accelerator)
    points, region, planes = split_octants(400)
    tree = grow_tree(planes, np.ones((8, 3), bool), points, region)
    np.testing.assert_array_equal(tree.guess(points), region)
    guess = jax.jit(lambda p: guess_region(as_regions(tree), p))
    np.testing.assert_array_equal(guess(jnp.asarray(points[:, :3])), region)


def test_points_on_a_plane_end_the_growth():
    generator = np.random.default_rng(0)
    for _ in range(300):
        plane = generator.normal(size=4)
        plane /= np.linalg.norm(plane[:3])
        count = int(generator.integers(2, 6))
        points = np.column_stack([generator.normal(size=(count, 3)), np.ones(count)])
        points[:, :3] -= (points @ plane)[:, None] * plane[:3]
        region = np.arange(count) % 2
        tree = grow_tree(np.tile(plane, (2, 1, 1)), np.ones((2, 1), bool), points, region)
        assert set(tree.guess(points)) <= {0, 1}


def test_no_way_through_the_tree_is_longer_than_the_longest():
    generator = np.random.default_rng(1)
    count = 2 * DEEPEST
    points = np.column_stack([np.arange(count), np.zeros((count, 2)), np.ones(count)])
    planes = np.zeros((count, 1, 4))
    planes[:, 0, 0] = 1.0
    planes[:, 0, 3] = 0.5 - np.arange(count)
    region = generator.permutation(count)
    tree = grow_tree(planes, np.ones((count, 1), bool), points.astype(float), region)
    regions = as_regions(tree)
    node = jnp.zeros(count, jnp.int32)
    for _ in range(DEEPEST):
        values = jnp.asarray(points @ tree.planes[np.maximum(node, 0)].T).diagonal()
        after = regions.following[np.maximum(node, 0), (values >= 0).astype(int)]
        node = jnp.where(node < 0, node, after)
    assert (np.asarray(node) < 0).all()
