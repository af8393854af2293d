"""What a tuning run says: the start and the tuned design side by side, on laps that neither tuning
nor stopping saw."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.stats import bootstrap

from jaxtube.experiments.run.folder import RunFolder
from jaxtube.experiments.tune import figures as tune_figures
from jaxtube.experiments.tune.parameter_figure import parameter_figure
from jaxtube.experiments.tune.run import Descent, Judgement, pooled
from jaxtube.simulation.usage import play
from jaxtube.synthesis.certificate.fill import widest_tube
from jaxtube.tuning.loop import Weights
from jaxtube.tuning.objective import lap_costs
from jaxtube.tuning.tuner import COMPARED, Point, Tuner

COMPARED_LAPS = 1024
DRAWN_LAPS = 128
RESAMPLES, CONFIDENCE = 2000, 0.95
FIGURES = ("learning", "tube", "errors", "parameters")


class Result(NamedTuple):
    """One design on the laps of the comparison."""

    costs: Float[np.ndarray, " laps"]
    errors: Float[np.ndarray, "laps 3"]  # RMS once settled (m, m, rad)
    effort: Float[np.ndarray, " laps"]
    settled_effort: Float[np.ndarray, " laps"]
    unplanned: int  # steps without a plan
    objective: float
    certified: bool
    failing: tuple[str, ...]
    half_widths: Float[np.ndarray, "3"] | None  # of the minimal RPI set's bound (m, m, rad)
    fill: float  # largest share of a cap

    def rms(self, coordinate: int) -> float:
        """RMS error of a coordinate over all laps, once settled."""
        return pooled(self.errors[:, coordinate])

    @property
    def overall_effort(self) -> float:
        """RMS effort over all laps, m/s."""
        return pooled(self.effort)


class Summary(NamedTuple):
    """A report and its numbers."""

    text: str
    numbers: dict


def result(tuner: Tuner, point: Point) -> Result:
    """Run a point on the laps of the comparison."""
    found = tuner.compare(point, COMPARED_LAPS)
    assert found.laps is not None and found.shares is not None
    ingredients = tuner.designed(point).ingredients
    assert ingredients is not None
    bound = widest_tube(ingredients.problem, ingredients.terminal.gains)
    return Result(
        np.asarray(lap_costs(found.laps, tuner.aim)),
        found.laps.errors,
        found.laps.effort,
        found.laps.settled_effort,
        int(found.laps.backups.sum()),
        found.held_out,
        found.certified,
        found.failing,
        None if bound is None else bound.support(np.eye(3)),
        float(found.shares.max()),
    )


def reduction(
    before: Float[np.ndarray, " laps"], after: Float[np.ndarray, " laps"]
) -> tuple[float, float, float]:
    """Return by what share an RMS over laps falls, with its 95 % interval over pairs of laps.

    Source: Efron, Tibshirani 1993, chapter 13 (bootstrap percentiles, pairs drawn together).
    """
    squares = before**2, after**2
    if np.array_equal(*squares):
        return 0.0, 0.0, 0.0

    def fall(one, other, axis=-1):
        return 1.0 - np.sqrt(np.mean(other, axis=axis) / np.mean(one, axis=axis))

    generator = np.random.default_rng(0)
    found = bootstrap(
        squares,
        fall,
        paired=True,
        method="percentile",
        n_resamples=RESAMPLES,
        confidence_level=CONFIDENCE,
        rng=generator,
        batch=100,
    )
    interval = found.confidence_interval
    return float(fall(*squares)), float(interval.low), float(interval.high)


def summary(tuner: Tuner, descent: Descent, best: Judgement, verdict: str) -> Summary:
    """Compare the start with the iterate that is returned, and say what its certificate came to."""
    before, after = result(tuner, tuner.parameters.vector), result(tuner, best.point)
    fall = reduction(before.errors[:, 1], after.errors[:, 1])
    weights = weights_at(tuner, best.point)
    unit = max(np.abs(weights.error_weight).max(), np.abs(weights.input_weight).max())
    lines = [
        f"{descent.outcome.evaluations} gradients of {tuner.laps} laps; {descent.outcome.sentence}",
        "",
        f"{COMPARED_LAPS} laps seen by neither tuning nor stopping{'start':>18}{'tuned':>12}",
        *(f"  {name:<44}{first:>14}{second:>12}" for name, first, second in _rows(before, after)),
        "",
        f"lateral error once settled: {fall[0]:.1%} less (95 %: {fall[1]:.1%} to {fall[2]:.1%}), "
        f"effort {after.overall_effort / before.overall_effort - 1:+.1%}",
        "",
        "weights over the largest entry of both",
        *_matrix("error_weight", weights.error_weight / unit),
        *_matrix("input_weight", weights.input_weight / unit),
        f"gains          {np.array2string(np.asarray(weights.kappa), precision=4, suppress_small=True)}",
        "",
        verdict,
    ]
    numbers = {
        "start": numbers_of(before),
        "tuned": numbers_of(after),
        "lateral_reduction": dict(zip(("share", "low", "high"), fall, strict=True)),
        "effort_increase": after.overall_effort / before.overall_effort - 1,
        "gradients": descent.outcome.evaluations,
        "iterations": descent.outcome.iterations,
        "stop": descent.outcome.stop,
        "sentence": descent.outcome.sentence,
        "certified_iterates": int(descent.certified.sum()),
        "weights": weights._asdict(),
    }
    return Summary("\n".join(lines), numbers)


def weights_at(tuner: Tuner, point: Point) -> Weights:
    """Return Q, R and the gains' numbers of a point, as numpy arrays."""
    return jax.tree.map(np.asarray, tuner.parameters.weights(jnp.asarray(point)))


def _rows(before: Result, after: Result) -> list[tuple[str, str, str]]:
    def widths(found: Result) -> str:
        return "none" if found.half_widths is None else f"{100 * found.half_widths[1]:.2f}"

    def line(name: str, read) -> tuple[str, str, str]:
        return name, read(before), read(after)

    return [
        line(
            "longitudinal error once settled, RMS [mm]", lambda found: f"{1e3 * found.rms(0):.3f}"
        ),
        line("lateral error once settled, RMS [mm]", lambda found: f"{1e3 * found.rms(1):.3f}"),
        line(
            "heading error once settled, RMS [deg]", lambda found: f"{np.rad2deg(found.rms(2)):.4f}"
        ),
        line("effort, RMS over the lap [m/s]", lambda found: f"{found.overall_effort:.5f}"),
        line(
            "effort once settled, RMS [m/s]",
            lambda found: f"{np.sqrt(np.mean(found.settled_effort**2)):.5f}",
        ),
        line("steps without a plan", lambda found: str(found.unplanned)),
        line("lateral half width of the minimal RPI set [cm]", widths),
        line("the tube fills at most [% of a cap]", lambda found: f"{100 * found.fill:.1f}"),
        line("objective", lambda found: f"{found.objective:.4f}"),
        line("certified", lambda found: "yes" if found.certified else "no"),
    ]


def _matrix(name: str, matrix: Float[np.ndarray, "n n"]) -> list[str]:
    text = np.array2string(matrix, precision=5, suppress_small=True)
    return [f"{name}", *(f"  {row}" for row in text.splitlines())]


def numbers_of(found: Result) -> dict:
    """Return a result as plain numbers."""
    widths = found.half_widths
    return {
        "rms_error": {
            "longitudinal_m": found.rms(0),
            "lateral_m": found.rms(1),
            "heading_deg": np.rad2deg(found.rms(2)),
        },
        "effort_mps": found.overall_effort,
        "settled_effort_mps": np.sqrt(np.mean(found.settled_effort**2)),
        "steps_without_plan": found.unplanned,
        "lap_cost": {"mean": found.costs.mean(), "p90": np.quantile(found.costs, 0.9)},
        "objective": found.objective,
        "certified": found.certified,
        "failing": list(found.failing),
        "minimal_rpi_half_widths": None
        if widths is None
        else {
            "longitudinal_m": widths[0],
            "lateral_m": widths[1],
            "heading_deg": np.rad2deg(widths[2]),
        },
        "largest_cap_share": found.fill,
    }


def why_not(descent: Descent) -> str:
    """Name what the best of the uncertified iterates lacks."""
    best = descent.outcome.best_uncertified
    failing = descent.judged[best.iteration if best else -1].failing
    return f"the best one fails {', '.join(failing)}"


def arrays(tuner: Tuner, descent: Descent) -> dict[str, np.ndarray]:
    """Return every iterate with its results, as arrays over the iterations."""
    points = np.stack([each.point for each in descent.judged])
    weights = [weights_at(tuner, point) for point in points]
    return {
        "point": points,
        "error_weight": np.stack([each.error_weight for each in weights]),
        "input_weight": np.stack([each.input_weight for each in weights]),
        "gains": np.stack([each.kappa for each in weights]),
        "objective": descent.objective,
        "held_out": np.array([each.held_out for each in descent.judged]),
        "certified": descent.certified,
        "lateral_m": np.array([_or_nan(each, lambda one: one.lateral) for each in descent.judged]),
        "effort_mps": np.array(
            [_or_nan(each, lambda one: one.overall_effort) for each in descent.judged]
        ),
        "cost_low": np.array(
            [_or_nan(each, lambda one: np.quantile(one.costs, 0.1)) for each in descent.judged]
        ),
        "cost_high": np.array(
            [_or_nan(each, lambda one: np.quantile(one.costs, 0.9)) for each in descent.judged]
        ),
        "lateral_share": np.array(
            [_or_nan(each, lambda one: one.shares[1]) for each in descent.judged]
        ),
    }


def _or_nan(found: Judgement, read) -> float:
    return float(read(found)) if len(found.costs) else np.nan


def curve(tuner: Tuner, descent: Descent) -> tune_figures.Curve:
    """Return the learning curve of a descent."""
    found = arrays(tuner, descent)
    iteration = np.arange(len(descent.judged))
    names = (
        "objective",
        "held_out",
        "cost_low",
        "cost_high",
        "certified",
        "lateral_m",
        "effort_mps",
    )
    return tune_figures.Curve(iteration, *(found[name] for name in names))


def draw(folder: RunFolder, tuner: Tuner, descent: Descent, best: Judgement) -> None:
    """Draw learning curve, tubes, error bands and parameters."""
    limit = tuner.aim.effort_limit
    found = arrays(tuner, descent)
    before, after = (_tube(tuner, point) for point in (tuner.parameters.vector, best.point))
    bands = [_drawn_errors(tuner, point) for point in (tuner.parameters.vector, best.point)]
    dt, settled = tuner.problem.model.dt, tuner.aim.settled
    names = tuner.parameters.names[9:]
    figures = (
        tune_figures.learning_figure(
            {descent.method: curve(tuner, descent)}, limit if np.isfinite(limit) else None
        ),
        tune_figures.tube_figure(before, after, tuner.problem.operating_set.offsets[:3]),
        tune_figures.error_figure(*bands, dt, settled),
        parameter_figure(
            found["error_weight"], found["input_weight"], found["gains"], names, found["certified"]
        ),
    )
    for name, figure in zip(FIGURES, figures, strict=True):
        folder.save_figure(figure, name)


def _tube(tuner: Tuner, point: Point):
    ingredients = tuner.designed(point).ingredients
    return (
        None
        if ingredients is None
        else widest_tube(ingredients.problem, ingredients.terminal.gains)
    )


def _drawn_errors(tuner: Tuner, point: Point) -> Float[np.ndarray, "steps+1 laps 3"]:
    starts = tuner.starts(DRAWN_LAPS)
    controller = tuner.controller(point)
    seen = jax.jit(play)(controller, tuner.plant, tuner.keys(COMPARED, DRAWN_LAPS), starts)
    return np.concatenate([np.asarray(starts)[None], np.asarray(seen["error"])])
