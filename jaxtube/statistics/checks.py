"""What closed loops are measured against: sets as facets, tubes along the reference, the model and
the plan's cost.

A point is outside a set when it is more than 1e-12 (m, rad, m/s) beyond a facet; what is no number
is outside.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Int

from jaxtube.qp.batched_ldl import matmul

AnyArray = Any  # made with numpy, used on the device

OUTSIDE = 1e-12


class Facets(NamedTuple):
    """A polytope {x: normals x <= offsets} and the box around it; arrays may carry leading axes."""

    normals: Float[AnyArray, "f n"]
    offsets: Float[AnyArray, " f"]  # infinite for a row that is only padding
    lower: Float[AnyArray, " n"]
    upper: Float[AnyArray, " n"]


class Sections(NamedTuple):
    """The sections R_1 .. R_N of a tube, those of window `index[step]` being due at a step."""

    facets: Facets  # leading axes (windows, N)
    index: Int[AnyArray, " steps"]


@partial(
    jax.tree_util.register_dataclass,
    meta_fields=["tube", "settled"],
    data_fields=[
        *("transitions", "input_matrices", "disturbance", "error", "input", "tubes", "ultimate"),
        *("poses", "map_corner", "map_cell", "cost_errors", "error_weight", "input_weight"),
    ],
)
@dataclass(frozen=True)
class Checks:
    """What a run is measured against.

    `ultimate` holds the half widths that bound the measured error once it has settled, `settled`
    the step from which that and the RMS count. `map_corner` and `map_cell` lay the grid of the
    trajectory map. With windows as in the controller, e^T cost_errors e + (F e)^T g + g^T H g / 2
    is the whole cost of a plan.
    """

    transitions: Float[Array, "steps 3 3"]
    input_matrices: Float[Array, "steps 3 2"]
    disturbance: Facets
    error: Facets
    input: Facets
    tubes: dict[str, Sections]
    tube: str
    ultimate: Float[Array, "3"]
    settled: int
    poses: Float[Array, "steps+1 3"]
    map_corner: Float[Array, "2"]
    map_cell: Float[Array, ""]
    cost_errors: Float[Array, "windows 3 3"]
    error_weight: Float[Array, "3 3"]
    input_weight: Float[Array, "2 2"]

    @property
    def horizon(self) -> int:
        """Steps that a plan is followed."""
        return self.tubes[self.tube].facets.offsets.shape[1]


def judge(facets: Facets, points: Float[Array, "n batch"]):
    """Return (outside, outside the box by coordinate, excess over each facet, usage) of points, the
    batch last.

    The usage is 1 on a facet and more outside, relative to the facet's distance from the origin.
    """
    excess = matmul(facets.normals, points) - facets.offsets[:, None]
    outside = ~jnp.all(excess <= OUTSIDE, axis=0)
    boxes = ~(
        (points <= facets.upper[:, None] + OUTSIDE) & (points >= facets.lower[:, None] - OUTSIDE)
    )
    scale = jnp.where((facets.offsets > 0) & jnp.isfinite(facets.offsets), facets.offsets, 1.0)
    usage = jnp.max(1 + excess / scale[:, None], axis=0)
    return outside, boxes, excess, jnp.where(jnp.isnan(usage), jnp.inf, usage)
