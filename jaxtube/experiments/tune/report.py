"""The report of a tuning run: the start and the tuned design side by side, on laps that neither
tuning nor stopping saw."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from jaxtube.experiments.run.folder import RunFolder
from jaxtube.experiments.run.page_table import make_table
from jaxtube.experiments.run.table import Column, format_table, left
from jaxtube.experiments.tune.figures import error_figure, tube_figure
from jaxtube.experiments.tune.parameter_figure import parameter_figure
from jaxtube.experiments.tune.result import (
    COMPARED_LAPS,
    Result,
    compute_reduction,
    result_numbers,
    run_comparison,
    weights_at,
)
from jaxtube.figures.learning import make_curve
from jaxtube.reporting.page import Page, Section, Table
from jaxtube.simulation.usage import play
from jaxtube.synthesis.certificate.fill import widest_tube
from jaxtube.tuning.judgement import pool
from jaxtube.tuning.loop import Weights
from jaxtube.tuning.parameters import Point
from jaxtube.tuning.tune import Tuned
from jaxtube.tuning.tuner import COMPARED, Tuner
from sets.polytope import Polytope

DRAWN_LAPS = 128


class Summary(NamedTuple):
    """A report, its first line, its numbers, and the start beside the tuned design."""

    text: str
    verdict: str
    numbers: dict
    compared: Table


def summarise_tuning(tuned: Tuned) -> Summary:
    """Compare the start with the iterate that is returned, and say what its certificate came to."""
    tuner = tuned.tuner
    assert tuned.best is not None
    before = run_comparison(tuner, tuner.parameters.vector)
    after = run_comparison(tuner, tuned.best.point)
    reduction = compute_reduction(before.errors[:, 1], after.errors[:, 1])
    effort_increase = after.overall_effort / before.overall_effort - 1
    weights = weights_at(tuner, tuned.best.point)
    outcome = tuned.descent.outcome
    columns = [
        left(f"{COMPARED_LAPS} laps seen by neither tuning nor stopping"),
        Column("start"),
        Column("tuned"),
    ]
    rows = _rows(before, after)
    verdict = say_verdict(tuned, reduction.share, effort_increase)
    lines = [
        verdict,
        "",
        f"{outcome.evaluations} gradients of {tuner.laps} laps; {outcome.sentence}",
        "",
        format_table(columns, rows),
        "",
        f"lateral error once settled: {reduction.share:.1%} less (95 %: {reduction.low:.1%} to "
        f"{reduction.high:.1%}), effort {effort_increase:+.1%}",
        "",
        *_weight_lines(weights),
        "",
        tuned.verdict,
    ]
    numbers = {
        "start": result_numbers(before),
        "tuned": result_numbers(after),
        "lateral_reduction": reduction._asdict(),
        "effort_increase": effort_increase,
        "gradients": outcome.evaluations,
        "iterations": outcome.iterations,
        "stop": outcome.stop,
        "sentence": outcome.sentence,
        "certified_iterates": int(tuned.descent.certified.sum()),
        "weights": weights._asdict(),
    }
    return Summary("\n".join(lines), verdict, numbers, make_table(columns, rows))


def make_page(tuned: Tuned, summary: Summary) -> Page:
    """Return the page of a tuning run."""
    reduction = summary.numbers["lateral_reduction"]
    interval = f"{reduction['low']:.1%} to {reduction['high']:.1%}"
    lead = [
        f"{tuned.verdict}.",
        f"Lateral error once settled: {reduction['share']:.1%} less (95 %: {interval}).",
        f"The descent: {summary.numbers['sentence']}.",
    ]
    tone = "good" if tuned.is_certified else "bad"
    return Page(summary.verdict, tone, lead, [Section("Start and result", [summary.compared])])


def say_verdict(tuned: Tuned, reduction: float, effort_increase: float) -> str:
    """Return one line: whether what came out is certified, and what it does better.

    Args:
        tuned: what came out.
        reduction: share by which the lateral error is less than at the start.
        effort_increase: share by which the effort is more.
    """
    certified = "CERTIFIED" if tuned.is_certified else "NOT CERTIFIED"
    return (
        f"{certified}; lateral error once settled {reduction:.1%} less than at the start, effort "
        f"{effort_increase:+.1%}"
    )


def _rows(before: Result, after: Result) -> list[tuple[str, str, str]]:
    """Return the lines of the table: a name, the start's number and the tuned design's."""

    def line(name: str, read: Callable[[Result], str]) -> tuple[str, str, str]:
        return name, read(before), read(after)

    return [
        line("longitudinal error once settled, RMS [mm]", lambda of: f"{1e3 * of.rms(0):.3f}"),
        line("lateral error once settled, RMS [mm]", lambda of: f"{1e3 * of.rms(1):.3f}"),
        line("heading error once settled, RMS [deg]", lambda of: f"{np.rad2deg(of.rms(2)):.4f}"),
        line("effort, RMS over the lap [m/s]", lambda of: f"{of.overall_effort:.5f}"),
        line("effort once settled, RMS [m/s]", lambda of: f"{pool(of.settled_effort):.5f}"),
        line("steps without a plan", lambda of: str(of.unplanned)),
        line("lateral half width of the minimal RPI set [cm]", _lateral_half_width),
        line("the tube fills at most [% of a cap]", lambda of: f"{100 * of.fill:.1f}"),
        line("objective", lambda of: f"{of.objective:.4f}"),
        line("certified", lambda of: "yes" if of.certified else "no"),
    ]


def _lateral_half_width(result: Result) -> str:
    return "none" if result.half_widths is None else f"{100 * result.half_widths[1]:.2f}"


def _weight_lines(weights: Weights) -> list[str]:
    unit = max(np.abs(weights.error_weight).max(), np.abs(weights.input_weight).max())
    gains = np.array2string(np.asarray(weights.kappa), precision=4, suppress_small=True)
    return [
        "weights over the largest entry of both",
        *_matrix_lines("error_weight", weights.error_weight / unit),
        *_matrix_lines("input_weight", weights.input_weight / unit),
        f"gains          {gains}",
    ]


def _matrix_lines(name: str, matrix: Float[np.ndarray, "n n"]) -> list[str]:
    text = np.array2string(matrix, precision=5, suppress_small=True)
    return [f"{name}", *(f"  {row}" for row in text.splitlines())]


def iterate_arrays(tuned: Tuned) -> dict[str, np.ndarray]:
    """Return every iterate with its results, as arrays over the iterations."""
    descent = tuned.descent
    curve = make_curve(descent)
    points = [judgement.point for judgement in descent.judged]
    weights = [weights_at(tuned.tuner, point) for point in points]
    return {
        "point": np.stack(points),
        "error_weight": np.stack([each.error_weight for each in weights]),
        "input_weight": np.stack([each.input_weight for each in weights]),
        "gains": np.stack([each.kappa for each in weights]),
        "objective": curve.objective,
        "held_out": curve.held_out,
        "certified": curve.certified,
        "lateral_m": curve.lateral,
        "effort_mps": curve.effort,
        "cost_low": curve.low,
        "cost_high": curve.high,
        "lateral_share": descent.measure(lambda judgement: judgement.shares[1]),
    }


def draw(folder: RunFolder, tuned: Tuned) -> None:
    """Draw learning curve, tubes, error bands and parameters."""
    tuner = tuned.tuner
    assert tuned.best is not None
    start = tuner.parameters.vector
    best = tuned.best.point
    arrays = iterate_arrays(tuned)
    caps = tuner.problem.operating_set.offsets[:3]
    folder.save_figure(tuned.plot(), "learning")
    tubes = tube_figure(_tube(tuner, start), _tube(tuner, best), caps)
    folder.save_figure(tubes, "tube")
    errors = error_figure(
        _drawn_errors(tuner, start),
        _drawn_errors(tuner, best),
        tuner.problem.model.dt,
        tuner.aim.settled,
    )
    folder.save_figure(errors, "errors")
    parameters = parameter_figure(
        arrays["error_weight"],
        arrays["input_weight"],
        arrays["gains"],
        tuner.parameters.names[9:],
        arrays["certified"],
    )
    folder.save_figure(parameters, "parameters")


def _tube(tuner: Tuner, point: Point) -> Polytope | None:
    """Return the widest tube of a point, None where it has no design or no bound."""
    prepared = tuner.candidate(point).prepared
    if prepared is None:
        return None
    return widest_tube(prepared.problem, prepared.terminal.gains)


def _drawn_errors(tuner: Tuner, point: Point) -> Float[np.ndarray, "steps+1 laps 3"]:
    """Return the errors of the laps that are drawn, start included."""
    conditions = tuner.lap_inputs(COMPARED, DRAWN_LAPS)
    seen = jax.jit(play)(tuner.controller(point), *conditions)
    starts = np.asarray(conditions.starts)[None]
    return np.concatenate([starts, np.asarray(seen["error"])])
