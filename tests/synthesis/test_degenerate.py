"""A law of plans on the edge between active sets: they are solved all the same."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxtube import qp
from jaxtube.control import planning
from jaxtube.scenario import load
from jaxtube.synthesis.design import design

STARTS = np.array(
    [
        [-0.10049609, -0.10063947, -0.00016761],
        [-0.1004326, -0.10060897, -0.00029615],
        [-0.10026513, -0.10086637, 0.00022579],
        [-0.100207621, -0.100798464, 0.00000678109244],
    ]
)
"""Measured errors, m, m, rad, at which seven rows of the tuned plan are active and an eighth is
1e-8 off its bound."""


def test_plans_are_solved_where_an_active_set_is_almost_degenerate():
    found = design(load("tuned"))
    window = planning.take_qp(jax.device_put(found.tube_qps), jnp.asarray(found.windows.index[0]))
    plans = jax.jit(planning.plan)(window, jnp.asarray(STARTS))
    np.testing.assert_array_equal(plans.status, np.full(len(STARTS), qp.SOLVED))
    assert plans.active.all()
