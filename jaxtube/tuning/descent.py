"""Descent by gradients over an unconstrained vector, every iterate inspected, every stop explained.

    minimise  E f(x; draws)   over x in R^n,

by Adam, whose step k sees the draws k - 1, and by L-BFGS on the frozen draws 0. With g the
gradient, clipped to a norm,

    m <- b1 m + (1 - b1) g,   v <- b2 v + (1 - b2) g^2
    x <- x - a_k m / (1 - b1^k) / (sqrt(v / (1 - b2^k)) + eps),

and a_k falling along half a cosine. Both are deterministic functions of the start and of what
`evaluate` and `inspect` return: called again with the same answers, they make the same calls and
end at the same bits.

Source: Kingma, Ba 2015, algorithm 1; Byrd, Lu, Nocedal, Zhu 1995 (L-BFGS-B of scipy); clipping:
Pascanu, Mikolov, Bengio 2013, algorithm 1; the cosine: Loshchilov, Hutter 2017, eq. (5), without
restarts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float
from scipy.optimize import minimize

from jaxtube.tuning.watch import EndOfDescent, Evaluate, Inspect, Outcome, Point, Stop, Watch

BETA_1 = 0.9
BETA_2 = 0.999
EPSILON = 1e-8
MEMORY = 10
"""Pairs of steps and gradient differences kept by L-BFGS."""

Gradient = Float[Array, " parameters"]


def adam(
    evaluate: Evaluate,
    inspect: Inspect,
    start: Point,
    names: Sequence[str],
    *,
    budget: int,
    patience: int,
    learning_rate: float,
    final_share: float = 0.1,
    largest_gradient: float | None = None,
) -> Outcome:
    """Descend by Adam, with fresh draws in each step: step k = 1, 2, .. is one evaluation, over the
    draws k - 1.

    Args:
        evaluate: returns objective and gradient.
        inspect: is called with the start as iteration 0 and with the point after every step.
        start: where to begin.
        names: of the parameters, for the sentence.
        budget: evaluations, hence steps, at most.
        patience: inspections in a row without a lower held-out value after which to stop.
        learning_rate: of the first step; about the change of each parameter in it.
        final_share: of the learning rate left in step `budget`.
        largest_gradient: norm to which a longer gradient is scaled down.

    Returns:
        The outcome; numbers that are not finite, and cliffs, end the descent and are told there.

    Raises:
        ValueError: for settings out of range.
    """
    _refuse_start(start, names)
    _refuse_not_positive(
        {
            "budget": budget,
            "patience": patience,
            "learning_rate": learning_rate,
            "final_share": final_share,
        }
    )
    if largest_gradient is not None:
        _refuse_not_positive({"largest_gradient": largest_gradient})
    watch = Watch(evaluate, inspect, start, names, budget, patience, "lower the learning rate or ")
    zero = jnp.zeros(len(names), start.dtype)
    moments = _Moments(zero, zero)
    try:
        watch.inspect(start)
        while True:
            value, gradient = watch.evaluate(watch.point, draws=watch.evaluations)
            watch.refuse_cliff(value)
            rate = cosine(learning_rate, final_share, watch.iteration, budget)
            clipped = _clip(jnp.asarray(gradient), largest_gradient)
            step, moments = _adam_step(clipped, moments, watch.iteration + 1)
            watch.inspect(np.asarray(watch.point - rate * np.asarray(step)))
    except EndOfDescent as ended:
        return watch.outcome(ended)


def lbfgs(
    evaluate: Evaluate,
    inspect: Inspect,
    start: Point,
    names: Sequence[str],
    *,
    budget: int,
    patience: int,
    tolerance: float = 1e-12,
) -> Outcome:
    """Descend by L-BFGS on the frozen draws 0.

    Args:
        evaluate: returns objective and gradient.
        inspect: is called with the start as iteration 0 and with every iterate that a line search
            accepts.
        start: where to begin.
        names: of the parameters, for the sentence.
        budget: evaluations at most; those of line searches count.
        patience: inspections in a row without a lower held-out value after which to stop.
        tolerance: converged where the largest entry of the gradient, or the relative decrease of
            the objective in one iteration (absolute for objectives below one), is no more.

    Returns:
        The outcome; numbers that are not finite, and failed line searches, end the descent and are
        told there.

    Raises:
        ValueError: for settings out of range.
    """
    _refuse_start(start, names)
    _refuse_not_positive({"budget": budget, "patience": patience, "tolerance": tolerance})
    watch = Watch(evaluate, inspect, start, names, budget, patience)
    # scipy's own limits are out of reach: the watch ends the descent, at the budget exactly.
    options = {
        "maxcor": MEMORY,
        "ftol": tolerance,
        "gtol": tolerance,
        "maxfun": 2 * budget,
        "maxiter": 2 * budget,
    }
    try:
        watch.inspect(start)
        result = minimize(
            watch.evaluate,
            start,
            jac=True,
            method="L-BFGS-B",
            callback=watch.inspect,
            options=options,
        )
    except EndOfDescent as ended:
        return watch.outcome(ended)
    return watch.outcome(_explain(result.success, watch))


def _explain(success: bool, watch: Watch) -> EndOfDescent:
    """Return why L-BFGS returned by itself."""
    if success:
        sentence = f"converged at iteration {watch.iteration}: a lower tolerance alone goes further"
        return EndOfDescent(Stop.CONVERGED, sentence)
    return EndOfDescent(
        Stop.LINE_SEARCH,
        f"line search found no lower objective from iteration {watch.iteration} "
        f"({watch.farthest(watch.point)}); raise the tolerance if this is rounding, start "
        "elsewhere if it is a cliff",
    )


def cosine(learning_rate: float, final_share: float, step: int, steps: int) -> float:
    """Return the learning rate in step 0 .. steps - 1: from the whole down to its final share."""
    done = step / max(steps - 1, 1)
    return learning_rate * (final_share + (1 - final_share) * (1 + math.cos(math.pi * done)) / 2)


class _Moments(NamedTuple):
    """Running means of the gradient and of its square."""

    m: Gradient
    v: Gradient


def _adam_step(g: Gradient, moments: _Moments, k: int) -> tuple[Gradient, _Moments]:
    """Return step k = 1, 2, .. for the learning rate one, and the next moments."""
    m = BETA_1 * moments.m + (1 - BETA_1) * g
    v = BETA_2 * moments.v + (1 - BETA_2) * g**2
    step = m / (1 - BETA_1**k) / (jnp.sqrt(v / (1 - BETA_2**k)) + EPSILON)
    return step, _Moments(m, v)


def _clip(gradient: Gradient, largest: float | None) -> Gradient:
    """Return a gradient scaled down to the largest norm."""
    if largest is None:
        return gradient
    return gradient * jnp.minimum(1.0, largest / jnp.linalg.norm(gradient))


def _refuse_start(start: Point, names: Sequence[str]) -> None:
    """Raise ValueError for a start no descent can begin at."""
    fits = len(names) > 0 and start.shape == (len(names),)
    if not fits or start.dtype.kind != "f" or not np.isfinite(start).all():
        raise ValueError(
            f"start = {start}: must be a finite float for each of the {len(names)} names; "
            "give as many"
        )


def _refuse_not_positive(settings: Mapping[str, float]) -> None:
    """Raise ValueError for a setting that is not positive and finite."""
    for name, value in settings.items():
        if not 0 < value < math.inf:
            raise ValueError(f"{name} = {value}: must be positive and finite; choose it above zero")
