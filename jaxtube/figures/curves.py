"""Curves of closed-loop runs: one a controller, drawn as a band over its realisations.

Bands are pointwise in time: median, 5 to 95 % of the realisations, and the extremes. Controllers
whose errors agree to within `COINCIDE` are drawn once, under a joint name, so that no curve hides
another.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes

from jaxtube.figures.style import Line, area_key, controller_lines, draw_line
from jaxtube.synthesis.problem import Problem

COINCIDE = 1e-5
"""Errors closer than this, m and rad, are the same line on paper."""

QUANTILES = (0.0, 0.05, 0.5, 0.95, 1.0)

BAND_KEYS = (
    area_key("5 % to 95 % of the runs", "0.35", alpha=0.45),
    area_key("all runs", "0.35", alpha=0.18),
)
"""Entries of the legend that explain a band."""


class Curve(NamedTuple):
    """One curve to draw: its look and the run behind it."""

    line: Line
    errors: Float[np.ndarray, "steps+1 batch 3"]
    wheels: Float[np.ndarray, "steps batch 2"]


def make_curves(runs: Mapping[str, Any]) -> dict[str, Curve]:
    """Return the runs in drawing order; those that coincide appear once, under the name listed
    last."""
    lines = controller_lines(runs)
    curves: dict[str, Curve] = {}
    for name, line in reversed(lines.items()):
        errors = np.asarray(runs[name].errors)
        twin = _find_twin(curves, errors)
        if twin is None:
            curves[name] = Curve(line, errors, np.asarray(runs[name].wheels))
        else:
            joint = curves[twin].line
            label = f"{joint.label} = {line.label}"
            curves[twin] = curves[twin]._replace(line=joint._replace(label=label))
    return dict(reversed(curves.items()))


def _find_twin(curves: Mapping[str, Curve], errors: np.ndarray) -> str | None:
    """Return the name of a curve whose errors coincide with these, None where there is none."""
    for name, curve in curves.items():
        same_shape = curve.errors.shape == errors.shape
        if same_shape and np.allclose(curve.errors, errors, rtol=0, atol=COINCIDE):
            return name
    return None


def label_in_lines(line: Line) -> str:
    """Return the label of a line with a joint name on several lines."""
    return line.label.replace(" = ", "\n= ")


def leaves_error_set(
    problem: Problem, errors: Float[np.ndarray, "steps+1 batch 3"]
) -> Bool[np.ndarray, " batch"]:
    """Tell which runs leave E; NaN is outside."""
    limits = problem.error_set.offsets[:3]
    return ~np.all(np.abs(errors) <= limits, axis=(0, 2))


def quantiles(
    values: Float[np.ndarray, "times batch"], shares: Sequence[float]
) -> Float[np.ndarray, "shares times"]:
    """Return quantiles over the runs at each time; runs that are NaN are left out."""
    if not np.isnan(values).any():
        return np.quantile(values, shares, axis=1)
    with warnings.catch_warnings():
        # Where every run is NaN, so is the quantile.
        warnings.simplefilter("ignore", RuntimeWarning)
        return np.nanquantile(values, shares, axis=1)


def draw_band(axes: Axes, time, values: Float[np.ndarray, "times batch"], line: Line) -> None:
    """Draw median, 5 to 95 % band and the extremes of many runs."""
    least, low, median, high, greatest = quantiles(values, QUANTILES)
    axes.fill_between(time, least, greatest, color=line.colour, alpha=0.15, linewidth=0)
    axes.fill_between(time, low, high, color=line.colour, alpha=0.3, linewidth=0)
    # Edges tell apart bands that lie on each other.
    axes.plot(time, np.stack([low, high], axis=1), color=line.colour, linewidth=0.4)
    draw_line(axes, time, median, line, label=line.label)
