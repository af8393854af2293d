"""From a design to a Monte Carlo task: closed loop, starts, and the sets that every period is
checked against."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxtube.control.laws import free_gains_of
from jaxtube.control.protocol import Controller
from jaxtube.plant.learning import LearningRobot
from jaxtube.plant.protocol import Plant
from jaxtube.plant.random_keys import make_key
from jaxtube.plant.reference import Reference, settled_step
from jaxtube.simulation.starts import Starts
from jaxtube.statistics.checks import Checks, Facets, FacetsByRegime, Sections
from jaxtube.statistics.run import Task
from jaxtube.statistics.tally import HEAT_CELLS
from jaxtube.synthesis.disturbance import find_learnt_slips
from jaxtube.synthesis.limits import InputRows, find_command_step
from jaxtube.synthesis.parts import Design
from jaxtube.synthesis.problem import Problem
from sets.polytope import Polytope

MAP_MARGIN_M = 0.4
"""What the trajectory map shows around the reference."""
WINDOWS_COMPARED = 32
"""Windows up to which a tube that follows the reference is checked although it is not in use."""


def make_task(
    design: Design, controller: Controller, plant: Plant, starts: Starts, seed: int
) -> Task:
    """Return what every block of a Monte Carlo run of a closed loop needs."""
    checks = make_checks(design, controller)
    if isinstance(plant, LearningRobot):
        radius = find_learnt_slips(design.problem).radius
        checks = dataclasses.replace(checks, slip_radius=jnp.asarray(radius))
    return Task(controller, plant, starts, checks, make_key(seed))


def make_checks(design: Design, controller: Controller) -> Checks:
    """Return what the runs of a controller are measured against."""
    problem = design.problem
    reference = problem.reference
    steps = reference.steps
    used = problem.scenario.controller.tube
    compared = [name for name in design.tubes if name == used or affordable(design, name)]
    transitions, inputs = problem.model.matrices(problem.schedule[:steps])
    settled = settled_step(reference)
    map_corner, map_cell = lay_map_grid(reference)
    keeps_gain = float(problem.scenario.controller.cost == "deviation")
    checks = Checks(
        transitions=transitions,
        input_matrices=inputs,
        disturbance=disturbance_facets(problem),
        error=facets(problem.error_set),
        input=input_facets_of(problem),
        tubes={name: sections(design, name) for name in compared},
        tube=used,
        ultimate=bound_settled_error(design, controller, settled),
        settled=settled,
        poses=reference.poses[: steps + 1],
        map_corner=map_corner,
        map_cell=map_cell,
        cost_errors=cost_of_errors(design),
        error_weight=(1 - keeps_gain) * problem.error_weight,
        input_weight=problem.input_weight,
        kept_gains=keeps_gain * design.windows.gains[:, 0],
        command_step=find_command_step(problem.scenario),
    )
    return jax.device_put(checks)


def lay_map_grid(reference: Reference) -> tuple[Float[np.ndarray, "2"], np.float64]:
    """Return the lower left corner of the trajectory map and the side of its square cells, m."""
    places = reference.poses[: reference.steps + 1, :2]
    corner = places.min(axis=0) - MAP_MARGIN_M
    size = np.ptp(places, axis=0) + 2 * MAP_MARGIN_M
    return corner, np.max(size / np.array(HEAT_CELLS[::-1]))


def facets(polytope: Polytope) -> Facets:
    """Return a polytope with unit normals, and the box around it."""
    unit = polytope.with_unit_normals()
    identity = np.eye(polytope.dimension)
    return Facets(
        normals=unit.normals,
        offsets=unit.offsets,
        lower=-polytope.support(-identity),
        upper=polytope.support(identity),
    )


def disturbance_facets(problem: Problem) -> Facets | FacetsByRegime:
    """Return W, of several regimes that of each."""
    return _arrange_by_regime(problem, [facets(one) for one in problem.disturbances.sets])


def _arrange_by_regime(problem: Problem, by_regime: list[Facets]) -> Facets | FacetsByRegime:
    """Return the one set that all periods share, or that of every regime."""
    if len(by_regime) == 1:
        return by_regime[0]
    sizes = [len(each.offsets) for each in by_regime]
    return FacetsByRegime(
        normals=np.concatenate([each.normals for each in by_regime]),
        offsets=np.concatenate([each.offsets for each in by_regime]),
        lower=np.stack([each.lower for each in by_regime]),
        upper=np.stack([each.upper for each in by_regime]),
        owners=np.repeat(np.arange(len(by_regime)), sizes),
        regimes=problem.period_regimes[: problem.reference.steps],
    )


def input_facets_of(problem: Problem) -> Facets | FacetsByRegime:
    """Return the rows on (u, measured error), of several regimes those of each."""
    every = [regime.input_rows for regime in problem.every_regime]
    if all(rows is every[0] for rows in every):
        return input_facets(every[0])
    return _arrange_by_regime(problem, list(map(input_facets, every)))


def input_facets(rows: InputRows) -> Facets:
    """Return the rows on (u, measured error) in units of u: m/s or rad/s, the coupling in rad/s.

    The set is unbounded along errors that no row limits: the box around it is left infinite.
    """
    scale = np.linalg.norm(rows.inputs, axis=1)
    normals = np.concatenate([rows.inputs, rows.errors], axis=1)
    without_end = np.full(normals.shape[1], np.inf)
    return Facets(normals / scale[:, None], rows.offsets / scale, -without_end, without_end)


def affordable(design: Design, tube: str) -> bool:
    """Return whether a tube that is not in use is checked as well: one that follows the reference
    has sections for every window."""
    follows = design.tubes[tube].follows_reference
    return not follows or len(design.windows.loops) <= WINDOWS_COMPARED


def sections(design: Design, tube: str) -> Sections:
    """Return R_1 .. R_N of a tube, for every window along the reference where they depend on it."""
    by_window = [
        [facets(section.polytope()) for section in row[1:]]
        for row in design.tubes[tube].sections_by_window
    ]
    index = design.windows.index
    follows = design.tubes[tube].follows_reference
    return Sections(_stack(by_window), index if follows else np.zeros_like(index))


def _stack(sections_by_window: list[list[Facets]]) -> Facets:
    """Stack sections of different numbers of facets; rows 0 x <= inf fill up the shorter ones."""
    most = max(len(section.offsets) for row in sections_by_window for section in row)
    rows = [
        jax.tree.map(_stack_arrays, *[_pad(section, most) for section in row])
        for row in sections_by_window
    ]
    return jax.tree.map(_stack_arrays, *rows)


def _stack_arrays(*arrays: np.ndarray) -> np.ndarray:
    return np.stack(arrays)


def _pad(section: Facets, facets: int) -> Facets:
    missing = facets - len(section.offsets)
    normals = np.pad(section.normals, ((0, missing), (0, 0)))
    offsets = np.pad(section.offsets, (0, missing), constant_values=np.inf)
    return section._replace(normals=normals, offsets=offsets)


def bound_settled_error(
    design: Design, controller: Controller, settled: int
) -> Float[np.ndarray, "3"]:
    """Return half widths that hold the measured error from step `settled` on while w is in W and no
    row is active.

    From any start in E, along this reference; infinite for a controller that is no linear gain
    then.
    """
    gains = free_gains_of(controller)
    if gains is None:
        return np.full(3, np.inf)
    problem = design.problem
    regimes = problem.period_regimes
    steps = problem.reference.steps
    transitions, inputs = problem.model.matrices(problem.schedule[:steps])
    loops = transitions + inputs @ np.asarray(gains)
    ends = np.arange(settled, steps + 1)
    # One row of directions for every end, all moved one step further back at a time.
    directions = np.tile(np.eye(3), (len(ends), 1, 1))
    reach = np.zeros((len(ends), 3))
    for back in range(1, steps + 1):
        live = ends >= back
        period = ends[live] - back
        reach[live] += problem.disturbances.support(regimes[period], directions[live])
        directions[live] = directions[live] @ loops[period]
    of_start = problem.error_set.support(directions.reshape(-1, 3)).reshape(-1, 3)
    return np.max(reach + of_start, axis=0)


def cost_of_errors(design: Design) -> Float[np.ndarray, "windows 3 3"]:
    """Return the matrices of what a plan of no input costs, by the error it starts from."""
    problem = design.problem
    transitions, _ = problem.model.matrices(design.windows.schedules)
    if problem.scenario.controller.cost == "deviation":
        return _cost_of_deviating(transitions, design.windows.gains, problem.input_weight)
    cost = np.broadcast_to(design.cost.cost, transitions[:, 0].shape)
    for stage in range(problem.horizon - 1, -1, -1):
        A = transitions[:, stage]
        cost = problem.error_weight + np.swapaxes(A, 1, 2) @ cost @ A
    return cost


def _cost_of_deviating(
    transitions: Float[np.ndarray, "windows horizon 3 3"],
    gains: Float[np.ndarray, "windows horizon 2 3"],
    input_weight: Float[np.ndarray, "2 2"],
) -> Float[np.ndarray, "windows 3 3"]:
    """Return the matrices of what it costs to ask for nothing where gains would ask for more."""
    ahead = np.broadcast_to(np.eye(3), transitions[:, 0].shape)
    cost = np.zeros_like(transitions[:, 0])
    for stage in range(transitions.shape[1]):
        asked = gains[:, stage] @ ahead
        cost = cost + np.swapaxes(asked, 1, 2) @ input_weight @ asked
        ahead = transitions[:, stage] @ ahead
    return cost
