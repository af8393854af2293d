"""One design on the laps that neither tuning nor stopping saw, and its numbers."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.stats import bootstrap

from jaxtube.coordinates import TO_DISPLAY
from jaxtube.experiments.run.metrics import by_coordinate
from jaxtube.statistics.intervals import CONFIDENCE
from jaxtube.synthesis.certificate.fill import widest_tube
from jaxtube.tuning.judgement import pool
from jaxtube.tuning.loop import Weights
from jaxtube.tuning.parameters import Point
from jaxtube.tuning.tuner import Tuner

COMPARED_LAPS = 1024
RESAMPLES = 2000


class Result(NamedTuple):
    """One design on the laps of the comparison."""

    costs: Float[np.ndarray, " laps"]
    errors: Float[np.ndarray, "laps 3"]  # RMS once settled (m, m, rad)
    effort: Float[np.ndarray, " laps"]  # RMS over the whole lap, m/s
    settled_effort: Float[np.ndarray, " laps"]
    unplanned: int  # steps without a plan
    objective: float
    certified: bool
    failing: tuple[str, ...]
    half_widths: Float[np.ndarray, "3"] | None  # of the minimal RPI set's bound (m, m, rad)
    fill: float  # largest share of a cap

    def rms(self, coordinate: int) -> float:
        """RMS error of a coordinate over all laps, once settled."""
        return pool(self.errors[:, coordinate])

    @property
    def overall_effort(self) -> float:
        """RMS effort over all laps, m/s."""
        return pool(self.effort)


def run_comparison(tuner: Tuner, point: Point) -> Result:
    """Run a point on the laps of the comparison.

    Raises:
        ValueError: where it has no closed loop.
    """
    judgement = tuner.compare(point, COMPARED_LAPS)
    prepared = tuner.candidate(point).prepared
    if prepared is None or not judgement.has_laps:
        reason = ", ".join(judgement.failing)
        raise ValueError(f"point: has no closed loop ({reason}); choose another")
    bound = widest_tube(prepared.problem, prepared.terminal.gains)
    return Result(
        costs=judgement.costs,
        errors=judgement.errors,
        effort=judgement.effort,
        settled_effort=judgement.settled_effort,
        unplanned=int(judgement.backups.sum()),
        objective=judgement.held_out,
        certified=judgement.certified,
        failing=judgement.failing,
        half_widths=None if bound is None else bound.support(np.eye(3)),
        fill=float(judgement.shares.max()),
    )


class Reduction(NamedTuple):
    """By what share a number falls, with its 95 % interval."""

    share: float
    low: float
    high: float


def compute_reduction(
    before: Float[np.ndarray, " laps"], after: Float[np.ndarray, " laps"]
) -> Reduction:
    """Return by what share an RMS over laps falls, with its 95 % interval over pairs of laps.

    Source: Efron, Tibshirani 1993, chapter 13 (bootstrap percentiles, pairs drawn together).
    """
    squares = (before**2, after**2)
    if np.array_equal(*squares):
        return Reduction(0.0, 0.0, 0.0)
    resampled = bootstrap(
        squares,
        _compute_rms_reduction,
        paired=True,
        method="percentile",
        n_resamples=RESAMPLES,
        confidence_level=CONFIDENCE,
        rng=np.random.default_rng(0),
        batch=100,
    )
    interval = resampled.confidence_interval
    share = float(_compute_rms_reduction(*squares))
    return Reduction(share, float(interval.low), float(interval.high))


def _compute_rms_reduction(before, after, axis: int = -1) -> Any:
    """Return by what share the root of the mean falls."""
    return 1.0 - np.sqrt(np.mean(after, axis=axis) / np.mean(before, axis=axis))


def result_numbers(result: Result) -> dict:
    """Return a result as plain numbers."""
    widths = result.half_widths
    rms_errors = np.array([result.rms(coordinate) for coordinate in range(3)])
    return {
        "rms_error": by_coordinate(rms_errors * TO_DISPLAY),
        "effort_mps": result.overall_effort,
        "settled_effort_mps": pool(result.settled_effort),
        "steps_without_plan": result.unplanned,
        "lap_cost": {"mean": result.costs.mean(), "p90": np.quantile(result.costs, 0.9)},
        "objective": result.objective,
        "certified": result.certified,
        "failing": list(result.failing),
        "minimal_rpi_half_widths": None if widths is None else by_coordinate(widths * TO_DISPLAY),
        "largest_cap_share": result.fill,
    }


def weights_at(tuner: Tuner, point: Point) -> Weights:
    """Return Q, R and the gains' numbers of a point, as numpy arrays."""
    return jax.tree.map(np.asarray, tuner.parameters.weights(jnp.asarray(point)))
