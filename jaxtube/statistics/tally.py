"""What is counted while closed loops run: every period of every lap against the sets that a design
promises.

    w(k) = e(k+1) - A(th_k) e(k) - B(th_k) u(k) in W,     e(k+1) in E,     u(k) in U,     wheels within their limits,
    QP solved,     and for plans followed to their end     e - e_nominal in R_j,  j = 1..N

w and the tube are those of the measured errors, which is what the controller works with; E holds
the true ones. Counts are whole numbers and extremes are maxima, so tallies of any parts of a run
join to the same bits in any order. Whatever is no number is counted as outside.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int

from jaxtube import qp
from jaxtube.control import mpc
from jaxtube.plant.error_dynamics import world_pose
from jaxtube.qp.batched_ldl import matmul
from jaxtube.simulation.rollout import LoopState, Period
from jaxtube.statistics import histogram
from jaxtube.statistics.checks import Checks, Facets, judge

COST_ROUNDING = 1e-9
"""Share of a plan's cost, or of 1, that is rounding where two costs are compared."""
EVENTS = (
    "w_outside_W",
    "w_outside_longitudinal",
    "w_outside_lateral",
    "w_outside_heading",
    "e_outside_E",
    "e_outside_longitudinal",
    "e_outside_lateral",
    "e_outside_heading",
    "u_outside_U",
    "wheels_saturated",
    "qp_infeasible",
    "qp_unsolved",
    "row_active",
    "backup",
    "outside_ultimate_bound",
    "not_finite",
)
"""Counted for every lap in steps, 0 .. steps."""
STAGE_EVENTS = ("outside", "longitudinal", "lateral", "heading")
"""Counted for every lap in plans that left the tube at a stage: some facet, or the box around the
section."""
PLANES = ((0, 1), (0, 2), (1, 2))
CLOUD_CELLS, COVERAGE_CELLS, HEAT_CELLS = 48, 24, (96, 96)


class Tally(NamedTuple):
    """What one tile of laps has come to so far; `laps` fields run over its laps, the others are
    joined already."""

    laps: Laps
    sums: dict[str, Int[Array, "*shape"]]
    largest: dict[str, Float[Array, "*shape"]]


class Laps(NamedTuple):
    """Numbers of each lap."""

    events: Int[Array, "events batch"]
    plans: Int[Array, " batch"]  # followed to their end
    stage_events: Int[Array, "horizon 4 batch"]
    square: Float[Array, "3 batch"]  # sum of squared errors since they settled
    peak: Float[Array, "3 batch"]  # largest |error|
    usage: Float[Array, "3 batch"]  # of E, W and the tube: 1 on a facet, more outside


def empty(checks: Checks, horizon: int, batch: int, dtype) -> Tally:
    """Return a tally of nothing."""
    steps = len(checks.transitions)
    laps = Laps(
        jnp.zeros((len(EVENTS), batch), jnp.int32),
        jnp.zeros(batch, jnp.int32),
        jnp.zeros((horizon, len(STAGE_EVENTS), batch), jnp.int32),
        square=jnp.zeros((3, batch), dtype),
        peak=jnp.zeros((3, batch), dtype),
        usage=jnp.full((3, batch), -jnp.inf, dtype),
    )
    shapes = {
        "error_by_step": (steps, 3, histogram.BUCKETS),
        "disturbance": (3, histogram.BUCKETS),
        "map": HEAT_CELLS,
        "cloud": (horizon, len(PLANES), CLOUD_CELLS, CLOUD_CELLS),
        "plans": (),
        "next_plan_missing": (),
        "cost_excesses": (),
        **{f"tube_outside/{name}": (horizon,) for name in checks.tubes},
    }
    facets = {"disturbance": checks.disturbance, "error": checks.error, "input": checks.input}
    sizes = {f"excess/{name}": facet.offsets.shape for name, facet in facets.items()}
    sizes |= {f"tube_excess/{name}": (horizon,) for name in checks.tubes}
    sizes |= {"cost_excess": ()}
    return Tally(
        laps,
        {name: jnp.zeros(shape, jnp.int32) for name, shape in shapes.items()},
        {name: jnp.full(shape, -jnp.inf, dtype) for name, shape in sizes.items()},
    )


def observe(
    checks: Checks,
    step: Int[Array, ""],
    before: LoopState,
    happened: Period,
    after: LoopState,
    counted: Bool[Array, " batch"],
    tally: Tally,
) -> Tally:
    """Count one period; of laps that are not `counted` only their own numbers go on."""
    e, u, diagnostics = after.errors.T, happened.inputs.T, happened.diagnostics
    A, B = checks.transitions[step], checks.input_matrices[step]
    w = after.measured.T - matmul(A, before.measured.T) - matmul(B, u)
    outside_w, boxes_w, excess_w, usage_w = judge(checks.disturbance, w)
    outside_e, boxes_e, excess_e, usage_e = judge(checks.error, e)
    outside_u, _, excess_u, _ = judge(checks.input, u)
    settled = step + 1 >= checks.settled
    flags = [
        *(outside_w, *boxes_w, outside_e, *boxes_e, outside_u),
        jnp.any(jnp.abs(happened.demanded - happened.wheels) > 0, axis=1),
        *(diagnostics.status == kind for kind in (qp.INFEASIBLE, qp.UNSOLVED)),
        *(diagnostics.active, diagnostics.backup),
        settled & ~jnp.all(jnp.abs(after.measured.T) <= checks.ultimate[:, None], axis=0),
        ~jnp.isfinite(jnp.sum(e, axis=0) + jnp.sum(u, axis=0)),
    ]
    laps = tally.laps
    usage = jnp.stack([usage_e, usage_w, laps.usage[2]])
    laps = laps._replace(
        events=laps.events + jnp.stack(flags).astype(jnp.int32),
        square=laps.square + jnp.where(settled, e * e, 0.0),
        peak=jnp.maximum(laps.peak, jnp.abs(e)),
        usage=jnp.maximum(laps.usage, usage),
    )
    counts, axes = counted.astype(jnp.int32), jnp.arange(3)[:, None]
    sums = tally.sums | {
        "error_by_step": tally.sums["error_by_step"]
        .at[step, axes, histogram.bucket(e)]
        .add(counts),
        "disturbance": tally.sums["disturbance"].at[axes, histogram.bucket(w)].add(counts),
        "map": tally.sums["map"].at[map_cells(checks, step, after.errors)].add(counts, mode="drop"),
    }
    found = {"excess/disturbance": excess_w, "excess/error": excess_e, "excess/input": excess_u}
    largest = tally.largest | {
        name: jnp.maximum(tally.largest[name], _most(found[name], counted)) for name in found
    }
    return Tally(laps, sums, largest)


def observe_plans(
    checks: Checks,
    controller,
    step: Int[Array, ""],
    state: LoopState,
    deviations: Float[Array, "horizon batch 3"],
    found: mpc.Plan,
    following: mpc.Plan,
    counted: Bool[Array, " batch"],
    tally: Tally,
) -> Tally:
    """Count plans that were followed to their end, and whether the next plan costs less by what the
    stage cost.

    `following` are the plans made where `found` expected the error one step later: V+ <= V - e'Qe -
    g_0'Rg_0.
    """
    counted = counted & (found.status == qp.SOLVED)
    counts = counted.astype(jnp.int32)
    points = jnp.moveaxis(deviations, 2, 1)
    sums, largest, laps = dict(tally.sums), dict(tally.largest), tally.laps
    for name, sections in checks.tubes.items():
        facets = jax.tree.map(
            lambda array, index=sections.index[step]: array[index], sections.facets
        )
        outside, boxes, excess, usage = jax.vmap(judge)(facets, points)
        sums[f"tube_outside/{name}"] += jnp.sum(outside & counted, axis=1, dtype=jnp.int32)
        key = f"tube_excess/{name}"
        largest[key] = jnp.maximum(largest[key], _most(jnp.max(excess, axis=1), counted))
        if name == checks.tube:
            stage_events = (jnp.concatenate([outside[:, None], boxes], axis=1) & counted).astype(
                jnp.int32
            )
            most = jnp.where(counted, jnp.max(usage, axis=0), -jnp.inf)
            laps = laps._replace(
                plans=laps.plans + counts,
                stage_events=laps.stage_events + stage_events,
                usage=laps.usage.at[2].max(most, mode="drop"),
            )
            sums["cloud"] = sums["cloud"].at[cloud_cells(facets, points)].add(counts, mode="drop")
    sums["plans"] += jnp.sum(counts, dtype=jnp.int32)
    index, later = controller.index[step], controller.index[step + 1]
    expected = expected_error(controller, step, state.measured, found)
    stage = _form(checks.error_weight, state.measured) + _form(
        checks.input_weight, found.inputs[:, 0]
    )
    cost = plan_cost(checks, controller, index, state.measured, found)
    excess = plan_cost(checks, controller, later, expected, following) - cost + stage
    both = counted & (following.status == qp.SOLVED)
    too_much = ~(excess <= COST_ROUNDING * jnp.maximum(cost, 1.0))
    sums["next_plan_missing"] += jnp.sum(counted & ~both, dtype=jnp.int32)
    sums["cost_excesses"] += jnp.sum(both & too_much, dtype=jnp.int32)
    largest["cost_excess"] = jnp.maximum(largest["cost_excess"], _most(excess, both))
    return Tally(laps, sums, largest)


def _most(values: Float[Array, "... batch"], counted: Bool[Array, " batch"]) -> Float[Array, "..."]:
    return jnp.max(values, axis=-1, where=counted & ~jnp.isnan(values), initial=-jnp.inf)


def expected_error(
    controller, step, errors: Float[Array, "batch 3"], found: mpc.Plan
) -> Float[Array, "batch 3"]:
    """Return A e + B g_0, where a plan expects the error one step later."""
    window = mpc.take_window(controller.windows, controller.index[step])
    return matmul(errors, window.transition.T) + matmul(found.inputs[:, 0], window.input_matrix.T)


def plan_cost(checks: Checks, controller, index, errors: Float[Array, "batch 3"], found: mpc.Plan):
    """Return the cost of plans, sum of e'Qe + g'Rg and e'Pe at the end."""
    window = mpc.take_window(controller.windows, index)
    inputs = found.inputs.reshape(len(errors), -1)
    linear = jnp.sum(matmul(errors, window.linear.T) * inputs, axis=1)
    of_inputs = linear + _form(window.factors.hessian, inputs) / 2
    return _form(checks.cost_errors[index], errors) + window.cost_unit * of_inputs


def _form(matrix: Float[Array, "n n"], vectors: Float[Array, "batch n"]) -> Float[Array, " batch"]:
    return jnp.sum(matmul(vectors, matrix) * vectors, axis=1)


def map_cells(checks: Checks, step, errors: Float[Array, "batch 3"]):
    """Return (row, column) of the robots' positions on the trajectory map; out of range where they
    are off it."""
    position = world_pose(errors, checks.poses[step + 1])[:, :2]
    column, row = _cells((position - checks.map_corner) / checks.map_cell).T
    return row, column


def cloud_cells(facets: Facets, points: Float[Array, "horizon 3 batch"]):
    """Return the cells of deviations in the three planes, which reach twice as far as the section's
    box."""
    width = 2 * jnp.maximum(facets.upper, -facets.lower)[:, :, None]
    cells = _cells((points / jnp.where(width > 0, width, 1.0) + 1) / 2 * CLOUD_CELLS)
    first, second = (jnp.stack([cells[:, plane[i]] for plane in PLANES], axis=1) for i in range(2))
    stage, plane = jnp.arange(len(points))[:, None, None], jnp.arange(len(PLANES))[None, :, None]
    return stage, plane, second, first


def _cells(places: Float[Array, "*shape"]) -> Int[Array, "*shape"]:
    """Return whole numbers, a huge one (off every grid) for what is negative or no number."""
    valid = (places >= 0) & (places < 1e6)
    return jnp.where(valid, jnp.where(valid, places, 0.0).astype(jnp.int32), 1_000_000)


def close(
    checks: Checks,
    starts: Float[Array, "batch 3"],
    plans_each: int,
    counted: Bool[Array, " batch"],
    tally: Tally,
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return (sums, largest) of a tile whose laps have ended."""
    laps, counts, steps = tally.laps, counted.astype(jnp.int32), len(checks.transitions)
    rms = jnp.sqrt(laps.square / max(steps + 1 - checks.settled, 1))
    axes = jnp.arange(3)[:, None]

    def lap_histogram(values):
        return (
            jnp.zeros((3, histogram.BUCKETS), jnp.int32)
            .at[axes, histogram.bucket(values)]
            .add(counts)
        )

    left = laps.events[EVENTS.index("e_outside_E")] > 0
    stages = (
        jnp.arange(len(laps.stage_events))[:, None, None],
        jnp.arange(len(STAGE_EVENTS))[None, :, None],
    )
    return tally.sums | {
        "laps": jnp.sum(counts, dtype=jnp.int32),
        "events": jnp.zeros((len(EVENTS), steps + 1), jnp.int32)
        .at[jnp.arange(len(EVENTS))[:, None], laps.events]
        .add(counts),
        "plans_by_lap": jnp.zeros(plans_each + 1, jnp.int32).at[laps.plans].add(counts),
        "stage_events": jnp.zeros((*laps.stage_events.shape[:2], plans_each + 1), jnp.int32)
        .at[(*stages, laps.stage_events)]
        .add(counts),
        "peak": lap_histogram(laps.peak),
        "rms": lap_histogram(rms),
        "starts": _coverage(checks, starts, counts),
        "starts_that_left": _coverage(checks, starts, counts * left.astype(jnp.int32)),
    }, tally.largest | {"ultimate_bound": checks.ultimate}


def _coverage(checks: Checks, starts: Float[Array, "batch 3"], counts: Int[Array, " batch"]):
    cells = _cells((starts / checks.error.upper + 1) / 2 * COVERAGE_CELLS)
    first, second = (jnp.stack([cells[:, plane[i]] for plane in PLANES]) for i in range(2))
    grid = jnp.zeros((len(PLANES), COVERAGE_CELLS, COVERAGE_CELLS), jnp.int32)
    return grid.at[jnp.arange(len(PLANES))[:, None], second, first].add(counts, mode="drop")
