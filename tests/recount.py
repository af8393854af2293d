"""What recorded laps come to, counted once more in plain numpy: the oracle of the Monte Carlo
statistics.

Sets answer by their own support numbers and margins, buckets are found by bisection, plans come
from an exact solver and cost what is summed up along their predicted errors. A `case` has a design,
a task, and the sets and rows on inputs counted against.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from oracles import PlainMpc, model
from tolerances import COUNTED

from jaxtube import qp
from jaxtube.control import planning
from jaxtube.coordinates import PLANES
from jaxtube.simulation import batches
from jaxtube.simulation.rollout import LoopState, Trajectory, follow_plan
from jaxtube.statistics.events import EVENT_NAMES, find_row
from jaxtube.statistics.histogram import BUCKETS, EDGES
from jaxtube.statistics.run import WORST
from jaxtube.statistics.tally import CLOUD_CELLS, COVERAGE_CELLS, HEAT_CELLS
from sets.tubes import sequence_tube

AXES = ("longitudinal", "lateral", "heading")


def outside(polytope, points):
    """Return whether points are outside a set, and outside its box by coordinate; (.., 4)."""
    box = points <= polytope.support(np.eye(3)) + COUNTED
    box &= -points <= polytope.support(-np.eye(3)) + COUNTED
    return np.concatenate([~polytope.contains(points, COUNTED)[..., None], ~box], axis=-1)


def excess(polytope, points):
    scale = np.linalg.norm(polytope.normals, axis=1)
    return (points @ polytope.normals.T - polytope.offsets) / scale


def input_excess(rows, laps):
    """Return by how much inputs pass rows on (u, measured error), in the units of u."""
    used = laps.inputs @ rows.inputs.T + laps.measured[:-1] @ rows.errors.T
    return (used - rows.offsets) / np.linalg.norm(rows.inputs, axis=1)


def usage(polytope, points):
    found = np.max(points @ polytope.normals.T / polytope.offsets, axis=-1)
    return np.where(np.isnan(found), np.inf, found)


def histogram(values):
    """Count the last axis of |values| (laps, .., 3) by bucket."""
    found = np.maximum(np.searchsorted(EDGES, np.abs(values), side="right") - 1, 0)
    found[np.isnan(values)] = BUCKETS - 1
    return np.stack([np.bincount(found[..., axis].ravel(), minlength=BUCKETS) for axis in range(3)])


def by_lap(flags, largest):
    """Count laps by how often each flag (times, laps, flags) was up."""
    return np.stack([np.bincount(row, minlength=largest + 1) for row in flags.sum(axis=0).T])


def flags_of(case, laps, w):
    """Return every event at every step, (steps, laps, events) by name."""
    sets = case.sets
    robot = case.task.plant.robot
    e = laps.errors[1:]
    off_w = outside(sets["disturbance"], w)
    off_e = outside(sets["error"], e)
    late = np.arange(1, len(e) + 1)[:, None] >= case.task.checks.settled
    settled = np.abs(laps.measured[1:])
    found = {
        "w_outside_W": off_w[..., 0],
        **{f"w_outside_{name}": off_w[..., 1 + i] for i, name in enumerate(AXES)},
        "e_outside_E": off_e[..., 0],
        **{f"e_outside_{name}": off_e[..., 1 + i] for i, name in enumerate(AXES)},
        "u_outside_U": ~np.all(input_excess(case.input_rows, laps) <= COUNTED, axis=-1),
        "wheels_saturated": np.any(
            (laps.demanded > robot.wheel_speed_max) | (laps.demanded < robot.wheel_speed_min),
            axis=-1,
        ),
        "qp_infeasible": laps.diagnostics.status == qp.INFEASIBLE,
        "qp_unsolved": laps.diagnostics.status == qp.UNSOLVED,
        "row_active": laps.diagnostics.active,
        "backup": laps.diagnostics.status != qp.SOLVED,
        "outside_ultimate_bound": late & ~np.all(settled <= case.task.checks.ultimate, axis=-1),
        "acceleration_exceeded": is_too_fast(case.task.checks, laps),
        "slip_outside_interval": np.zeros(laps.demanded.shape[:2], bool),
        "not_finite": ~(np.isfinite(e).all(axis=-1) & np.isfinite(laps.inputs).all(axis=-1)),
    }
    assert set(found) == set(EVENT_NAMES)
    return np.stack([found[name] for name in EVENT_NAMES], axis=-1)


def is_too_fast(checks, laps):
    """Return where a command differs by too much from the one before, (steps, laps)."""
    if checks.command_step is None:
        return np.zeros(laps.demanded.shape[:2], bool)
    change = np.abs(np.diff(laps.demanded, axis=0))
    found = ~np.all(change <= checks.command_step, axis=-1)
    return np.concatenate([np.zeros((1, found.shape[1]), bool), found])


def positions(design, errors):
    """Return the robots' places: the error is measured in the robot's own frame, from the robot to
    the reference."""
    poses = design.problem.reference.poses[1 : len(errors) + 1, None]
    heading = poses[..., 2] - errors[..., 2]
    ahead = np.cos(heading) * errors[..., 0] - np.sin(heading) * errors[..., 1]
    aside = np.sin(heading) * errors[..., 0] + np.cos(heading) * errors[..., 1]
    return poses[..., :2] - np.stack([ahead, aside], axis=-1)


def plane_counts(points, cells, reach):
    grids = [
        (points[:, second], points[:, first], reach[[second, first]]) for first, second in PLANES
    ]
    return np.stack(
        [np.histogram2d(y, x, cells, [[-r[0], r[0]], [-r[1], r[1]]])[0] for y, x, r in grids]
    )


def recount(case, laps: Trajectory, first: int) -> dict:
    """Return the statistics of recorded laps, but those of plans."""
    checks = case.task.checks
    sets = case.sets
    steps, count = laps.inputs.shape[:2]
    w = batches.model_disturbances(case.design, laps)
    e = laps.errors[1:]
    flags = flags_of(case, laps, w)
    late = e[checks.settled - 1 :]
    corner = np.asarray(checks.map_corner)
    cell = float(checks.map_cell)
    end = corner + cell * np.array(HEAT_CELLS[::-1])
    place = positions(case.design, e).reshape(-1, 2)
    starts = laps.errors[0]
    reach = sets["error"].support(np.eye(3))
    left = flags[..., find_row("e_outside_E")].any(axis=0)
    found = {
        "laps": count,
        "events": by_lap(flags, steps),
        "excess/disturbance": np.nanmax(excess(sets["disturbance"], w), axis=(0, 1)),
        "excess/error": np.nanmax(excess(sets["error"], e), axis=(0, 1)),
        "excess/input": np.nanmax(input_excess(case.input_rows, laps), axis=(0, 1)),
        "command_step": np.nanmax(np.abs(np.diff(laps.demanded, axis=0)), axis=(0, 1)),
        "error_by_step": np.stack([histogram(now) for now in e]),
        "disturbance": histogram(w),
        "peak": histogram(np.abs(e).max(axis=0)),
        "rms": histogram(np.sqrt(np.mean(late**2, axis=0))),
        "map": np.histogram2d(
            place[:, 1], place[:, 0], HEAT_CELLS, np.stack([corner, end], axis=1)[::-1]
        )[0],
        "starts": plane_counts(starts, COVERAGE_CELLS, reach),
        "starts_that_left": plane_counts(starts[left], COVERAGE_CELLS, reach),
    }
    for name, polytope, points in (
        ("error", sets["error"], e),
        ("disturbance", sets["disturbance"], w),
    ):
        found |= ranking(name, usage(polytope, points).max(axis=0), first)
    return found


def ranking(name, used, first):
    order = np.lexsort((np.arange(len(used)), -used))[:WORST]
    order = order[used[order] > -np.inf]
    return {f"worst_usage/{name}": used[order], f"worst_lap/{name}": first + order}


class Plans(NamedTuple):
    """Plans of recorded laps at one step, by an exact solver; NaN where there is none."""

    inputs: np.ndarray
    cost: np.ndarray
    expected: np.ndarray


def best_plans(design, solver, step, errors) -> Plans:
    """Solve every lap's own QP, and sum up what its plan costs along the predicted errors."""
    problem = design.problem
    found = []
    qp = solver.qp(step)
    Q = problem.error_weight
    R = problem.input_weight
    P = design.cost.cost
    A, B = model(problem, problem.schedule[step])
    for error in errors:
        answer = qp.plan(error) if np.isfinite(error).all() else None
        if answer is None:
            found.append((np.full((problem.horizon, 2), np.nan), np.nan, np.full(3, np.nan)))
        else:
            g, e = answer
            cost = np.sum(e[:-1] @ Q * e[:-1]) + e[-1] @ P @ e[-1] + np.sum(g @ R * g)
            found.append((g, cost, A @ error + B @ g[0]))
    return Plans(*map(np.array, zip(*found, strict=True)))


@jax.jit
def sense_at(plant, keys, step, errors):
    """Return the measurement of errors at a step, and the plant's memory after it: walks go on by
    themselves, wherever the robot is."""
    rest = jnp.zeros((len(keys), 3))

    def sense(now, memory):
        return plant.sense(keys, now, memory, rest)[1]

    memory = jax.lax.fori_loop(0, step, sense, plant.initial(keys, rest))
    return plant.sense(keys, step, memory, errors)


def tube_sections(design, name, step):
    if name == "sequence":
        loops = design.windows.loops[design.windows.index[step]]
        return [
            section.polytope()
            for section in sequence_tube(loops, design.problem.disturbance_set)[1:]
        ]
    return [section.polytope() for section in design.tubes[name][1:]]


class Followed(NamedTuple):
    """Plans of all laps made at one step and followed to their end; NaN where there is none."""

    made: np.ndarray
    deviations: np.ndarray
    excess: (
        np.ndarray
    )  # of the cost one step later and what the step itself costs over the cost before
    cost: np.ndarray


def follow(case, solver, laps: Trajectory, keys, step) -> Followed:
    """Plan at a step of recorded laps, follow the plans, and plan again where they expect to be one
    step later."""
    task = case.task
    measured = laps.measured[step]
    plans = best_plans(case.design, solver, step, measured)
    later = best_plans(case.design, solver, step + 1, plans.expected)
    errors = jnp.asarray(laps.errors[step])
    measurement, memory = sense_at(task.plant, keys, step, errors)
    state = LoopState(errors, measurement, (), memory)
    given = planning.Plan(jnp.nan_to_num(jnp.asarray(plans.inputs)), *[jnp.zeros(len(keys))] * 3)
    deviations = np.asarray(
        follow_plan(task.controller, task.plant, keys, state, jnp.asarray(step), given)
    )
    Q = np.asarray(task.checks.error_weight)
    R = np.asarray(task.checks.input_weight)
    g = plans.inputs[:, 0]
    too_much = (
        later.cost
        - plans.cost
        + np.sum(measured @ Q * measured, axis=1)
        + np.sum(g @ R * g, axis=1)
    )
    made = ~np.isnan(plans.cost)
    return Followed(made, np.where(made[:, None], deviations, np.nan), too_much, plans.cost)


def recount_plans(case, laps: Trajectory, keys, stops, first: int) -> dict:
    """Return what the plans made at the steps `stops` of recorded laps come to."""
    design = case.design
    solver = PlainMpc(case.design)
    own = design.problem.scenario.controller.tube
    N = design.problem.horizon
    followed = {step: follow(case, solver, laps, keys, step) for step in stops}
    made = np.stack([plans.made for plans in followed.values()])
    most = np.stack([plans.excess for plans in followed.values()])
    cost = np.stack([plans.cost for plans in followed.values()])
    found = {
        "plans": made.sum(),
        "plans_by_lap": np.bincount(made.sum(axis=0), minlength=len(stops) + 1),
        "next_plan_missing": np.sum(made & np.isnan(most)),
        "cost_excesses": np.sum(made & (most > 1e-9 * np.maximum(cost, 1))),
        "cost_excess": np.nanmax(most),
    }
    for name in design.tubes:
        pairs = [
            list(zip(tube_sections(design, name, step), plans.deviations, strict=True))
            for step, plans in followed.items()
        ]
        flags = np.array([[outside(section, points) for section, points in stop] for stop in pairs])
        flags = flags & made[:, None, :, None]
        most = np.array(
            [[np.nanmax(excess(section, points)) for section, points in stop] for stop in pairs]
        )
        found[f"tube_outside/{name}"] = flags[..., 0].sum(axis=(0, 2))
        found[f"tube_excess/{name}"] = most.max(axis=0)
        if name == own:
            used = np.array(
                [[usage(section, points) for section, points in stop] for stop in pairs]
            )
            used = np.where(made[:, None], used, -np.inf).max(axis=(0, 1))
            found["stage_events"] = np.stack([by_lap(flags[:, j], len(stops)) for j in range(N)])
            found["cloud"] = sum(
                np.stack([cloud(section, points) for section, points in stop]) for stop in pairs
            )
    return found | ranking("tube", used, first)


def join(parts):
    """Return what several parts of a block come to."""
    joined = {}
    for name in parts[0]:
        if name.startswith("worst"):
            ranked = name.partition("/")[2]
            usage = np.concatenate([part[f"worst_usage/{ranked}"] for part in parts])
            lap = np.concatenate([part[f"worst_lap/{ranked}"] for part in parts])
            order = np.lexsort((lap, -usage))[:WORST]
            joined[name] = (usage if "usage" in name else lap)[order]
        else:
            values = [np.asarray(part[name]) for part in parts]
            joined[name] = (
                np.max(values, axis=0)
                if "excess" in name and values[0].dtype.kind == "f"
                else sum(values)
            )
    return joined


def cloud(section, points):
    """Count deviations in the three planes, twice as far as the section's box reaches."""
    reach = np.maximum(section.support(np.eye(3)), section.support(-np.eye(3)))
    return plane_counts(points, CLOUD_CELLS, 2 * reach)
