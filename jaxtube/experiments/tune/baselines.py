"""Baselines of a tuned design: the same descent on fewer variables, and searches without gradients.

Every evaluation is logged, so that a comparison that was killed goes on where it was.
"""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Any, NamedTuple

import jax.numpy as jnp
import msgspec
import numpy as np
from jaxtyping import Bool, Float

from jaxtube.control.laws import ScheduledGain
from jaxtube.experiments.tune.front_figure import Kind
from jaxtube.experiments.tune.result import COMPARED_LAPS, Result, run_comparison, weights_at
from jaxtube.progress import progress
from jaxtube.simulation.components import make_wheel_map
from jaxtube.synthesis.problem import Problem, with_controller
from jaxtube.tuning.bar import DescentBar
from jaxtube.tuning.judgement import HeldOutJudgement, pool
from jaxtube.tuning.objective import LapMeasures, lap_costs, total_cost
from jaxtube.tuning.parameters import Variables, make_parameters
from jaxtube.tuning.run import Descent, Log, Settings, descend
from jaxtube.tuning.search import EvaluateValue, log_grid, nelder_mead, random_search
from jaxtube.tuning.tuner import COMPARED, Point, Tuner
from sets.riccati import lqr_gain

GRADIENT = 3
"""What a gradient takes in evaluations: searches are judged after as many as there were gradients,
and after this many times as many."""
SPREAD = 1.0
"""Standard deviation of a random search, in logarithms of weights and gains."""
SIMPLEX = 0.5
"""Size of a first simplex, in logarithms of weights and gains."""
EFFORTS = (0.018, 0.022, 0.034, 0.040)
"""Limits of effort along the front, m/s."""
TUBES = (1.0, 8.0)
"""Weights of the tube along the front."""
FRONT_SHARE = 4
"""Of the descent's budget, one part in this many for every point of the front."""


class Axis(NamedTuple):
    """Values of a diagonal entry along a grid."""

    centre: float
    decades: float
    count: int


GRID = {
    "Q11": Axis(0.1, 3.0, 4),
    "Q22": Axis(10.0, 4.0, 5),
    "Q33": Axis(0.1, 2.0, 2),
    "R11": Axis(1.0, 0.0, 1),
    "R22": Axis(0.3, 3.0, 5),
}
"""Diagonal Q and R of a full grid: 200 points in all. R11 is the unit."""


class ComparedDesign(NamedTuple):
    """One design of the comparison: where it is, what it came to, and what that took."""

    name: str
    tuner: Tuner
    point: Point
    result: Result
    evaluations: int
    kind: Kind
    static: bool = False  # LQR gains without prediction and tube


class Spots(NamedTuple):
    """Many designs by the few numbers that are drawn."""

    lateral: Float[np.ndarray, " n"]  # RMS once settled, m
    effort: Float[np.ndarray, " n"]  # RMS, m/s
    tube: Float[np.ndarray, " n"]  # lateral half width of the minimal RPI set, m
    certified: Bool[np.ndarray, " n"]


def with_variables(tuner: Tuner, variables: Variables) -> Tuner:
    """Return the tuner with other variables."""
    return dataclasses.replace(tuner, parameters=make_parameters(tuner.problem, variables))


def tune_parts(tuner: Tuner, log: Log, settings: Settings) -> list[ComparedDesign]:
    """Tune Q and R alone, and the gains alone."""
    entries = []
    parts: tuple[Variables, ...] = ("weights", "gains")
    for variables in parts:
        part = with_variables(tuner, variables)
        descent = _descend(part, log, settings, variables)
        point = _best(descent).point
        entries.append(
            ComparedDesign(
                name=f"{variables} alone",
                tuner=part,
                point=point,
                result=run_comparison(part, point),
                evaluations=GRADIENT * descent.outcome.evaluations,
                kind="search",
            )
        )
    return entries


def _descend(tuner: Tuner, log: Log, settings: Settings, name: str) -> Descent:
    with DescentBar(progress(settings.evaluations, f"tuning {name}", "gradients")) as bar:
        return descend(tuner, settings, log, bar, name)


def _best(descent: Descent) -> HeldOutJudgement:
    """Return the best certified iterate, of none the best one."""
    best = descent.best() or descent.best(accept_uncertified=True)
    return best or descent.judged[0]


def search_without_gradients(
    tuner: Tuner, log: Log, budget: int, seed: int
) -> list[ComparedDesign]:
    """Search without gradients over the same variables."""
    start = tuner.parameters.vector
    with progress(2 * budget, "searching without gradients", "evaluations") as bar:
        of_random = _logged_value(tuner, log, "random", bar)
        of_simplex = _logged_value(tuner, log, "simplex", bar)
        spread = np.full(len(start), SPREAD)
        searches = {
            "random search": random_search(of_random, start, spread, budget, seed),
            "simplex search": nelder_mead(of_simplex, start, budget, SIMPLEX),
        }
    entries = []
    for name, search in searches.items():
        # A search of fewer evaluations asks for the first points of a longer one.
        for spent in (budget // GRADIENT, budget):
            best = search.points[int(np.argmin(search.values[:spent]))]
            result = run_comparison(tuner, best)
            entries.append(ComparedDesign(f"{name}, {spent}", tuner, best, result, spent, "search"))
    return entries


def _logged_value(tuner: Tuner, log: Log, stream: str, bar: Any) -> EvaluateValue:
    """Return the objective on the draws 0, each evaluation logged."""

    def value(point: Point) -> float:
        bar.update()
        question = {"point": point}
        answer = log.remember(stream, question, lambda: {"value": tuner.value(point, 0)})
        return float(answer["value"])

    return value


def search_static_lqr(tuner: Tuner, log: Log, budget: int, seed: int) -> ComparedDesign:
    """Search Q and R of static LQR gains; the objective is that of the laps alone, for there is no
    tube."""
    weights = with_variables(tuner, "weights")
    start = weights.parameters.vector

    def cost(laps: LapMeasures) -> float:
        return float(total_cost(laps, jnp.zeros(3), tuner.aim))

    def compute(point: Point) -> dict[str, float]:
        return {"value": cost(run_static_lqr(weights, point, 0, tuner.laps))}

    def value(point: Point) -> float:
        bar.update()
        answer = log.remember("lqr", {"point": point}, partial(compute, point))
        return float(answer["value"])

    with progress(budget, "searching LQR weights", "evaluations") as bar:
        best = random_search(value, start, np.full(len(start), SPREAD), budget, seed).best
    laps = run_static_lqr(weights, best, COMPARED, COMPARED_LAPS)
    result = Result(
        costs=np.asarray(lap_costs(laps, tuner.aim)),
        errors=laps.errors,
        effort=laps.effort,
        settled_effort=laps.settled_effort,
        unplanned=int(laps.backups.sum()),
        objective=cost(laps),
        certified=False,
        failing=("no tube, no certificate",),
        half_widths=None,
        fill=np.nan,
    )
    return ComparedDesign("static LQR", weights, best, result, budget, "search", static=True)


def run_static_lqr(tuner: Tuner, point: Point, first: int, count: int) -> LapMeasures:
    """Return the laps of the LQR gains of a point's Q and R."""
    problem = tuner.problem
    weights = weights_at(tuner, point)
    path = problem.schedule[: problem.reference.steps]
    schedules, index = np.unique(path, axis=0, return_inverse=True)
    transitions, inputs = problem.model.matrices(schedules)
    gains = [
        lqr_gain(transition, matrix, weights.error_weight, weights.input_weight)
        for transition, matrix in zip(transitions, inputs, strict=True)
    ]
    along = np.stack(gains)[index.reshape(-1)]
    controller = ScheduledGain(jnp.asarray(along), make_wheel_map(problem))
    return tuner.drive(controller, first, count)


def grid_gains(tuner: Tuner, tuned: Point) -> dict[str, Float[np.ndarray, " kappa"]]:
    """Return the gains that grids over Q and R are run with."""
    kappa = weights_at(tuner, tuned).kappa
    return {"the start's gains": tuner.problem.given_gains, "the tuned gains": kappa}


def run_grid(tuner: Tuner, log: Log, kappa: Float[np.ndarray, " kappa"], name: str) -> Spots:
    """Run the designs of a full grid over diagonal Q and R with given gains; their certificates are
    not asked for."""
    problem = _with_gains(tuner.problem, kappa)
    parameters = make_parameters(problem, "diagonal")
    other = dataclasses.replace(tuner, problem=problem, parameters=parameters)
    points = _grid_points()
    stream = f"grid-{'-'.join(name.replace(chr(39), '').split())}"
    rows = []
    with progress(len(points), f"grid with {name}", "designs") as bar:
        for point in points:
            answer = log.remember(stream, {"point": point}, partial(_spot, other, point))
            rows.append(answer["spot"])
            bar.update()
    lateral, effort, tube = np.array(rows).T
    return Spots(lateral, effort, tube, np.zeros(len(rows), bool))


def _with_gains(problem: Problem, kappa: Float[np.ndarray, " kappa"]) -> Problem:
    """Return the problem with other gains of the same kind."""
    if len(kappa) == 3:
        gains = {"tracking_gains": tuple(kappa.tolist())}
    else:
        gains = {"vertex_gains": tuple(map(tuple, kappa.reshape(4, 6).tolist()))}
    controller = msgspec.structs.replace(problem.scenario.controller, **gains)
    scenario = msgspec.structs.replace(problem.scenario, controller=controller)
    return with_controller(problem, scenario)


def _grid_points() -> Float[np.ndarray, "designs 5"]:
    """Return the points of the grid: of Q = L L^T, the logarithms of L's diagonal."""
    centres = np.array([axis.centre for axis in GRID.values()])
    decades = np.array([axis.decades for axis in GRID.values()])
    shape = tuple(axis.count for axis in GRID.values())
    return np.log(log_grid(centres, decades / 2, shape)) / 2


def _spot(tuner: Tuner, point: Point) -> dict[str, np.ndarray]:
    """Return lateral error, effort and tube of a design, NaN where it has no closed loop."""
    played = tuner.play(point, COMPARED, tuner.laps)
    if played is None:
        return {"spot": np.full(3, np.nan)}
    laps, shares = played
    cap = tuner.problem.operating_set.offsets[1]
    return {"spot": np.array([pool(laps.errors[:, 1]), pool(laps.effort), shares[1] * cap])}


def tune_front(tuner: Tuner, log: Log, settings: Settings, tuned: Point) -> Spots:
    """Descend again from the tuned design under other limits of effort and weights of the tube."""
    start = tuner.parameters.start_at(tuned)
    shorter = settings._replace(evaluations=max(settings.evaluations // FRONT_SHARE, 1))
    aims = {}
    for limit in EFFORTS:
        aims[f"effort-{limit:g}"] = dataclasses.replace(tuner.aim, effort_limit=limit)
    for weight in TUBES:
        aims[f"tube-{weight:g}"] = dataclasses.replace(tuner.aim, tube_weight=weight)
    best = []
    for name, aim in aims.items():
        other = dataclasses.replace(tuner, parameters=start, aim=aim)
        descent = _descend(other, log, shorter, f"front-{name.replace('.', '-')}")
        best.append(_best(descent))
    cap = tuner.problem.operating_set.offsets[1]
    return Spots(
        lateral=np.array([judgement.lateral for judgement in best]),
        effort=np.array([judgement.overall_effort for judgement in best]),
        tube=np.array([judgement.shares[1] * cap for judgement in best]),
        certified=np.array([judgement.certified for judgement in best]),
    )


def result_spot(result: Result) -> Spots:
    """Return the numbers of one result that are drawn."""
    widths = result.half_widths
    return Spots(
        lateral=np.array([result.rms(1)]),
        effort=np.array([result.overall_effort]),
        tube=np.array([np.nan if widths is None else widths[1]]),
        certified=np.array([result.certified]),
    )
