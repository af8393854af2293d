# ruff: noqa: E741 -- l and u are the letters of the problem
"""What peers are given and what they answer: programs that share their matrices, one after the
other.

    minimise over x   1/2 x' P x + q' x   subject to   l <= A x <= u

Source: new.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

INFINITE = 1e30
"""Where a bound is absent, for solvers that have no infinity."""


class Problems(NamedTuple):
    """Programs that share P and A; bounds are infinite where absent, in the same rows of all."""

    P: Float[np.ndarray, "n n"]
    A: Float[np.ndarray, "m n"]
    q: Float[np.ndarray, "k n"]
    l: Float[np.ndarray, "k m"]
    u: Float[np.ndarray, "k m"]

    def take(self, chosen: slice) -> Problems:
        """Return some of the programs."""
        return self._replace(q=self.q[chosen], l=self.l[chosen], u=self.u[chosen])


class Answers(NamedTuple):
    """Answers of all programs: x and multipliers, positive at u and negative at l."""

    x: Float[np.ndarray, "k n"]
    multipliers: Float[np.ndarray, "k m"]


class Solver(NamedTuple):
    """A solver that has been given its programs.

    Attributes:
        run: solves all of them, and keeps nothing.
        answer: solves all of them and returns the answers.
        clock: solves all of them and returns the seconds of each by the solver's own clock; None
            where that is not asked for.
    """

    run: Callable[[], object]
    answer: Callable[[], Answers]
    clock: Callable[[], Float[np.ndarray, " k"]] | None = None


def one_by_one(
    data: Sequence[tuple[Any, ...]],
    solve: Callable[..., Any],
    read: Callable[[Any], tuple[Any, Any]],
    read_clock: Callable[[Any], float] | None = None,
) -> Solver:
    """Return the solver that calls a function for one program after the other.

    Args:
        data: arguments of `solve` for each program, made ready outside of what is timed.
        solve: updates and solves.
        read: returns x and multipliers of what `solve` returned.
        read_clock: returns the seconds that the solver itself took.
    """

    def run() -> None:
        for each in data:
            solve(*each)

    def answer() -> Answers:
        found = [tuple(map(np.array, read(solve(*each)))) for each in data]
        return Answers(np.array([x for x, _ in found]), np.array([y for _, y in found]))

    def clock() -> Float[np.ndarray, " k"]:
        assert read_clock
        return np.array([read_clock(solve(*each)) for each in data])

    return Solver(run, answer, clock if read_clock else None)


class OneSided(NamedTuple):
    """The same programs with rows G x <= h: those of u, then those of l that are finite."""

    G: Float[np.ndarray, "g n"]
    h: Float[np.ndarray, "k g"]
    upper: np.ndarray  # rows of A whose upper bound is finite
    lower: np.ndarray

    @classmethod
    def of(cls, problems: Problems) -> OneSided:
        """Return programs with one-sided rows."""
        upper = np.flatnonzero(np.isfinite(problems.u).any(axis=0))
        lower = np.flatnonzero(np.isfinite(problems.l).any(axis=0))
        G = np.concatenate([problems.A[upper], -problems.A[lower]])
        h = np.concatenate([problems.u[:, upper], -problems.l[:, lower]], axis=1)
        return cls(G, h, upper, lower)

    def fold(self, multipliers: Float[np.ndarray, " g"], rows: int) -> Float[np.ndarray, " m"]:
        """Return multipliers of two-sided rows."""
        y = np.zeros(rows)
        y[self.upper] += multipliers[: len(self.upper)]
        y[self.lower] -= multipliers[len(self.upper) :]
        return y


def contiguous(*arrays: np.ndarray) -> Iterator[tuple[np.ndarray, ...]]:
    """Yield what belongs to each program, every array on its own in memory."""
    return zip(*[[np.array(row) for row in array] for array in arrays], strict=True)


def without_infinity(bounds: Float[np.ndarray, "k m"]) -> Float[np.ndarray, "k m"]:
    """Return bounds whose infinities are finite."""
    return np.clip(bounds, -INFINITE, INFINITE)
