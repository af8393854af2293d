"""Descent by gradients over an unconstrained vector, every iterate inspected, every stop explained.

    minimise  E f(x; draws)   over x in R^n,

by Adam, whose step k sees the draws k - 1, and by L-BFGS on the frozen draws 0. With g the
gradient, clipped to a norm,

    m <- b1 m + (1 - b1) g,   v <- b2 v + (1 - b2) g^2,   x <- x - a_k m / (1 - b1^k) / (sqrt(v / (1 - b2^k)) + eps),

and a_k falling along half a cosine. Both are deterministic functions of the start and of what
`evaluate` and `inspect` return: called again with the same answers, they make the same calls and
end at the same bits.

Source: Kingma, Ba 2015, algorithm 1; Byrd, Lu, Nocedal, Zhu 1995 (L-BFGS-B of scipy); clipping:
Pascanu, Mikolov, Bengio 2013, algorithm 1; the cosine: Loshchilov, Hutter 2017, eq. (5), without
restarts.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.optimize import minimize

BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-8
CLIFF = 10.0
"""An objective this many times its least value so far has fallen off a cliff: loops that no longer
track."""
CLIFF_STEPS = 5
MEMORY = 10
"""Pairs of steps and gradient differences kept by L-BFGS."""

Point = Float[np.ndarray, " parameters"]
Gradient = Float[Array, " parameters"]


class Inspection(Protocol):
    """What the caller finds out about an iterate; a held-out value that is not finite is never the
    best."""

    @property
    def held_out(self) -> float: ...
    @property
    def certified(self) -> bool: ...


Evaluate = Callable[[Point, int], tuple[float, Point]]
"""Objective, positive, and its gradient at a point, over the draws of an index."""
Inspect = Callable[[int, Point], Inspection]


class Stop(enum.StrEnum):
    """Why a descent ended."""

    BUDGET = "budget"
    CONVERGED = "converged"
    PATIENCE = "patience"
    NOT_A_NUMBER = "not_a_number"
    CLIFF = "cliff"
    LINE_SEARCH = "line_search"


@dataclass(frozen=True, eq=False)
class Iterate:
    """An inspected iterate; iteration 0 is the start."""

    iteration: int
    point: Point
    held_out: float


@dataclass(frozen=True, eq=False)
class Outcome:
    """The end of a descent.

    point: the last iterate, not the best. sentence: one line that says what happened and what to
    change. best_certified, best_uncertified: of the least held-out value; None where no such
    iterate was inspected.
    """

    point: Point
    iterations: int
    evaluations: int
    stop: Stop
    sentence: str
    best_certified: Iterate | None
    best_uncertified: Iterate | None


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
    """Descend by Adam, fresh draws each step: step k = 1, 2, .. is one evaluation, over the draws k
    - 1.

    Args:
        inspect: is called with the start as iteration 0 and with the point after every step.
        names: of the parameters, for the sentence.
        budget: evaluations, hence steps, at most.
        patience: inspections in a row without a lower held-out value after which to stop.
        learning_rate: of the first step; about the change of each parameter in it.
        final_share: of the learning rate left in step `budget`.
        largest_gradient: norm to which a longer gradient is scaled down.

    Returns: the outcome; numbers that are not finite, and cliffs, end the descent and are told
    there.

    Raises: ValueError for settings out of range.
    """
    positive = {
        "budget": budget,
        "patience": patience,
        "learning_rate": learning_rate,
        "final_share": final_share,
    }
    _refuse(
        start,
        names,
        positive | ({} if largest_gradient is None else {"largest_gradient": largest_gradient}),
    )
    watch = _Watch(evaluate, inspect, start, names, budget, patience, "lower the learning rate or ")
    moments = _Moments(jnp.zeros(len(names), start.dtype), jnp.zeros(len(names), start.dtype))
    try:
        watch.inspect(start)
        while True:
            value, gradient = watch.evaluate(watch.point, draws=watch.evaluations)
            watch.refuse_cliff(value)
            rate = cosine(learning_rate, final_share, watch.iteration, budget)
            step, moments = _adam_step(
                _clipped(jnp.asarray(gradient), largest_gradient), moments, watch.iteration + 1
            )
            watch.inspect(np.asarray(watch.point - rate * np.asarray(step)))
    except _Ended as ended:
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
        inspect: is called with the start as iteration 0 and with every iterate that a line search
            accepts.
        names: of the parameters, for the sentence.
        budget: evaluations at most; those of line searches count.
        patience: inspections in a row without a lower held-out value after which to stop.
        tolerance: converged where the largest entry of the gradient, or the relative decrease of
            the objective in one iteration (absolute for objectives below one), is no more.

    Returns: the outcome; numbers that are not finite, and failed line searches, end the descent and
    are told there.

    Raises: ValueError for settings out of range.
    """
    _refuse(start, names, {"budget": budget, "patience": patience, "tolerance": tolerance})
    watch = _Watch(evaluate, inspect, start, names, budget, patience, "")
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
    except _Ended as ended:
        return watch.outcome(ended)
    if result.success:
        sentence = f"converged at iteration {watch.iteration}: a lower tolerance alone goes further"
        return watch.outcome(_Ended(Stop.CONVERGED, sentence))
    problem = f"line search found no lower objective from iteration {watch.iteration} ({watch.farthest(watch.point)})"
    cure = "raise the tolerance if this is rounding, start elsewhere if it is a cliff"
    return watch.outcome(_Ended(Stop.LINE_SEARCH, f"{problem}; {cure}"))


def cosine(learning_rate: float, final_share: float, step: int, steps: int) -> float:
    """Return the learning rate in step 0 .. steps - 1: from the whole down to its final share."""
    done = step / max(steps - 1, 1)
    return learning_rate * (final_share + (1 - final_share) * (1 + math.cos(math.pi * done)) / 2)


# --------------------------------------------------------------------------------------------- Adam


class _Moments(NamedTuple):
    """Running means of the gradient and of its square."""

    m: Gradient
    v: Gradient


def _adam_step(g: Gradient, moments: _Moments, k: int) -> tuple[Gradient, _Moments]:
    """Return step k = 1, 2, .. for the learning rate one, and the next moments."""
    m = BETA_1 * moments.m + (1 - BETA_1) * g
    v = BETA_2 * moments.v + (1 - BETA_2) * g**2
    return m / (1 - BETA_1**k) / (jnp.sqrt(v / (1 - BETA_2**k)) + EPSILON), _Moments(m, v)


def _clipped(gradient: Gradient, largest: float | None) -> Gradient:
    if largest is None:
        return gradient
    return gradient * jnp.minimum(1.0, largest / jnp.linalg.norm(gradient))


# ---------------------------------------------------------------------------------------- the watch


class _Ended(Exception):
    """The end of a descent; thrown because scipy's loop can be left in no other way."""

    def __init__(self, stop: Stop, sentence: str) -> None:
        super().__init__(stop, sentence)
        self.stop, self.sentence = stop, sentence


@dataclass(eq=False)
class _Watch:
    """Counts evaluations and iterates, keeps the best, and ends the descent when a rule says so."""

    objective: Evaluate
    inspector: Inspect
    start: Point
    names: Sequence[str]
    budget: int
    patience: int
    gentler: str = ""
    iteration: int = -1
    evaluations: int = 0
    lowest: float = math.inf
    beyond_cliff: int = 0
    best: dict[bool, Iterate | None] = field(default_factory=lambda: {True: None, False: None})

    def __post_init__(self) -> None:
        self.point = self.start

    def evaluate(self, point: Point, draws: int = 0) -> tuple[float, Point]:
        """Return finite numbers, or end the descent."""
        if self.evaluations == self.budget:
            used = (
                f"the budget of {self.budget} evaluations is used up at iteration {self.iteration}"
            )
            raise _Ended(Stop.BUDGET, f"{used}; raise the budget to go on")
        value, gradient = self.objective(np.array(point), draws)
        value, gradient = float(value), np.array(gradient, self.start.dtype)
        self.evaluations += 1
        if not math.isfinite(value):
            raise self._not_a_number("objective", self.farthest(point))
        if not np.isfinite(gradient).all():
            raise self._not_a_number(
                "gradient", self._told(int(np.argmin(np.isfinite(gradient))), point)
            )
        return value, gradient

    def refuse_cliff(self, value: float) -> None:
        """End the descent at the last of `CLIFF_STEPS` values in a row that are beyond a cliff."""
        self.lowest = min(self.lowest, value)
        self.beyond_cliff = self.beyond_cliff + 1 if value > CLIFF * self.lowest > 0 else 0
        if self.beyond_cliff == CLIFF_STEPS:
            problem = (
                f"objective is over {CLIFF:g} times its least value so far, {self.lowest:.4g}, at"
            )
            where = f"{CLIFF_STEPS} iterations in a row up to {self.iteration} ({self.farthest(self.point)})"
            raise _Ended(
                Stop.CLIFF,
                f"{problem} {where}; lower the learning rate or clip gradients to a smaller norm",
            )

    def inspect(self, point: Point) -> None:
        """Take the next iterate, and end the descent when patience is over."""
        self.point, self.iteration = np.array(point), self.iteration + 1
        found = self.inspector(self.iteration, np.array(point))
        iterate, certified = (
            Iterate(self.iteration, self.point, float(found.held_out)),
            bool(found.certified),
        )
        if math.isfinite(iterate.held_out) and _rank(iterate) < _rank(self.best[certified]):
            self.best[certified] = iterate
        best = self.best[True] or self.best[False]  # what would be returned
        if self.iteration - (best.iteration if best else 0) >= self.patience:
            least = (
                f"{best.held_out:.4g} of iteration {best.iteration}"
                if best
                else "any finite number"
            )
            problem = f"held-out value is not below {least} after {self.patience} more"
            raise _Ended(
                Stop.PATIENCE,
                f"{problem}; use the best iterate, or raise the patience to look further",
            )

    def outcome(self, ended: _Ended) -> Outcome:
        """Tell how it ended."""
        best = self.best[True], self.best[False]
        return Outcome(
            self.point, self.iteration, self.evaluations, ended.stop, ended.sentence, *best
        )

    def farthest(self, point: Point) -> str:
        """Tell the parameter that went farthest from the start, the likeliest cause of trouble."""
        return self._told(int(np.argmax(np.abs(point - self.start))), point)

    def _told(self, index: int, point: Point) -> str:
        return f"parameter {self.names[index]} = {point[index]:.4g}"

    def _not_a_number(self, what: str, parameter: str) -> _Ended:
        cure = (self.gentler if self.iteration else "") + "start closer to a stable design"
        problem = f"{what} is not a number at iteration {self.iteration} ({parameter})"
        return _Ended(Stop.NOT_A_NUMBER, f"{problem}; {cure}")


def _rank(iterate: Iterate | None) -> tuple[float, int]:
    return (iterate.held_out, iterate.iteration) if iterate else (math.inf, 0)


def _refuse(start: Point, names: Sequence[str], positive: dict[str, float]) -> None:
    """Raise ValueError for settings no descent can begin with."""
    if (
        start.shape != (len(names),)
        or not names
        or start.dtype.kind != "f"
        or not np.isfinite(start).all()
    ):
        raise ValueError(
            f"start = {start}: must be a finite float for each of the {len(names)} names; give as many"
        )
    for name, value in positive.items():
        if not 0 < value < math.inf:
            raise ValueError(f"{name} = {value}: must be positive and finite; choose it above zero")
