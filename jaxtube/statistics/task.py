"""From a design to a Monte Carlo task: closed loop, starts, and the sets that every period is
checked against."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxtube.control.laws import free_gains_of
from jaxtube.plant.reference import settled_step
from jaxtube.simulation import closed_loop
from jaxtube.simulation.starts import FixedStart, uniform_start
from jaxtube.statistics.checks import Checks, Facets, Sections
from jaxtube.statistics.run import Task
from jaxtube.statistics.tally import HEAT_CELLS
from jaxtube.synthesis.design import Design
from jaxtube.synthesis.feasible import true_starts
from sets.polytope import Polytope

MAP_MARGIN_M = 0.4
"""What the trajectory map shows around the reference."""


def make_task(design: Design, controller: str, plant: str, starts: str, seed: int) -> Task:
    """Return the task of a run; `controller`, `plant` and `starts` as the command `montecarlo`
    names them."""
    loop = closed_loop.controllers(design)[controller]
    makers = {"robot": closed_loop.slipping_robot, "linear": closed_loop.linear_plant}
    problem = design.problem
    if starts == "scenario":
        start = FixedStart(jnp.asarray(problem.initial_error))
    else:
        first = int(design.windows.index[0])
        # The seed of the set's shape is fixed: the law that starts are drawn from is the scenario's
        # alone.
        start = uniform_start(
            true_starts(design.tube_window, first, problem, seed=0), edge=starts == "edge"
        )
    return Task(loop, makers[plant](design), start, make_checks(design, loop), jax.random.key(seed))


def make_checks(design: Design, controller) -> Checks:
    """Return what the runs of a controller are measured against."""
    problem, reference = design.problem, design.problem.reference
    steps, tube = reference.steps, problem.scenario.controller.tube
    transitions, inputs = problem.model.matrices(problem.schedule[:steps])
    settled = settled_step(reference)
    poses = reference.poses[: steps + 1]
    corner, size = (
        poses[:, :2].min(axis=0) - MAP_MARGIN_M,
        np.ptp(poses[:, :2], axis=0) + 2 * MAP_MARGIN_M,
    )
    checks = Checks(
        transitions=jnp.asarray(transitions),
        input_matrices=jnp.asarray(inputs),
        disturbance=facets(problem.disturbance_set),
        error=facets(problem.error_set),
        input=facets(problem.input_set),
        tubes={
            name: sections(design, name)
            for name in design.tubes
            if name == tube or affordable(design, name)
        },
        tube=tube,
        ultimate=jnp.asarray(ultimate_bound(design, controller, settled)),
        settled=settled,
        poses=jnp.asarray(poses),
        map_corner=jnp.asarray(corner),
        map_cell=jnp.asarray(np.max(size / np.array(HEAT_CELLS[::-1]))),
        cost_errors=jnp.asarray(cost_of_errors(design)),
        error_weight=jnp.asarray(problem.error_weight),
        input_weight=jnp.asarray(problem.input_weight),
    )
    return jax.tree.map(jnp.asarray, checks)


def facets(polytope: Polytope) -> Facets:
    """Return a polytope with unit normals, and the box around it."""
    scale = np.linalg.norm(polytope.normals, axis=1)
    identity = np.eye(polytope.dimension)
    box = -polytope.support(-identity), polytope.support(identity)
    return Facets(polytope.normals / scale[:, None], polytope.offsets / scale, *box)


WINDOWS_COMPARED = 32


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


def _stack(every: list[list[Facets]]) -> Facets:
    """Stack sections of different numbers of facets; rows 0 x <= inf fill up the shorter ones."""
    most = max(len(section.offsets) for row in every for section in row)

    def padded(section: Facets) -> Facets:
        missing = most - len(section.offsets)
        normals = np.pad(section.normals, ((0, missing), (0, 0)))
        return section._replace(
            normals=normals, offsets=np.pad(section.offsets, (0, missing), constant_values=np.inf)
        )

    stacked = [jax.tree.map(lambda *arrays: np.stack(arrays), *map(padded, row)) for row in every]
    return jax.tree.map(lambda *arrays: np.stack(arrays), *stacked)


def ultimate_bound(design: Design, controller, settled: int) -> Float[np.ndarray, "3"]:
    """Return half widths that hold the measured error from step `settled` on while w is in W and no
    row is active.

    From any start in E, along this reference; infinite for a controller that is no linear gain
    then.
    """
    problem, steps = design.problem, design.problem.reference.steps
    gains = free_gains_of(controller)
    if gains is None:
        return np.full(3, np.inf)
    transitions, inputs = problem.model.matrices(problem.schedule[:steps])
    loops, W, ends = (
        transitions + inputs @ np.asarray(gains),
        problem.disturbance_set,
        np.arange(settled, steps + 1),
    )
    # One row of directions for every end, all moved one step further back at a time.
    directions, reach = np.tile(np.eye(3), (len(ends), 1, 1)), np.zeros((len(ends), 3))
    for back in range(1, steps + 1):
        live = ends >= back
        reach[live] += W.support(directions[live].reshape(-1, 3)).reshape(-1, 3)
        directions[live] = directions[live] @ loops[ends[live] - back]
    return np.max(
        reach + problem.error_set.support(directions.reshape(-1, 3)).reshape(-1, 3), axis=0
    )


def cost_of_errors(design: Design) -> Float[np.ndarray, "windows 3 3"]:
    """Return the matrices of what a plan of no input costs, by the error it starts from."""
    problem = design.problem
    transitions, _ = problem.model.matrices(design.windows.schedules)
    cost = np.broadcast_to(design.cost.cost, transitions[:, 0].shape)
    for stage in range(problem.horizon - 1, -1, -1):
        A = transitions[:, stage]
        cost = problem.error_weight + np.swapaxes(A, 1, 2) @ cost @ A
    return cost
