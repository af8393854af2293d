"""The sets that closed loops are measured against: facets, tubes along the reference, the model
and the cost of plans.

A point is outside a set when it is more than 1e-12 (m, rad, m/s, rad/s) beyond a facet. NaN is
outside.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int

from jaxtube.qp.batched_ldl import matmul
from jaxtube.qp.regions import AnyArray

OUTSIDE = 1e-12
"""What counts as outside is further out than this: beyond a facet, in the unit of its row, or in
m/s."""

FEW_FACETS = 16
"""Facets up to which a set is compared with points facet by facet."""


class Facets(NamedTuple):
    """A polytope {x: normals x <= offsets} and the box around it; arrays may carry leading axes."""

    normals: Float[AnyArray, "f n"]
    offsets: Float[AnyArray, " f"]  # infinite for a row that is only padding
    lower: Float[AnyArray, " n"]
    upper: Float[AnyArray, " n"]

    def at(self, step: Int[Array, ""]) -> Facets:
        """Return the polytope, which is due at every step."""
        return self


class FacetsByRegime(NamedTuple):
    """Polytopes of which one is due at a step, that of its regime; their rows stand one below the
    other."""

    normals: Float[AnyArray, "f n"]
    offsets: Float[AnyArray, " f"]
    lower: Float[AnyArray, "regimes n"]
    upper: Float[AnyArray, "regimes n"]
    owners: Int[AnyArray, " f"]  # the regime of each row
    regimes: Int[AnyArray, " steps"]  # that of each step

    def at(self, step: Int[Array, ""]) -> Facets:
        """Return the polytope that is due at a step; rows of the others are padding."""
        regime = self.regimes[step]
        offsets = jnp.where(self.owners == regime, self.offsets, jnp.inf)
        return Facets(self.normals, offsets, self.lower[regime], self.upper[regime])


class Sections(NamedTuple):
    """The sections R_1 .. R_N of a tube, those of window `index[step]` being due at a step."""

    facets: Facets  # leading axes (windows, N)
    index: Int[AnyArray, " steps"]

    def at(self, step: Int[Array, ""]) -> Facets:
        """Return the sections that are due at a step, stages first."""
        window = self.index[step]
        return jax.tree.map(lambda array: array[window], self.facets)


@partial(
    jax.tree_util.register_dataclass,
    meta_fields=["tube", "settled"],
    data_fields=[
        "transitions",
        "input_matrices",
        "disturbance",
        "error",
        "input",
        "tubes",
        "ultimate",
        "poses",
        "map_corner",
        "map_cell",
        "cost_errors",
        "error_weight",
        "input_weight",
        "kept_gains",
        "command_step",
        "slip_radius",
    ],
)
@dataclass(frozen=True)
class Checks:
    """What a run is measured against.

    `ultimate` holds the half widths that bound the measured error once it has settled, `settled`
    the step from which that and the RMS count. `map_corner` and `map_cell` lay the grid of the
    trajectory map. With windows as in the controller, e^T cost_errors e + (F e)^T g + g^T H g / 2
    is the whole cost of a plan, whose first stage costs |e|^2 by the error weight and |g_0 - K e|^2
    by the input weight, K of `kept_gains`, which are 0 where errors cost. `input` is a set of (u,
    measured error). `command_step` is by how much a wheel's command may change from one period to
    the next, m/s; None for any. `slip_radius` is how wide half the intervals of learnt slips
    (right, left) may be, by the periods since the start, the last one for all later times; None
    where none are learnt.
    """

    transitions: Float[AnyArray, "steps 3 3"]
    input_matrices: Float[AnyArray, "steps 3 2"]
    disturbance: Facets | FacetsByRegime
    error: Facets
    input: Facets | FacetsByRegime
    tubes: dict[str, Sections]
    tube: str
    ultimate: Float[AnyArray, "3"]
    settled: int
    poses: Float[AnyArray, "steps+1 3"]
    map_corner: Float[AnyArray, "2"]
    map_cell: Float[AnyArray, ""]
    cost_errors: Float[AnyArray, "windows 3 3"]
    error_weight: Float[AnyArray, "3 3"]
    input_weight: Float[AnyArray, "2 2"]
    kept_gains: Float[AnyArray, "windows 2 3"]
    command_step: Float[AnyArray, ""] | None = None
    slip_radius: Float[AnyArray, "ages 2"] | None = None

    @property
    def horizon(self) -> int:
        """Steps that a plan is followed."""
        return self.tubes[self.tube].facets.offsets.shape[1]


class Judgement(NamedTuple):
    """Points against a polytope, the batch last; leading axes where the polytope has some."""

    outside: Bool[Array, " batch"]
    outside_box: Bool[Array, "n batch"]  # of the box around the polytope, by coordinate
    excess: Float[Array, "f batch"]  # over each facet
    usage: Float[Array, " batch"]  # 1 on a facet, more outside, relative to its offset


Coordinates = Sequence[Float[Array, " batch"]]
"""Points, coordinate by coordinate: kernels that run over neighbouring numbers make them."""


def find_excess(facets: Facets, points: Coordinates) -> Float[Array, "f batch"]:
    """Return by how much points are beyond each facet."""
    terms = [facets.normals[:, k, None] * points[k] for k in range(len(points))]
    return functools.reduce(operator.add, terms) - facets.offsets[:, None]


def is_outside(facets: Facets, points: Coordinates) -> Bool[Array, " batch"]:
    """Return whether points lie outside a polytope."""
    if len(facets.offsets) > FEW_FACETS:
        return ~jnp.all(find_excess(facets, points) <= OUTSIDE, axis=0)
    # Written out, the facets are compared in one kernel, and no product is stored.
    inside = [_beyond(facets, facet, points) <= OUTSIDE for facet in range(len(facets.offsets))]
    return ~functools.reduce(operator.and_, inside)


def _beyond(facets: Facets, facet: int, points: Coordinates) -> Float[Array, " batch"]:
    terms = [facets.normals[facet, k] * points[k] for k in range(len(points))]
    return functools.reduce(operator.add, terms) - facets.offsets[facet]


def is_beyond(
    facets: Facets, coordinate: int, values: Float[Array, " batch"]
) -> Bool[Array, " batch"]:
    """Return whether a coordinate of points lies outside the box around a polytope."""
    below = values <= facets.upper[coordinate] + OUTSIDE
    above = values >= facets.lower[coordinate] - OUTSIDE
    return ~(below & above)


def find_usage(
    offsets: Float[AnyArray, " f"], excess: Float[Array, "f batch"]
) -> Float[Array, " batch"]:
    """Return what points use of a polytope with such offsets, 1 on a facet and more outside, from
    their excess."""
    scale = jnp.where((offsets > 0) & jnp.isfinite(offsets), offsets, 1.0)
    return jnp.max(1 + excess / scale[:, None], axis=0)


def judge_points(facets: Facets, points: Float[Array, "n batch"]) -> Judgement:
    """Compare points with a polytope."""
    excess = matmul(facets.normals, points) - facets.offsets[:, None]
    outside = ~jnp.all(excess <= OUTSIDE, axis=0)
    below = points <= facets.upper[:, None] + OUTSIDE
    above = points >= facets.lower[:, None] - OUTSIDE
    usage = find_usage(facets.offsets, excess)
    return Judgement(outside, ~(below & above), excess, jnp.where(jnp.isnan(usage), jnp.inf, usage))
