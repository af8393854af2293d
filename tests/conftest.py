"""All tests run in float64 with strict promotion: a silent cast is an error."""

import jax

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
