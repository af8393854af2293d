"""Laws of slips whose changes are limited: they start anywhere, never move faster than they may,
and get where the process that they follow wants them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtube.plant.limited_slips import Limited
from jaxtube.plant.slip import Situation
from jaxtube.plant.slip_processes import PROCESSES

STEPS = (0.04, 0.07)
PERIODS = 200


def run(process, key=0):
    """Return deviations (periods, 2) of one realisation that moves over the ground."""
    run_key = jax.random.key(key)

    def period(memory, step):
        time = step.astype(float)
        place = 0.05 * time * jnp.ones((2, 2))
        errors = jnp.sin(0.1 * time) * jnp.ones(3)
        xi, memory = process.draw(run_key, step, memory, Situation(place, errors))
        return memory, xi

    steps = jnp.arange(PERIODS, dtype=jnp.int32)
    return np.asarray(jax.lax.scan(period, process.initial(run_key, jnp.float64), steps)[1])


@pytest.mark.parametrize("name", ["adversarial", "iid", "patches", "walk"])
def test_no_deviation_changes_by_more_than_its_step(name):
    xi = run(Limited(PROCESSES[name], STEPS))
    assert np.all(np.abs(np.diff(xi, axis=0)) <= np.array(STEPS) + 1e-12)
    assert np.all(np.abs(xi) <= 1)
    np.testing.assert_array_equal(xi[0], run(PROCESSES[name])[0])


def test_slips_ramp_from_extreme_to_extreme_and_an_unlimited_step_changes_nothing():
    xi = run(Limited(PROCESSES["vertex"], STEPS))
    assert np.all(np.any(xi == 1.0, axis=0) & np.any(xi == -1.0, axis=0))
    vertex = PROCESSES["vertex"]
    np.testing.assert_array_equal(run(Limited(vertex, (2.0, 2.0))), run(vertex))
