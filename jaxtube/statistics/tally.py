"""The tally of closed loops: every period of every lap counted against the sets of a design.

    w(k) = e(k+1) - A(th_k) e(k) - B(th_k) u(k) in W,     e(k+1) in E,     D u(k) + C e(k) <= d,
    wheels within their limits,     |c(k+1) - c(k)| <= a T,     QP solved,
    and for plans followed to their end     e - e_nominal in R_j,  j = 1..N

w, the tube and the rows on inputs are those of the measured errors, which the controller works
with; E holds the true ones. D u + C e <= d are the rows of U and, where inputs are coupled to
errors, those of the coupling; c is what the wheels are asked for. Counts are whole numbers and
extremes are maxima, so the tallies of any parts of a run join to the same bits in any order. NaN
counts as outside.
"""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int

from jaxtube import coordinates, qp
from jaxtube.control import planning
from jaxtube.control.laws import TubeMpc
from jaxtube.coordinates import PLANES
from jaxtube.plant.error_dynamics import world_pose
from jaxtube.plant.learning import LearningMemory
from jaxtube.plant.robot import is_saturated
from jaxtube.qp.batched_ldl import matmul
from jaxtube.simulation.rollout import LoopState, PeriodOutcome
from jaxtube.statistics import histogram
from jaxtube.statistics.checks import (
    OUTSIDE,
    Checks,
    Coordinates,
    Facets,
    FacetsByRegime,
    find_excess,
    find_usage,
    is_beyond,
    is_outside,
    judge_points,
)
from jaxtube.statistics.events import EVENT_NAMES, find_row

COST_ROUNDING = 1e-9
"""Share of a plan's cost, or of 1, that is rounding where two costs are compared."""
STAGE_EVENTS = ("outside", "longitudinal", "lateral", "heading")
"""Counted for every lap in plans that left the tube at a stage: some facet, or the box around the
section."""
CLOUD_CELLS = 48
"""Cells along each axis of the clouds of deviations."""
CLOUD_REACH = 2.0
"""The cells of a cloud reach so many times as far as the box around the section."""
FACE_ROUNDING = 1e-6
"""Share of the box around E by which a start may be off a face."""
COVERAGE_CELLS = 24
"""Cells along each axis of the coverage of starts."""
HEAT_CELLS = (96, 96)
"""Rows and columns of the trajectory map."""
COUNTED_PLANS = ("plans", "next_plan_missing", "plans_unsolved", "cost_excesses")
"""Numbers of plans, over all steps."""
OFF_GRID = 1_000_000
"""A cell outside every grid."""


class Tally(NamedTuple):
    """What one tile of laps has come to so far; `laps` fields run over its laps, the others are
    joined already."""

    laps: LapNumbers
    sums: dict[str, Int[Array, "*shape"]]
    largest: dict[str, Float[Array, "*shape"]]


class LapNumbers(NamedTuple):
    """Numbers of each lap."""

    events: Int[Array, "events batch"]  # without those of the last period
    # Of the last period, as the bits of a number: a kernel that counts them at once would find them
    # anew for every row.
    flags: Int[Array, " batch"]
    plans: Int[Array, " batch"]  # followed to their end
    stage_events: Int[Array, "horizon 4 batch"]
    square: Float[Array, "3 batch"]  # sum of squared errors since they settled
    peak: Float[Array, "3 batch"]  # largest |error|
    excess: dict[str, Float[Array, "f batch"]]  # largest over each facet of a set, by its name
    tube_usage: Float[Array, " batch"]  # 1 on a facet, more outside
    asked: Float[Array, "batch 2"] | None  # of the wheels last, m/s; None without a limit of steps


def empty(checks: Checks, horizon: int, batch: int, dtype) -> Tally:
    """Return a tally of nothing."""
    laps = LapNumbers(
        events=jnp.zeros((len(EVENT_NAMES), batch), jnp.int32),
        flags=jnp.zeros(batch, jnp.int32),
        plans=jnp.zeros(batch, jnp.int32),
        stage_events=jnp.zeros((horizon, len(STAGE_EVENTS), batch), jnp.int32),
        square=jnp.zeros((3, batch), dtype),
        peak=jnp.zeros((3, batch), dtype),
        excess={
            name: jnp.full((len(facets.offsets), batch), -jnp.inf, dtype)
            for name, facets in _judged_sets(checks).items()
        },
        tube_usage=jnp.full(batch, -jnp.inf, dtype),
        asked=None if checks.command_step is None else jnp.full((batch, 2), jnp.nan, dtype),
    )
    sums = {
        name: histogram.begin_counts(math.prod(shape))
        for name, shape in _histogram_shapes(checks, horizon).items()
    }
    sums |= {name: jnp.zeros((), jnp.int32) for name in COUNTED_PLANS}
    sums |= {f"tube_outside/{name}": jnp.zeros(horizon, jnp.int32) for name in checks.tubes}
    extremes: dict[str, tuple[int, ...]] = {"cost_excess": ()}
    extremes |= {f"tube_excess/{name}": (horizon,) for name in checks.tubes}
    if checks.command_step is not None:
        extremes |= {"command_step": (2,)}
    if checks.slip_radius is not None:
        extremes |= {"slip_radius": (2,)}
    largest = {name: jnp.full(shape, -jnp.inf, dtype) for name, shape in extremes.items()}
    return Tally(laps, sums, largest)


def _histogram_shapes(checks: Checks, horizon: int) -> dict[str, tuple[int, ...]]:
    return {
        "error_by_step": (len(checks.transitions), 3, histogram.BUCKETS),
        "disturbance": (3, histogram.BUCKETS),
        "map": HEAT_CELLS,
        "cloud": (horizon, len(PLANES), CLOUD_CELLS, CLOUD_CELLS),
    }


def _judged_sets(checks: Checks) -> dict[str, Facets | FacetsByRegime]:
    """Return the sets that periods are judged by."""
    return {"disturbance": checks.disturbance, "error": checks.error, "input": checks.input}


def _find_due_sets(checks: Checks, step: Int[Array, ""]) -> dict[str, Facets]:
    """Return the sets that the period which begins at a step is judged by."""
    return {name: facets.at(step) for name, facets in _judged_sets(checks).items()}


def _find_command_step(laps: LapNumbers, happened: PeriodOutcome) -> Float[Array, "2 batch"] | None:
    """Return how far the wheels' commands are from those of the period before, m/s; NaN in the
    first, None without a limit."""
    return None if laps.asked is None else jnp.abs(happened.demanded - laps.asked).T


def _is_too_fast(
    checks: Checks, command_step: Float[Array, "2 batch"] | None, step: Int[Array, ""], batch: int
) -> Bool[Array, " batch"]:
    """Return whether commands change by more than the limit."""
    most = checks.command_step
    if command_step is None or most is None:
        return jnp.zeros(batch, bool)
    is_within = jnp.all(command_step <= most + OUTSIDE, axis=0)
    return (step > 0) & ~is_within


def _judge_learning(
    checks: Checks, before: LoopState, step: Int[Array, ""]
) -> tuple[Bool[Array, " batch"], Float[Array, "2 batch"] | None]:
    """Return whether the intervals of learnt slips hold the true ones of a period and are as narrow
    as they should be, and half their widths once they have settled, 0 before; True and None where
    nothing is learnt."""
    most = checks.slip_radius
    memory = before.plant_memory
    if most is None or not isinstance(memory, LearningMemory):
        return jnp.ones(len(before.errors), bool), None
    settled = len(most) - 1
    radius = memory.knowledge.radius
    is_narrow = jnp.all(radius <= most[jnp.minimum(step, settled)] + OUTSIDE, axis=1)
    return ~memory.is_missed & is_narrow, jnp.where(step >= settled, radius, 0.0).T


def find_events(
    checks: Checks,
    due: dict[str, Facets],
    judged: dict[str, Coordinates],
    happened: PeriodOutcome,
    after: LoopState,
    settled: Bool[Array, ""],
) -> dict[str, Bool[Array, " batch"]]:
    """Return which events of `jaxtube.statistics.events` one period of every lap had, without those
    that compare it with the one before; `due` are the sets, `judged` the points of each."""
    diagnostics = happened.diagnostics
    measured = _coordinates(after.measured)
    within = [jnp.abs(measured[i]) <= checks.ultimate[i] for i in range(3)]
    numbers = functools.reduce(operator.add, [*judged["error"], *judged["input"][:2]])
    found = {
        "w_outside_W": is_outside(due["disturbance"], judged["disturbance"]),
        "e_outside_E": is_outside(due["error"], judged["error"]),
        "u_outside_U": is_outside(due["input"], judged["input"]),
        "wheels_saturated": is_saturated(happened.demanded, happened.wheels),
        "qp_infeasible": diagnostics.status == qp.INFEASIBLE,
        "qp_unsolved": diagnostics.status == qp.UNSOLVED,
        "row_active": diagnostics.active,
        "backup": diagnostics.backup,
        "outside_ultimate_bound": settled & ~functools.reduce(operator.and_, within),
        "not_finite": ~jnp.isfinite(numbers),
    }
    for letter, name in (("w", "disturbance"), ("e", "error")):
        for i, coordinate in enumerate(coordinates.NAMES):
            found[f"{letter}_outside_{coordinate}"] = is_beyond(due[name], i, judged[name][i])
    return found


def observe(
    checks: Checks,
    step: Int[Array, ""],
    before: LoopState,
    happened: PeriodOutcome,
    after: LoopState,
    counted: Bool[Array, " batch"],
    tally: Tally,
) -> Tally:
    """Count one period; of laps that are not `counted` only their own numbers go on."""
    e = _coordinates(after.errors)
    u = _coordinates(happened.inputs)
    measured = _coordinates(before.measured)
    w = _find_disturbance(checks, step, measured, u, _coordinates(after.measured))
    judged: dict[str, Coordinates] = {"disturbance": w, "error": e, "input": [*u, *measured]}
    settled = step + 1 >= checks.settled
    command_step = _find_command_step(tally.laps, happened)
    due = _find_due_sets(checks, step)
    events = find_events(checks, due, judged, happened, after, settled)
    events["acceleration_exceeded"] = _is_too_fast(checks, command_step, step, len(e[0]))
    knows, radius = _judge_learning(checks, before, step)
    events["slip_outside_interval"] = ~knows
    laps = _observe_laps(due, tally.laps, events, judged, settled)
    if command_step is not None:
        laps = laps._replace(asked=happened.demanded)
    sums = dict(tally.sums)
    counts = counted.astype(jnp.int32)
    cells = {
        "error_by_step": [_number_bucket(3 * step + i, e[i]) for i in range(3)],
        "disturbance": [_number_bucket(i, w[i]) for i in range(3)],
        "map": [map_cells(checks, step, after.errors)],
    }
    for name, of_name in cells.items():
        sums[name] = histogram.add_counts(sums[name], of_name, counts)
    largest = dict(tally.largest)
    if command_step is not None:
        seen = _largest(command_step, counted)
        largest["command_step"] = jnp.maximum(largest["command_step"], seen)
    if radius is not None:
        seen = _largest(radius, counted)
        largest["slip_radius"] = jnp.maximum(largest["slip_radius"], seen)
    return Tally(laps, sums, largest)


def _number_bucket(
    row: Int[Array, ""] | int, values: Float[Array, "*shape"]
) -> Int[Array, "*shape"]:
    """Return the numbers of the buckets of values in a row of a histogram."""
    return row * histogram.BUCKETS + histogram.bucket(values)


def _coordinates(points: Float[Array, "batch n"]) -> list[Float[Array, " batch"]]:
    return [points[:, i] for i in range(points.shape[1])]


def _find_disturbance(
    checks: Checks, step: Int[Array, ""], before: Coordinates, u: Coordinates, after: Coordinates
) -> list[Float[Array, " batch"]]:
    """Return w = e(k+1) - A e(k) - B u(k)."""
    A = checks.transitions[step]
    B = checks.input_matrices[step]
    found = []
    for i in range(3):
        moved = [A[i, j] * before[j] for j in range(3)] + [B[i, j] * u[j] for j in range(2)]
        found.append(after[i] - functools.reduce(operator.add, moved))
    return found


def _observe_laps(
    due: dict[str, Facets],
    laps: LapNumbers,
    events: dict[str, Bool[Array, " batch"]],
    judged: dict[str, Coordinates],
    settled,
) -> LapNumbers:
    """Return the numbers of each lap after one more period."""
    flags = [events[name].astype(jnp.int32) << row for row, name in enumerate(EVENT_NAMES)]
    e = jnp.stack(judged["error"])
    excess = {}
    for name, facets in due.items():
        found = find_excess(facets, judged[name])
        # NaN is not larger.
        excess[name] = jnp.where(found > laps.excess[name], found, laps.excess[name])
    return laps._replace(
        events=_count_flags(laps),
        flags=functools.reduce(operator.or_, flags),
        square=laps.square + jnp.where(settled, e * e, 0.0),
        peak=jnp.maximum(laps.peak, jnp.abs(e)),
        excess=excess,
    )


def _count_flags(laps: LapNumbers) -> Int[Array, "events batch"]:
    """Return the events of laps with those of the last period."""
    rows = jnp.arange(len(EVENT_NAMES), dtype=jnp.int32)[:, None]
    return laps.events + (laps.flags >> rows & 1)


def find_usages(checks: Checks, laps: LapNumbers) -> Float[Array, "3 batch"]:
    """Return what laps used of E, W and the tube: 1 on a facet, more outside; infinitely much where
    a number was not finite."""
    is_finite = _count_flags(laps)[find_row("not_finite")] == 0
    used = [
        jnp.where(is_finite, find_usage(facets.offsets, laps.excess[name]), jnp.inf)
        for name, facets in (("error", checks.error), ("disturbance", checks.disturbance))
    ]
    return jnp.stack([*used, laps.tube_usage])


class FollowedPlans(NamedTuple):
    """Plans made at one step and followed to their end, and what was planned one step later."""

    state: LoopState  # at the step
    plan: planning.Plan
    deviations: Float[Array, "horizon batch 3"]
    next_plan: planning.Plan  # made where `plan` expects the error one step later


def observe_plans(
    checks: Checks,
    controller: TubeMpc,
    step: Int[Array, ""],
    followed: FollowedPlans,
    counted: Bool[Array, " batch"],
    tally: Tally,
) -> Tally:
    """Count plans that were followed to their end, and whether the next plan costs less by what the
    stage cost, V+ <= V - e'Qe - g_0'Rg_0."""
    has_data = counted & jnp.isfinite(followed.plan.residual)
    counted = counted & (followed.plan.status == qp.SOLVED)
    statuses = (followed.plan.status, followed.next_plan.status)
    unsolved = has_data & functools.reduce(operator.or_, [each == qp.UNSOLVED for each in statuses])
    sums = dict(tally.sums)
    sums["plans_unsolved"] += jnp.sum(unsolved, dtype=jnp.int32)
    tally = _observe_tubes(checks, step, followed.deviations, counted, tally._replace(sums=sums))
    return _observe_costs(checks, controller, step, followed, counted, tally)


def _observe_tubes(
    checks: Checks, step, deviations: Float[Array, "horizon batch 3"], counted, tally: Tally
) -> Tally:
    """Count deviations from plans outside each tube, and draw them for the tube in use."""
    counts = counted.astype(jnp.int32)
    points = jnp.moveaxis(deviations, 2, 1)
    laps = tally.laps
    sums = dict(tally.sums)
    largest = dict(tally.largest)
    for name, sections in checks.tubes.items():
        facets = sections.at(step)
        judged = jax.vmap(judge_points)(facets, points)
        left = jnp.sum(judged.outside & counted, axis=1, dtype=jnp.int32)
        sums[f"tube_outside/{name}"] += left
        key = f"tube_excess/{name}"
        excess = _largest(jnp.max(judged.excess, axis=1), counted)
        largest[key] = jnp.maximum(largest[key], excess)
        if name == checks.tube:
            flags = jnp.concatenate([judged.outside[:, None], judged.outside_box], axis=1)
            usage = jnp.where(counted, jnp.max(judged.usage, axis=0), -jnp.inf)
            laps = laps._replace(
                plans=laps.plans + counts,
                stage_events=laps.stage_events + (flags & counted).astype(jnp.int32),
                tube_usage=jnp.maximum(laps.tube_usage, usage),
            )
            cells = cloud_cells(facets, points)
            sums["cloud"] = histogram.add_counts(sums["cloud"], [cells], counts)
    sums["plans"] += jnp.sum(counts, dtype=jnp.int32)
    return Tally(laps, sums, largest)


def _observe_costs(
    checks: Checks, controller: TubeMpc, step, followed: FollowedPlans, counted, tally: Tally
) -> Tally:
    """Count plans whose successor costs too much, or is missing."""
    plan = followed.plan
    measured = followed.state.measured
    now = controller.index[step]
    later = controller.index[step + 1]
    expected = expected_error(controller, step, measured, plan)
    deviation = plan.inputs[:, 0] - matmul(measured, checks.kept_gains[now].T)
    stage = _form(checks.error_weight, measured) + _form(checks.input_weight, deviation)
    cost = plan_cost(checks, controller, now, measured, plan)
    next_cost = plan_cost(checks, controller, later, expected, followed.next_plan)
    excess = next_cost - cost + stage
    both = counted & (followed.next_plan.status == qp.SOLVED)
    too_much = ~(excess <= COST_ROUNDING * jnp.maximum(cost, 1.0))
    sums = dict(tally.sums)
    sums["next_plan_missing"] += jnp.sum(counted & ~both, dtype=jnp.int32)
    sums["cost_excesses"] += jnp.sum(both & too_much, dtype=jnp.int32)
    largest = dict(tally.largest)
    largest["cost_excess"] = jnp.maximum(largest["cost_excess"], _largest(excess, both))
    return Tally(tally.laps, sums, largest)


def _largest(
    values: Float[Array, "... batch"], counted: Bool[Array, " batch"]
) -> Float[Array, "..."]:
    return jnp.max(values, axis=-1, where=counted & ~jnp.isnan(values), initial=-jnp.inf)


def expected_error(
    controller: TubeMpc, step, errors: Float[Array, "batch 3"], plan: planning.Plan
) -> Float[Array, "batch 3"]:
    """Return A e + B g_0, where a plan expects the error one step later."""
    return planning.predict(controller.condensed_qp(step), errors, plan.inputs[:, 0])


def plan_cost(
    checks: Checks, controller: TubeMpc, index, errors: Float[Array, "batch 3"], plan: planning.Plan
) -> Float[Array, " batch"]:
    """Return the cost of plans, sum of e'Qe + g'Rg and e'Pe at the end."""
    condensed = planning.take_qp(controller.qps, index)
    inputs = plan.inputs.reshape(len(errors), -1)
    linear = jnp.sum(matmul(errors, condensed.linear.T) * inputs, axis=1)
    of_inputs = linear + _form(condensed.factors.hessian, inputs) / 2
    return _form(checks.cost_errors[index], errors) + condensed.cost_unit * of_inputs


def _form(matrix: Float[Array, "n n"], vectors: Float[Array, "batch n"]) -> Float[Array, " batch"]:
    return jnp.sum(matmul(vectors, matrix) * vectors, axis=1)


def map_cells(checks: Checks, step, errors: Float[Array, "batch 3"]) -> Int[Array, " batch"]:
    """Return the cells of the robots' positions on the trajectory map, row by row; none where they
    are off it."""
    pose = world_pose(errors, checks.poses[step + 1])
    column = _cells((pose[:, 0] - checks.map_corner[0]) / checks.map_cell)
    row = _cells((pose[:, 1] - checks.map_corner[1]) / checks.map_cell)
    return _number_cells((row, column), HEAT_CELLS)


def cloud_cells(
    facets: Facets, points: Float[Array, "horizon 3 batch"]
) -> Int[Array, "horizon planes batch"]:
    """Return the cells of deviations in the three planes of every stage."""
    width = CLOUD_REACH * jnp.maximum(facets.upper, -facets.lower)[:, :, None]
    cells = _cells((points / jnp.where(width > 0, width, 1.0) + 1) / 2 * CLOUD_CELLS)
    column = jnp.stack([cells[:, abscissa] for abscissa, _ in PLANES], axis=1)
    row = jnp.stack([cells[:, ordinate] for _, ordinate in PLANES], axis=1)
    stage = jnp.arange(len(points), dtype=jnp.int32)[:, None, None]
    plane = jnp.arange(len(PLANES), dtype=jnp.int32)[None, :, None]
    shape = (len(points), len(PLANES), CLOUD_CELLS, CLOUD_CELLS)
    return _number_cells((stage, plane, row, column), shape)


def _number_cells(
    places: Sequence[Int[Array, "*shape"]], sizes: tuple[int, ...]
) -> Int[Array, "*shape"]:
    """Return the numbers of cells of a grid, -1 outside it."""
    number = jnp.int32(0)
    valid = jnp.asarray(True)
    for place, size in zip(places, sizes, strict=True):
        number = number * size + place
        valid = valid & (place >= 0) & (place < size)
    return jnp.where(valid, number, -1)


def _cells(places: Float[Array, "*shape"]) -> Int[Array, "*shape"]:
    """Return whole numbers, OFF_GRID for what is negative, NaN or that large."""
    valid = (places >= 0) & (places < OFF_GRID)
    return jnp.where(valid, jnp.where(valid, places, 0.0).astype(jnp.int32), OFF_GRID)


def close(
    checks: Checks,
    starts: Float[Array, "batch 3"],
    plans_each: int,
    counted: Bool[Array, " batch"],
    tally: Tally,
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return (sums, largest) of a tile whose laps have ended."""
    laps = tally.laps
    counts = counted.astype(jnp.int32)
    steps = len(checks.transitions)
    rms = jnp.sqrt(laps.square / max(steps + 1 - checks.settled, 1))
    events = _count_flags(laps)
    left = events[find_row("e_outside_E")] > 0
    is_finite = events[find_row("not_finite")] == 0
    unsolved = is_finite & (events[find_row("qp_unsolved")] > 0)
    shapes = _histogram_shapes(checks, len(laps.stage_events))
    sums = {
        name: histogram.end_counts(value, shapes[name]) if name in shapes else value
        for name, value in tally.sums.items()
    }
    of_laps = {
        "laps": jnp.sum(counts, dtype=jnp.int32),
        "laps_unsolved": jnp.sum(counted & unsolved, dtype=jnp.int32),
        "events": _count_times(events, steps, counts),
        "plans_by_lap": _count_times(laps.plans, plans_each, counts),
        "stage_events": _count_times(laps.stage_events, plans_each, counts),
        "peak": _lap_histogram(laps.peak, counts),
        "rms": _lap_histogram(rms, counts),
        "starts": _coverage(checks, starts, counts),
        "starts_that_left": _coverage(checks, starts, counts * left.astype(jnp.int32)),
    }
    largest = {f"excess/{name}": _largest(seen, counted) for name, seen in laps.excess.items()}
    return sums | of_laps, tally.largest | largest | {"ultimate_bound": checks.ultimate}


def _count_times(
    times: Int[Array, "*rows batch"], most: int, counts: Int[Array, " batch"]
) -> Int[Array, "*rows most+1"]:
    """Return how many laps had something 0, 1, .. `most` times."""
    size = most + 1
    rows = math.prod(times.shape[:-1])
    first = jnp.arange(rows, dtype=jnp.int32).reshape(*times.shape[:-1], 1) * size
    counted = histogram.add_counts(histogram.begin_counts(rows * size), [first + times], counts)
    return histogram.end_counts(counted, (*times.shape[:-1], size))


def _lap_histogram(
    values: Float[Array, "3 batch"], counts: Int[Array, " batch"]
) -> Int[Array, "3 buckets"]:
    return _count_times(histogram.bucket(values), histogram.BUCKETS - 1, counts)


def _coverage(
    checks: Checks, starts: Float[Array, "batch 3"], counts: Int[Array, " batch"]
) -> Int[Array, "planes rows columns"]:
    """Return how many starts lie in each cell of the box around E, plane by plane; its faces belong
    to the cells within."""
    box = checks.error
    share = (starts - box.lower) / (box.upper - box.lower)
    is_inside = (share >= -FACE_ROUNDING) & (share <= 1 + FACE_ROUNDING)
    within = jnp.clip(share, 0.0, 1 - FACE_ROUNDING)
    cells = _cells(jnp.where(is_inside, within, -1.0) * COVERAGE_CELLS)
    column = jnp.stack([cells[:, abscissa] for abscissa, _ in PLANES])
    row = jnp.stack([cells[:, ordinate] for _, ordinate in PLANES])
    plane = jnp.arange(len(PLANES), dtype=jnp.int32)[:, None]
    shape = (len(PLANES), COVERAGE_CELLS, COVERAGE_CELLS)
    numbers = _number_cells((plane, row, column), shape)
    counted = histogram.add_counts(histogram.begin_counts(math.prod(shape)), [numbers], counts)
    return histogram.end_counts(counted, shape)
