"""The reverse mode of a step of the tube-MPC beside central differences: free plans, plans with
active rows and the backup, started at the measured error or at the nominal one."""

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


@pytest.mark.parametrize("restart", [True, False])
def test_reverse_mode_gives_what_differences_do(qps, starts, restart):
    generator = np.random.default_rng(3)
    batch = len(starts)
    noise = 1e-3 * generator.normal(size=(batch, 3))
    stage = jnp.asarray(np.arange(batch) % 6, jnp.int32)
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
        "nominal": jnp.asarray(starts),
        "errors": jnp.asarray(starts + (0.0 if restart else noise)),
    }
    weights = [jnp.asarray(generator.normal(size=(batch, *rest))) for rest in ((2,), (5, 2), (3,))]

    def act(point):
        names = set(point) - {"inputs", "nominal", "errors"}
        changed = qps._replace(**{name: point[name] for name in names})
        state = mpc.MpcState(point["inputs"], stage, point["nominal"])
        return mpc.act(changed, jnp.int32(0), state, point["errors"], restart)

    def weigh(point):
        inputs, memory, _ = act(point)
        parts = (inputs, memory.inputs, memory.nominal)
        return sum(jnp.sum(weight * part) for weight, part in zip(weights, parts, strict=True))

    _, _, told = jax.jit(act)(point)
    kinds = {
        "free": (told.status == qp.SOLVED) & ~told.active,
        "active": (told.status == qp.SOLVED) & told.active,
        "backup": told.status == qp.INFEASIBLE,
    }
    assert all(np.sum(kind) >= 3 for kind in kinds.values())
    slope = jax.jit(jax.grad(weigh))(point)
    value = jax.jit(weigh)
    for name, array in point.items():
        finite = np.isfinite(array)
        size = np.maximum(np.abs(np.where(finite, array, 0.0)), 1e-3)
        way = np.where(finite, size * generator.normal(size=array.shape), 0.0)
        ahead = value({**point, name: array + STEP * way})
        back = value({**point, name: array - STEP * way})
        expected = float(ahead - back) / (2 * STEP)
        found = float(np.sum(np.asarray(slope[name])[finite] * way[finite]))
        assert found == pytest.approx(expected, rel=DIFFERENCE, abs=DIFFERENCE), name


def test_diagnostics_have_no_derivative(qps, starts):
    errors = jnp.asarray(starts)

    def residuals(errors):
        state = mpc.initial_state(errors, 5, 2)
        return jnp.sum(mpc.act(qps, jnp.int32(0), state, errors, True)[2].residual)

    free = 0.1 * errors[:4]
    assert planning.are_all_free(planning.take_qp(qps, jnp.int32(0)), free)
    for some in (free, errors[:20]):
        np.testing.assert_array_equal(jax.grad(residuals)(some), 0.0)
