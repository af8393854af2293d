"""How good answers are: the residual of the optimality conditions as the solver defines it, and the
distance to exact answers.

Source: `jaxtube.qp.fixed_point`.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxtube.experiments.bench.peers.problems import Answers, Problems
from jaxtube.qp import fixed_point
from jaxtube.qp.factors import factorise
from jaxtube.qp.fixed_point import TOLERANCE

WRONG = 1e-6
"""Distance to the exact answer, relative to its largest entry where that is above 1, from which on
an answer is wrong."""


class Accuracy(NamedTuple):
    """How good the answers of a solver are.

    Attributes:
        median, largest: of the residuals; infinite where there is no answer.
        above: answers whose residual is above what the batched solver accepts.
        wrong: answers away from the exact ones; None where these are not known.
    """

    median: float
    largest: float
    above: int
    wrong: int | None


def judge(problems: Problems, answers: Answers, exact: Answers | None) -> Accuracy:
    """Return how good answers are."""
    residual = find_residuals(problems, answers)
    above = int(np.sum(~(residual <= TOLERANCE[8])))
    wrong = None if exact is None else count_wrong(answers.x, exact.x)
    return Accuracy(float(np.median(residual)), float(np.max(residual)), above, wrong)


def count_wrong(x: Float[np.ndarray, "k n"], exact: Float[np.ndarray, "k n"]) -> int:
    """Return how many answers are away from exact ones, or no numbers."""
    scale = np.maximum(1.0, np.max(np.abs(exact), axis=1))
    return int(np.sum(~(np.max(np.abs(x - exact), axis=1) <= WRONG * scale)))


def find_residuals(problems: Problems, answers: Answers) -> Float[np.ndarray, " k"]:
    """Return the residual of every answer."""
    factors = factorise(jnp.asarray(problems.P), jnp.asarray(problems.A))
    instances = fixed_point.unit_rows(factors, *map(jnp.asarray, problems[2:]))
    multipliers = jnp.asarray(answers.multipliers) * factors.row_norms
    x = jnp.asarray(answers.x)
    return np.asarray(fixed_point.residual(factors, instances, x.T, multipliers.T))
