"""What a tuned design is compared with: the same descent on fewer variables, and searches without
gradients.

Every evaluation is logged, so that a comparison that was killed goes on where it was.
"""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
import msgspec
import numpy as np
from jaxtyping import Bool, Float

from jaxtube.control.laws import ScheduledGain
from jaxtube.experiments.options import Tune
from jaxtube.experiments.run.progress import progress
from jaxtube.experiments.tune.front_figure import Kind
from jaxtube.experiments.tune.log import Log
from jaxtube.experiments.tune.report import COMPARED_LAPS, Result, result, weights_at
from jaxtube.experiments.tune.run import Descent, Judgement, descend
from jaxtube.simulation.closed_loop import make_wheel_map
from jaxtube.synthesis.problem import with_controller
from jaxtube.tuning.objective import Laps, lap_costs, total_cost
from jaxtube.tuning.parameters import parameters
from jaxtube.tuning.search import log_grid, nelder_mead, random_search
from jaxtube.tuning.tuner import COMPARED, Point, Tuner
from sets.lmi import lqr_gain

GRADIENT = 3
"""What a gradient takes in evaluations: searches are judged after as many as there were gradients,
and after this many times as many."""
SPREAD, SIMPLEX = 1.0, 0.5
"""Standard deviation of a random search and size of a first simplex, in logarithms of weights and
gains."""
GRID = {
    "Q11": (0.1, 3.0, 4),
    "Q22": (10.0, 4.0, 5),
    "Q33": (0.1, 2.0, 2),
    "R11": (1.0, 0.0, 1),
    "R22": (0.3, 3.0, 5),
}
"""Centre, decades and number of values of each diagonal entry: 200 points in all. R11 is the unit."""
EFFORTS = (0.018, 0.022, 0.034, 0.040)
TUBES = (1.0, 8.0)
"""Limits of effort, m/s, and weights of the tube along the front."""
FRONT_SHARE = 4
"""Of the descent's budget, one part in this many for every point of the front."""


class Entry(NamedTuple):
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


def alone(tuner: Tuner, log: Log, options: Tune) -> list[Entry]:
    """Tune Q and R alone, and the gains alone."""
    entries = []
    for variables in ("weights", "gains"):
        other = dataclasses.replace(tuner, parameters=parameters(tuner.problem, variables))
        found = _descended(other, log, options, variables, options.evaluations)
        point = _best(found).point
        spent = GRADIENT * found.outcome.evaluations
        entries.append(
            Entry(f"{variables} alone", other, point, result(other, point), spent, "search")
        )
    return entries


def _descended(tuner: Tuner, log: Log, options: Tune, name: str, budget: int) -> Descent:
    settings = options.method, budget, options.patience, options.learning_rate
    return descend(tuner, log, name, *settings, lambda found: None)


def _best(descent: Descent) -> Judgement:
    """Return the best certified iterate, of none the best one."""
    best = descent.outcome.best_certified or descent.outcome.best_uncertified
    return descent.judged[best.iteration if best else 0]


def searched(tuner: Tuner, log: Log, budget: int, seed: int) -> list[Entry]:
    """Search without gradients over the same variables."""
    start = tuner.parameters.vector
    entries = []
    with progress(2 * budget, "searching without gradients", "evaluations") as bar:
        value = {name: _logged(tuner, log, name, bar) for name in ("random", "simplex")}
        found = {
            "random search": random_search(
                value["random"], start, np.full(len(start), SPREAD), budget, seed
            ),
            "simplex search": nelder_mead(value["simplex"], start, budget, SIMPLEX),
        }
    for name, search in found.items():
        # Both are their own beginnings: a search of fewer evaluations asks for the same points.
        for spent in (budget // GRADIENT, budget):
            best = search.points[int(np.argmin(search.values[:spent]))]
            entries.append(
                Entry(f"{name}, {spent}", tuner, best, result(tuner, best), spent, "search")
            )
    return entries


def _logged(tuner: Tuner, log: Log, name: str, bar):
    """Return the objective on the draws 0, each evaluation logged."""

    def value(point: Point) -> float:
        bar.update()
        answer = log.remember(name, {"point": point}, lambda: {"value": tuner.value(point, 0)})
        return float(answer["value"])

    return value


def static_lqr(tuner: Tuner, log: Log, budget: int, seed: int) -> Entry:
    """Search Q and R of static LQR gains; the objective is that of the laps alone, for there is no
    tube."""
    weights = dataclasses.replace(tuner, parameters=parameters(tuner.problem, "weights"))
    start = weights.parameters.vector

    def cost(laps: Laps) -> float:
        return float(total_cost(laps, jnp.zeros(3), tuner.aim))

    def value(point: Point) -> float:
        bar.update()
        answer = log.remember(
            "lqr",
            {"point": point},
            lambda: {"value": cost(static_laps(weights, point, 0, tuner.laps))},
        )
        return float(answer["value"])

    with progress(budget, "searching LQR weights", "evaluations") as bar:
        best = random_search(value, start, np.full(len(start), SPREAD), budget, seed).best
    laps = static_laps(weights, best, COMPARED, COMPARED_LAPS)
    certified = False, ("no tube, no certificate",)
    found = Result(
        np.asarray(lap_costs(laps, tuner.aim)),
        *laps[:3],
        int(laps.backups.sum()),
        cost(laps),
        *certified,
        None,
        np.nan,
    )
    return Entry("static LQR", weights, best, found, budget, "search", static=True)


def static_laps(tuner: Tuner, point: Point, first: int, count: int) -> Laps:
    """Return the laps of the LQR gains of a point's Q and R."""
    problem, weights = tuner.problem, weights_at(tuner, point)
    schedules, index = np.unique(
        problem.schedule[: problem.reference.steps], axis=0, return_inverse=True
    )
    pairs = zip(*problem.model.matrices(schedules), strict=True)
    gains = np.stack(
        [lqr_gain(*pair, weights.error_weight, weights.input_weight) for pair in pairs]
    )
    controller = ScheduledGain(jnp.asarray(gains[index.reshape(-1)]), make_wheel_map(problem))
    return tuner.drive(controller, first, count)


def grid_gains(tuner: Tuner, tuned: Point) -> dict[str, Float[np.ndarray, " kappa"]]:
    """Return the gains that grids over Q and R are run with."""
    kappa = weights_at(tuner, tuned).kappa
    return {"the start's gains": tuner.problem.given_gains, "the tuned gains": kappa}


def grid(tuner: Tuner, log: Log, kappa: Float[np.ndarray, " kappa"], name: str) -> Spots:
    """Run the designs of a full grid over diagonal Q and R with given gains; their certificates are
    not asked for."""
    settings = tuner.problem.scenario.controller
    key = "tracking_gains" if len(kappa) == 3 else "vertex_gains"
    gains = (
        tuple(kappa.tolist())
        if len(kappa) == 3
        else tuple(map(tuple, kappa.reshape(4, 6).tolist()))
    )
    settings = msgspec.structs.replace(settings, **{key: gains})
    scenario = msgspec.structs.replace(tuner.problem.scenario, controller=settings)
    problem = with_controller(tuner.problem, scenario)
    other = dataclasses.replace(tuner, problem=problem, parameters=parameters(problem, "diagonal"))
    centres, decades, shape = (np.array(column) for column in zip(*GRID.values(), strict=True))
    points = log_grid(centres, decades / 2, tuple(shape.astype(int)))
    stream = f"grid-{'-'.join(name.replace(chr(39), '').split())}"

    def compute(point):
        played = other.played(point, COMPARED, tuner.laps)
        if played is None:
            return {"spot": np.full(3, np.nan)}
        _, laps, shares = played
        lateral, effort = (
            np.sqrt(np.mean(values**2)) for values in (laps.errors[:, 1], laps.effort)
        )
        return {"spot": np.array([lateral, effort, shares[1] * problem.operating_set.offsets[1]])}

    rows = []
    with progress(len(points), f"grid with {name}", "designs") as bar:
        for weights in points:
            point = np.log(weights) / 2  # of Q = L L^T, the logarithm of L's diagonal
            rows.append(log.remember(stream, {"point": point}, partial(compute, point))["spot"])
            bar.update()
    lateral, effort, tube = np.array(rows).T
    return Spots(lateral, effort, tube, np.zeros(len(rows), bool))


def front(tuner: Tuner, log: Log, options: Tune, tuned: Point) -> Spots:
    """Descend again from the tuned design under other limits of effort and weights of the tube."""
    start = tuner.parameters.beginning_at(tuned)
    budget = max(options.evaluations // FRONT_SHARE, 1)
    best = []
    aims = {
        f"effort-{limit:g}": dataclasses.replace(tuner.aim, effort_limit=limit) for limit in EFFORTS
    }
    aims |= {
        f"tube-{weight:g}": dataclasses.replace(tuner.aim, tube_weight=weight) for weight in TUBES
    }
    for name, aim in aims.items():
        other = dataclasses.replace(tuner, parameters=start, aim=aim)
        best.append(
            _best(_descended(other, log, options, f"front-{name.replace('.', '-')}", budget))
        )
    cap = tuner.problem.operating_set.offsets[1]
    lateral, effort, tube = np.array(
        [(each.lateral, each.overall_effort, each.shares[1] * cap) for each in best]
    ).T
    return Spots(lateral, effort, tube, np.array([each.certified for each in best]))


def spots_of(results: list[Result]) -> Spots:
    """Return the numbers of results that are drawn."""
    widths = [np.nan if each.half_widths is None else each.half_widths[1] for each in results]
    laterals, efforts = [each.rms(1) for each in results], [each.overall_effort for each in results]
    return Spots(
        np.array(laterals),
        np.array(efforts),
        np.array(widths),
        np.array([each.certified for each in results]),
    )
