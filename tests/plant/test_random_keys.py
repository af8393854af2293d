"""Keys hash to the bits of JAX's own generator, whatever is drawn from them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtube.plant.random_keys import make_key, wrap_key

SEEDS = [0, 7, -1, 2**31, 2**40 + 3]
DRAWS = {
    "uniform": lambda key: jax.random.uniform(key, (3, 2), float, -1.0, 1.0),
    "single": lambda key: jax.random.uniform(key, (), jnp.float32),
    "bytes": lambda key: jax.random.bits(key, (5,), "uint8"),
    "words": lambda key: jax.random.bits(key, (5,), "uint32"),
    "signs": lambda key: jax.random.rademacher(key, (4,), float),
    "integers": lambda key: jax.random.randint(key, (4,), 0, 99),
    "exponential": lambda key: jax.random.exponential(key, (3,)),
    "nothing": lambda key: jax.random.uniform(key, (0,)),
    "split": lambda key: jax.random.key_data(jax.random.split(key, (2, 3))),
    "folded": lambda key: jax.random.key_data(jax.random.fold_in(key, 2**32 - 1)),
}


@pytest.mark.parametrize("seed", SEEDS)
def test_a_seed_makes_the_key_of_jax(seed):
    own = make_key(seed)
    np.testing.assert_array_equal(
        jax.random.key_data(own), jax.random.key_data(jax.random.key(seed))
    )


@pytest.mark.parametrize("name", DRAWS)
def test_draws_are_those_of_jax(name):
    draw = DRAWS[name]
    for folded in (0, 5):
        own = jax.random.fold_in(make_key(11), folded)
        theirs = jax.random.fold_in(jax.random.key(11, impl="threefry2x32"), folded)
        np.testing.assert_array_equal(draw(own), draw(theirs))


def test_a_batch_of_keys_draws_what_each_key_draws():
    keys = jax.random.split(make_key(3), 4)
    together = jax.jit(jax.vmap(DRAWS["uniform"]))(keys)
    alone = [DRAWS["uniform"](key) for key in keys]
    np.testing.assert_array_equal(together, np.stack(alone))


def test_keys_survive_being_taken_apart():
    keys = jax.random.split(make_key(3), 4)
    again = wrap_key(jax.random.key_data(keys))
    np.testing.assert_array_equal(
        jax.vmap(DRAWS["uniform"])(again), jax.vmap(DRAWS["uniform"])(keys)
    )
