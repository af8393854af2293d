"""Loops by columns are the loops they stand for."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxtube.columns import MOST, join, loop_by_columns, scan_by_columns, split


def turn_about(step, carry):
    points, count, wide = carry
    mixed = jnp.stack([points[:, 1], -points[:, 0], points[:, 2] + step], axis=1)
    return mixed, count + 1, wide * 0.5


def make_carry():
    points = jnp.arange(15.0).reshape(5, 3)
    return points, jnp.zeros(5, int), jnp.ones((5, MOST + 1))


def test_a_split_tree_is_joined_to_itself():
    tree = {
        "flat": jnp.arange(4),
        "none": jnp.zeros((3, 0)),
        "deep": jnp.ones((2, 3, 2)),
        "narrow": jnp.ones((3, 2)),
    }
    joined = join(split(tree))
    assert jax.tree.structure(joined) == jax.tree.structure(tree)
    jax.tree.map(np.testing.assert_array_equal, joined, tree)


def test_a_loop_by_columns_is_the_loop():
    expected = jax.lax.fori_loop(0, 7, turn_about, make_carry())
    found = loop_by_columns(jnp.int32(0), jnp.int32(7), turn_about, make_carry())
    jax.tree.map(np.testing.assert_array_equal, found, expected)


def test_a_scan_by_columns_is_the_scan_and_so_is_its_derivative():
    entries = jnp.linspace(0.0, 1.0, 6)

    def body(carry, entry):
        after = turn_about(entry, carry)
        return after, {"points": after[0], "sum": jnp.sum(after[0] ** 2)}

    expected = jax.lax.scan(body, make_carry(), entries)
    found = scan_by_columns(body, make_carry(), entries)
    jax.tree.map(np.testing.assert_array_equal, found, expected)

    def cost(scan, start):
        points, count, wide = make_carry()
        _, seen = scan(body, (points * start, count, wide), entries)
        return jnp.sum(jnp.sin(seen["points"]))

    slope = jax.grad(cost, argnums=1)(scan_by_columns, 1.3)
    np.testing.assert_allclose(slope, jax.grad(cost, argnums=1)(jax.lax.scan, 1.3), rtol=1e-12)
