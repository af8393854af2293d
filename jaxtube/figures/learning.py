"""The figure of a tuning run's iterations: objectives, lateral errors and effort.

Iterates are filled where their design is certified and hollow where it is not; the one that a run
returns is the certified one of the least held-out objective.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from jaxtube.figures.style import (
    LIMIT,
    area_key,
    bottom_legend,
    line_key,
    page_figure,
    styled,
)
from jaxtube.figures.ticks import plain_ticks, spans_decade
from jaxtube.tuning.run import Descent

METHODS = {"adam": "Adam", "lbfgs": "L-BFGS-B"}
LOOKS = (("#0072B2", "o"), ("#D55E00", "s"), ("#009E73", "^"), ("#CC79A7", "D"))
"""Colours and marks of runs shown together."""
RETURNED: dict[str, Any] = {
    "marker": "*",
    "markersize": 11,
    "markeredgecolor": "black",
    "markeredgewidth": 0.7,
}
TRAINING: dict[str, Any] = {"color": "0.2", "linewidth": 0.8, "linestyle": (0, (2, 1))}
ITERATE: dict[str, Any] = {
    "marker": "o",
    "markersize": 3,
    "markeredgewidth": 0.7,
    "linestyle": "none",
    "zorder": 3,
}
MAGNIFIED_FROM = 3
"""Iterates close to the best from which on they are magnified."""


class LearningCurve(NamedTuple):
    """The iterates of a run, one an entry; what was not computed is NaN or infinite."""

    iteration: Int[np.ndarray, " iterates"]
    objective: Float[np.ndarray, " iterates"]  # over the draws it was minimised on
    held_out: Float[np.ndarray, " iterates"]
    low: Float[np.ndarray, " iterates"]  # 10 % quantile of the costs of held-out laps
    high: Float[np.ndarray, " iterates"]  # 90 % quantile
    certified: Bool[np.ndarray, " iterates"]
    lateral: Float[np.ndarray, " iterates"]  # RMS of e_y once settled, held out, m
    effort: Float[np.ndarray, " iterates"]  # RMS, held out, m/s

    @property
    def returned(self) -> int | None:
        """Index of the certified iterate of the least held-out objective."""
        eligible = np.where(self.certified & np.isfinite(self.held_out), self.held_out, np.inf)
        return int(np.argmin(eligible)) if np.isfinite(eligible).any() else None

    @property
    def close(self) -> Bool[np.ndarray, " iterates"]:
        """Certified iterates whose held-out objective is at most twice the returned one's."""
        best = np.nan if self.returned is None else self.held_out[self.returned]
        return self.certified & (self.held_out <= 2 * best)


def make_curve(descent: Descent) -> LearningCurve:
    """Return the learning curve of a descent."""
    held_out = np.array([judgement.held_out for judgement in descent.judged])
    return LearningCurve(
        iteration=np.arange(len(held_out)),
        objective=descent.objective,
        held_out=held_out,
        low=descent.measure(lambda judgement: float(np.quantile(judgement.costs, 0.1))),
        high=descent.measure(lambda judgement: float(np.quantile(judgement.costs, 0.9))),
        certified=descent.certified,
        lateral=descent.measure(lambda judgement: judgement.lateral),
        effort=descent.measure(lambda judgement: judgement.overall_effort),
    )


def draw_descent(descent: Descent, effort_limit: float) -> Figure:
    """Draw the learning curve of a descent; the limit of the effort, m/s, only where finite."""
    curves = {METHODS[descent.method]: make_curve(descent)}
    return learning_figure(curves, effort_limit if np.isfinite(effort_limit) else None)


@styled
def learning_figure(curves: Mapping[str, LearningCurve], effort_limit: float | None) -> Figure:
    """Draw objectives, lateral errors and effort by iteration.

    Where objectives span more than a decade, another panel magnifies those of certified iterates
    close to the best, unless they are too few.

    Args:
        curves: by the name of the run, which may be empty; four at most.
        effort_limit: of the RMS, m/s.
    """
    runs = list(curves.values())
    wide = spans_decade(np.concatenate([values for curve in runs for values in curve[1:5]]))
    magnified = wide and sum(curve.close.sum() for curve in runs) >= MAGNIFIED_FROM
    figure = page_figure(4.1 + 0.15 * len(curves))
    below = "certified" if magnified else "cost"
    panels = figure.subplot_mosaic(
        [["cost", "lateral"], [below, "effort"]], sharex=True, width_ratios=(1.25, 1)
    )
    for curve, look in zip(runs, LOOKS, strict=False):
        _draw_run(panels, curve, look)
    if effort_limit is not None:
        panels["effort"].axhline(effort_limit, **LIMIT)
    if wide:
        panels["cost"].set_yscale("log")
    if magnified:
        _show_close(panels["certified"], runs)
        panels["certified"].set_title("the same, magnified close to the best")
        panels["certified"].set_ylabel("objective [–]")
    panels["cost"].set(title="objective", ylabel="objective [–]")
    panels["lateral"].set(title="lateral error once settled", ylabel="RMS of $e_y$ [mm]")
    panels["effort"].set(title="effort", ylabel="RMS of effort [m/s]")
    if spans_decade(np.concatenate([curve.lateral for curve in runs])):
        panels["lateral"].set_yscale("log")
        plain_ticks(panels["lateral"].yaxis)
    for name in (below, "effort"):
        panels[name].set_xlabel("iteration")
    for axes in panels.values():
        axes.margins(x=0.02)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    names = [_run_key(*run, look) for run, look in zip(curves.items(), LOOKS, strict=False)]
    figure.legend(handles=names, loc="outside upper center", ncols=1)
    bottom_legend(figure, _keys(runs, effort_limit), columns=3)
    figure.align_ylabels()
    return figure


def _draw_run(panels: Mapping[Any, Axes], curve: LearningCurve, look: tuple[str, str]) -> None:
    """Draw the objectives, errors and effort of one run."""
    for name in ("cost", "certified"):
        if name in panels:
            _draw_objective(panels[name], curve, look[0])
            _draw_iterates(panels[name], curve, curve.held_out, look)
    _draw_iterates(panels["lateral"], curve, 1e3 * curve.lateral, look)
    _draw_iterates(panels["effort"], curve, curve.effort, look)


def _draw_objective(axes: Axes, curve: LearningCurve, colour: str) -> None:
    """Draw the band of the laps' costs and the objective that was minimised."""
    low = _mask_infinite(curve.low)
    high = _mask_infinite(curve.high)
    axes.fill_between(curve.iteration, low, high, color=colour, alpha=0.18, linewidth=0)
    axes.plot(curve.iteration, _mask_infinite(curve.objective), **TRAINING, zorder=2.5)


def _draw_iterates(
    axes: Axes, curve: LearningCurve, values: Float[np.ndarray, " iterates"], look: tuple[str, str]
) -> None:
    """Draw a line through all iterates, marks on each of them and the mark of the returned one."""
    colour, marker = look
    shown = _mask_infinite(values)
    axes.plot(curve.iteration, shown, color=colour, linewidth=0.9)
    for chosen, face in ((~curve.certified, "white"), (curve.certified, colour)):
        marks = {**ITERATE, "marker": marker, "color": colour, "markerfacecolor": face}
        axes.plot(curve.iteration[chosen], shown[chosen], **marks)
    if curve.returned is not None:
        place = (curve.iteration[curve.returned], values[curve.returned])
        # A star on the edge of the panel is drawn whole.
        axes.plot(*place, color=colour, zorder=4, clip_on=False, **RETURNED)


def _mask_infinite(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    return np.where(np.isfinite(values), values, np.nan)


def _show_close(axes: Axes, runs: list[LearningCurve]) -> None:
    """Let the ordinate end around the certified iterates close to the best, with their bands."""
    close = [values[curve.close] for curve in runs for values in curve[2:5]]
    values = _mask_infinite(np.concatenate(close))
    least = np.nanmin(values)
    greatest = np.nanmax(values)
    margin = 0.06 * (greatest - least) or 0.05 * abs(greatest)
    axes.set_ylim(least - margin, greatest + margin)


def _run_key(name: str, curve: LearningCurve, look: tuple[str, str]) -> Line2D:
    """Return the entry of a run, with what it came to."""
    text = "no certified iterate"
    best = curve.returned
    if best is not None:
        objective = f"{curve.held_out[0]:.3g} → {curve.held_out[best]:.3g}"
        lateral = f"{1e3 * curve.lateral[0]:.3g} → {1e3 * curve.lateral[best]:.3g}"
        effort = f"{curve.effort[0]:.3g} → {curve.effort[best]:.3g}"
        text = f"objective {objective}, lateral RMS {lateral} mm, effort {effort} m/s"
        text += f" (iteration {curve.iteration[best]})"
    label = f"{name}: {text}" if name else text
    return line_key(label, color=look[0], marker=look[1], markersize=4)


def _keys(runs: list[LearningCurve], effort_limit: float | None) -> list:
    mark: dict[str, Any] = {"marker": "o", "markersize": 3.5, "color": "0.25", "linewidth": 0.9}
    keys: list[Any] = []
    if any(curve.certified.any() for curve in runs):
        keys.append(line_key("held-out laps, certified", **mark))
    if not all(curve.certified.all() for curve in runs):
        keys.append(line_key("held-out laps, not certified", markerfacecolor="white", **mark))
    keys.append(line_key("training laps", **TRAINING))
    keys.append(area_key("10 % to 90 % of the held-out laps' costs", "0.35", alpha=0.3))
    if any(curve.returned is not None for curve in runs):
        keys.append(line_key("returned", linestyle="none", color="0.75", **RETURNED))
    if effort_limit is not None:
        keys.append(line_key("limit of the effort", **LIMIT))
    return keys
