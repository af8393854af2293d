"""Whether what is allowed explains a measured w: a verdict with proof on either side.

    explained   deviations |t| <= 1 are found for which w(t) is the measured one
    refuted     w lies outside the zonotope Z = {w(0) + G t : |t| <= 1} by more than rho, which
                encloses all that w(t) can be (`jaxtube.witness.motion`)
    undecided   neither: w lies within rho of the boundary

A zonotope in space has the facets n = G_i x G_j, with support numbers h(n) = sum_k |n . G_k|. With
d = w - w(0) and |n| taken entry by entry,

    usage = max_n |n . d| / h(n)        refuted: |n . d| > h(n) + |n| . rho for some n

so that at the usage 1 w lies on the boundary of Z: by that much all that is allowed would have to
be scaled about its middle. The facet of the usage gives the deviations of the least max |t|,

    t_k = usage sign(n . d) sign(n . G_k),   and those within the facet by least squares,

from which Newton steps by the pseudo-inverse of G lead to w itself. Where they leave |t| <= 1,
linear programs minimise max |t|, linearised anew at each answer.

Source: facets of zonotopes as in McMullen, On zonotopes, Trans. AMS 1971; the rest is new.
"""

from __future__ import annotations

from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import linprog

from jaxtube.witness.motion import Allowance, Reach, add_disturbance
from jaxtube.witness.spans import Spans
from sets.interval import Dual

BLOCK = 50
"""Spans that are judged at once: the facets of many deviations need memory."""

DEGENERATE = 1e-12
"""Length of a normal, relative, below which two generators are parallel."""

FLAT = 1e-9
"""Of the largest n . G_k, below which a generator lies within a facet."""

FAR = 2.0
"""Deviations beyond which no solution is looked for."""

ITERATIONS = 4
"""Linearisations at most."""

EXACT = 1e-9
"""By which w of a solution may miss the measured one, m and rad: rounding."""

WITHIN = 1e-7
"""By which a solution of a linear program may exceed 1."""


class Verdict(NamedTuple):
    """What can be said of each span."""

    usage: Float[np.ndarray, "k"]
    explained: Bool[np.ndarray, "k"]
    refuted: Bool[np.ndarray, "k"]
    excess: Float[np.ndarray, "k 3"]  # by which a coordinate alone leaves all it may be, m, m, rad

    @property
    def undecided(self) -> Bool[np.ndarray, "k"]:
        """Spans of which neither is proved."""
        return ~self.explained & ~self.refuted


class _Linear(NamedTuple):
    """w near some deviations."""

    value: Float[np.ndarray, "k 3"]
    slope: Float[np.ndarray, "k 3 v"]


def judge(
    spans: Spans, allowed: Allowance, reach: Reach, measured: Float[np.ndarray, "k 3"]
) -> Verdict:
    """Judge every span (module docstring); NaN is refuted."""
    rows = np.split(np.arange(len(measured)), range(BLOCK, len(measured), BLOCK))
    parts = [_compare(reach.take(block), measured[block]) for block in rows]
    usage, most, *start = np.concatenate(parts).T
    refuted = ~(most <= 1.0)
    explained = ~refuted & _is_solved_from(np.transpose(start), spans, allowed, measured)
    for row in np.flatnonzero(~explained & ~refuted):
        one = np.arange(len(measured)) == row
        explained[row] = _is_explained(spans.take(one), allowed, measured[one])
    missed = np.abs(measured - reach.centre) - reach.half_widths - reach.remainder
    return Verdict(usage, explained, refuted, np.maximum(missed, 0.0))


def _compare(reach: Reach, measured: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 2+v"]:
    """Return usages, the numbers above 1 of spans that are refuted, and the least deviations."""
    normals = _find_normals(reach.generators)
    along = normals @ reach.generators
    support = np.abs(along).sum(axis=2)
    spread = np.einsum("kfi,ki->kf", np.abs(normals), reach.remainder)
    off = np.einsum("kfi,ki->kf", normals, measured - reach.centre)
    with np.errstate(divide="ignore", invalid="ignore"):
        numbers = np.stack([np.abs(off) / support, np.abs(off) / (support + spread)], axis=2)
    # 0 / 0: no facet, or a w at the centre of what cannot move; NaN of a measurement stays.
    numbers[off == 0.0] = 0.0
    facet = numbers[:, :, 0].argmax(axis=1)[:, None]
    largest = numbers.max(axis=1)
    sign = np.sign(np.take_along_axis(off, facet, axis=1))
    across = np.take_along_axis(along, facet[:, :, None], axis=1)[:, 0]
    return np.hstack([largest, _deviate_to_facet(reach, measured, largest[:, :1] * sign, across)])


def _deviate_to_facet(
    reach: Reach,
    measured: Float[np.ndarray, "k 3"],
    usage: Float[np.ndarray, "k 1"],
    across: Float[np.ndarray, "k v"],
) -> Float[np.ndarray, "k v"]:
    """Return the least deviations, to first order.

    Args:
        reach: whatever w may be.
        measured: w.
        usage: with the sign of n . d.
        across: n . G of the facet that w lies behind.
    """
    is_within = np.abs(across) <= FLAT * np.abs(across).max(axis=1, keepdims=True)
    fixed = np.where(is_within, 0.0, np.nan_to_num(usage, posinf=0.0, neginf=0.0) * np.sign(across))
    rest = measured - reach.centre - np.einsum("kiv,kv->ki", reach.generators, fixed)
    own = np.where(is_within[:, None], reach.generators, 0.0)
    free = np.linalg.pinv(own) @ np.nan_to_num(rest)[:, :, None]
    return fixed + free[:, :, 0]


def _find_normals(generators: Float[np.ndarray, "k 3 v"]) -> Float[np.ndarray, "k f 3"]:
    """Return the normals of the facets, and the axes; 0 where two generators are parallel."""
    first, second = np.array(list(combinations(range(generators.shape[2]), 2))).T
    columns = np.moveaxis(generators, 2, 1)
    normals = np.cross(columns[:, first], columns[:, second])
    length = np.linalg.norm(normals, axis=2)
    lengths = np.linalg.norm(columns, axis=2)
    is_parallel = length <= DEGENERATE * lengths[:, first] * lengths[:, second]
    normals[is_parallel] = 0.0
    axes = np.broadcast_to(np.eye(3), (len(generators), 3, 3))
    return np.concatenate([normals, axes], axis=1)


def _is_solved_from(
    start: Float[np.ndarray, "k v"],
    spans: Spans,
    allowed: Allowance,
    measured: Float[np.ndarray, "k 3"],
) -> Bool[np.ndarray, "k"]:
    """Tell from which deviations Newton's method leads to allowed ones that explain a span."""
    deviation = np.clip(start, -FAR, FAR)
    near = _linearise(spans, allowed, deviation)
    for _ in range(ITERATIONS):
        step = np.linalg.pinv(near.slope) @ np.nan_to_num(measured - near.value)[:, :, None]
        deviation = np.clip(deviation + step[:, :, 0], -FAR, FAR)
        near = _linearise(spans, allowed, deviation)
    return _solves(deviation, near.value, measured)


def _solves(
    deviation: Float[np.ndarray, "k v"],
    value: Float[np.ndarray, "k 3"],
    measured: Float[np.ndarray, "k 3"],
) -> Bool[np.ndarray, "k"]:
    """Tell where deviations are allowed and give the measured w."""
    is_allowed = np.abs(deviation).max(axis=1) <= 1.0 + WITHIN
    return is_allowed & (np.abs(value - measured).max(axis=1) <= EXACT)


def _is_explained(span: Spans, allowed: Allowance, measured: Float[np.ndarray, "1 3"]) -> bool:
    """Search what explains one span with the least deviations; False where nothing was found."""
    deviation = np.zeros((1, allowed.count(span.pieces)))
    near = _linearise(span, allowed, deviation)
    for _ in range(ITERATIONS):
        target = (measured - near.value)[0] + near.slope[0] @ deviation[0]
        found = _deviate_least(near.slope[0], target)
        if found is None:
            return False
        deviation = found[None]
        near = _linearise(span, allowed, deviation)
        if _solves(deviation, near.value, measured)[0]:
            return True
    return False


def _linearise(spans: Spans, allowed: Allowance, deviation: Float[np.ndarray, "k v"]) -> _Linear:
    """Return w and its derivatives by the deviations."""
    middle, half = allowed.box(spans.pieces)
    seeds = np.diag(half)[:, :, None] * np.ones(len(deviation))
    values = (middle + half * deviation).T
    variables = [Dual(value, seed) for value, seed in zip(values, seeds, strict=True)]
    outputs = add_disturbance(spans, allowed, variables)
    value = np.stack([output.value for output in outputs], axis=1)
    return _Linear(value, np.stack([output.gradient.T for output in outputs], axis=1))


def _deviate_least(
    slope: Float[np.ndarray, "3 v"], target: Float[np.ndarray, "3"]
) -> Float[np.ndarray, " v"] | None:
    """Return the solution t of slope t = target with the least max |t|, None without one."""
    count = slope.shape[1]
    one = np.ones((count, 1))
    above = np.hstack([np.eye(count), -one])
    below = np.hstack([-np.eye(count), -one])
    answer = linprog(
        np.append(np.zeros(count), 1.0),
        A_ub=np.vstack([above, below]),
        b_ub=np.zeros(2 * count),
        A_eq=np.hstack([slope, np.zeros((3, 1))]),
        b_eq=target,
        bounds=[(None, None)] * count + [(0.0, None)],
    )
    return answer.x[:-1] if answer.success else None
