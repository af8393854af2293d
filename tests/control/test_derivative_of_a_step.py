"""The reverse mode of a step of the tube-MPC beside central differences: free plans, plans with
active rows and the backup, started at the measured error or at the nominal one."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtube import qp
from jaxtube.control import mpc, planning
from jaxtube.simulation import components

STEP = 1e-6
DIFFERENCE = 1e-6
"""Relative, of central differences."""


@pytest.fixture(scope="module")
def qps(uncertified):
    design = uncertified("certified", "reference.duration_s=2")
    return components.make_tube_mpc(design).qps


@pytest.fixture(scope="module")
def starts(uncertified, edge_starts):
    """Errors inside, on the edge of the feasible set, and beyond it."""
    edge = edge_starts(uncertified("certified", "reference.duration_s=2"), 64, edge_share=1.0)
    return np.concatenate([0.2 * edge[:4], 0.97 * edge[:16], 1.5 * edge[:4]])


@functools.cache
def weigh_steps(restart):
    """Return (value, slope): what a step gives, weighed, with its diagnostics; and the reverse mode
    of that.

    Both are functions of a point (data of the QPs, memory and errors), the QPs, stages and weights:
    of inputs, of the memory's inputs and nominal errors, and of residuals.
    """

    def weigh(point, qps, stage, weights):
        names = set(point) - {"inputs", "nominal", "errors"}
        changed = qps._replace(**{name: point[name] for name in names})
        state = mpc.MpcState(point["inputs"], stage, point["nominal"])
        inputs, memory, told = mpc.act(changed, jnp.int32(0), state, point["errors"], restart)
        parts = (inputs, memory.inputs, memory.nominal, told.residual)
        value = sum(jnp.sum(weight * part) for weight, part in zip(weights, parts, strict=True))
        return value, told

    return jax.jit(weigh), jax.jit(jax.grad(weigh, has_aux=True))


def make_point(qps, starts, nominal, generator):
    """Return a point of `weigh_steps`, and the stages."""
    batch = len(starts)
    point = {
        "linear": qps.linear,
        "lower": qps.lower,
        "upper": qps.upper,
        "row_errors": qps.row_errors,
        "free_inputs": qps.free_inputs,
        "tube_gain": qps.tube_gain,
        "terminal_gain": qps.terminal_gain,
        "transition": qps.transition,
        "input_matrix": qps.input_matrix,
        "inputs": jnp.asarray(0.1 * generator.normal(size=(batch, 5, 2))),
        "nominal": jnp.asarray(nominal),
        "errors": jnp.asarray(starts),
    }
    return point, jnp.asarray(np.arange(batch) % 6, jnp.int32)


@pytest.mark.parametrize("restart", [True, False])
def test_reverse_mode_gives_what_differences_do(qps, starts, restart):
    generator = np.random.default_rng(3)
    batch = len(starts)
    noise = 1e-3 * generator.normal(size=(batch, 3))
    point, stage = make_point(qps, starts + (0.0 if restart else noise), starts, generator)
    shapes = ((2,), (5, 2), (3,))
    weights = [jnp.asarray(generator.normal(size=(batch, *shape))) for shape in shapes]
    weights.append(jnp.zeros(batch))
    weigh, find_slope = weigh_steps(restart)

    _, told = weigh(point, qps, stage, weights)
    kinds = {
        "free": (told.status == qp.SOLVED) & ~told.active,
        "active": (told.status == qp.SOLVED) & told.active,
        "backup": told.status == qp.INFEASIBLE,
    }
    assert all(np.sum(kind) >= 3 for kind in kinds.values())
    slope, _ = find_slope(point, qps, stage, weights)
    for name, array in point.items():
        finite = np.isfinite(array)
        size = np.maximum(np.abs(np.where(finite, array, 0.0)), 1e-3)
        way = np.where(finite, size * generator.normal(size=array.shape), 0.0)
        ahead, _ = weigh({**point, name: array + STEP * way}, qps, stage, weights)
        back, _ = weigh({**point, name: array - STEP * way}, qps, stage, weights)
        expected = float(ahead - back) / (2 * STEP)
        found = float(np.sum(np.asarray(slope[name])[finite] * way[finite]))
        assert found == pytest.approx(expected, rel=DIFFERENCE, abs=DIFFERENCE), name


@pytest.mark.parametrize("restart", [True, False])
def test_diagnostics_have_no_derivative(qps, starts, restart):
    batch = len(starts)
    nothing = [jnp.zeros((batch, *shape)) for shape in ((2,), (5, 2), (3,))]
    weights = [*nothing, jnp.ones(batch)]
    free = np.tile(starts[:4], (batch // 4, 1))
    assert planning.are_all_free(planning.take_qp(qps, jnp.int32(0)), jnp.asarray(free))
    _, find_slope = weigh_steps(restart)
    for some in (free, starts):
        point, stage = make_point(qps, some, some, np.random.default_rng(4))
        slope, _ = find_slope(point, qps, stage, weights)
        for name, array in slope.items():
            np.testing.assert_array_equal(array, 0.0, name)
