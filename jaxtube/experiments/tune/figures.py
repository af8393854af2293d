"""Figures of a tuning run: its iterations, and the tube and the errors before and after.

What was before is grey, what comes after is drawn in a strong colour. Iterates are filled where
their design is certified and hollow where it is not; the one that a run returns is the certified
one of the least held-out objective.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from jaxtube.experiments.figures.sets import IN_MILLIMETRES, PLANES
from jaxtube.experiments.figures.style import (
    LIMIT,
    REFERENCE,
    Line,
    bottom_legend,
    draw_polygon,
    error_label,
    line_keys,
    page_figure,
    styled,
)
from sets.polytope import Polytope

BEFORE, AFTER = Line("before tuning", "0.5", (0, (4, 1.2))), Line("after tuning", "#0072B2")
IN_CENTIMETRES = np.array([1e2, 1e2, np.rad2deg(1.0)])
CENTIMETRES, MILLIMETRES = ("cm", "cm", "deg"), ("mm", "mm", "deg")
DECADE = 10.0
"""Ratio of the greatest to the least value from which an axis is logarithmic."""

RUNS = (("#0072B2", "o"), ("#D55E00", "s"), ("#009E73", "^"), ("#CC79A7", "D"))
"""Colours and marks of runs shown together."""
RETURNED: dict[str, Any] = {
    "marker": "*",
    "markersize": 11,
    "markeredgecolor": "black",
    "markeredgewidth": 0.7,
}
QUANTILES = (0.05, 0.5, 0.95)


class Curve(NamedTuple):
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


@styled
def learning_figure(curves: Mapping[str, Curve], effort_limit: float | None) -> Figure:
    """Draw objectives, lateral errors and effort by iteration.

    Where objectives span more than a decade, another panel magnifies those of certified iterates
    close to the best.

    Args:
        curves: by the name of the run, which may be empty; four at most.
        effort_limit: of the RMS, m/s.
    """
    objectives = np.concatenate([values for curve in curves.values() for values in curve[1:5]])
    close = np.concatenate(
        [values[curve.close] for curve in curves.values() for values in curve[2:5]]
    )
    wide = spans_decade(objectives)
    magnified = wide and np.isfinite(close).any()
    figure = page_figure(4.1 + 0.15 * len(curves))
    panels = figure.subplot_mosaic(
        [["cost", "lateral"], ["certified" if magnified else "cost", "effort"]],
        sharex=True,
        width_ratios=(1.25, 1),
    )
    for curve, look in zip(curves.values(), RUNS, strict=False):
        for name in ("cost", "certified") if magnified else ("cost",):
            _draw_objective(panels[name], curve, look[0])
            _draw_iterates(panels[name], curve, curve.held_out, look)
        _draw_iterates(panels["lateral"], curve, 1e3 * curve.lateral, look)
        _draw_iterates(panels["effort"], curve, curve.effort, look)
    if effort_limit is not None:
        panels["effort"].axhline(effort_limit, **LIMIT)
    if wide:
        panels["cost"].set_yscale("log")
    if magnified:
        _show(panels["certified"], close)
        panels["certified"].set(
            title="the same, magnified close to the best", ylabel="objective [–]"
        )
    panels["cost"].set(title="objective", ylabel="objective [–]")
    panels["lateral"].set(title="lateral error once settled", ylabel="RMS of $e_y$ [mm]")
    panels["effort"].set(title="effort", ylabel="RMS of effort [m/s]")
    if spans_decade(np.concatenate([curve.lateral for curve in curves.values()])):
        panels["lateral"].set_yscale("log")
        plain_ticks(panels["lateral"].yaxis)
    for axes in {panels["certified" if magnified else "cost"], panels["effort"]}:
        axes.set_xlabel("iteration")
    for axes in panels.values():
        axes.margins(x=0.02)
    names = [_run_key(*named, look) for named, look in zip(curves.items(), RUNS, strict=False)]
    figure.legend(handles=names, loc="outside upper center", ncols=1)
    keys = _learning_keys()
    if any(curve.returned is not None for curve in curves.values()):
        keys.append(Line2D([], [], linestyle="none", color="0.75", label="returned", **RETURNED))
    if effort_limit is not None:
        keys.append(Line2D([], [], label="limit of the effort", **LIMIT))
    bottom_legend(figure, keys, columns=3)
    figure.align_ylabels()
    return figure


def spans_decade(values: Float[np.ndarray, " n"]) -> bool:
    """Tell whether the finite values are all positive and span more than a decade."""
    finite = values[np.isfinite(values)]
    return finite.size > 0 and bool(finite.min() > 0 and finite.max() > DECADE * finite.min())


def plain_ticks(axis: Axis) -> None:
    """Let a logarithmic axis, whose limits are known, count 1, 2, 5, 10 and so on, finer within a
    decade."""
    low, high = axis.get_view_interval()
    counts = (1, 2, 5) if high > DECADE * low else (1, 1.5, 2, 3, 4, 5, 7)
    axis.set_major_locator(LogLocator(subs=counts))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def _draw_objective(axes: Axes, curve: Curve, colour: str) -> None:
    """Draw the band of the laps' costs and the objective that was minimised."""
    low, high, objective = (_finite(values) for values in (curve.low, curve.high, curve.objective))
    axes.fill_between(curve.iteration, low, high, color=colour, alpha=0.18, linewidth=0)
    axes.plot(
        curve.iteration, objective, color="0.2", linewidth=0.8, linestyle=(0, (2, 1)), zorder=2.5
    )


def _draw_iterates(
    axes: Axes, curve: Curve, values: Float[np.ndarray, " iterates"], look: tuple[str, str]
) -> None:
    """Draw a line through all iterates, marks on each of them and the mark of the returned one."""
    colour, marker = look
    axes.plot(curve.iteration, _finite(values), color=colour, linewidth=0.9)
    for chosen, face in ((~curve.certified, "white"), (curve.certified, colour)):
        axes.plot(
            curve.iteration[chosen],
            _finite(values)[chosen],
            **{
                "marker": marker,
                "markersize": 3,
                "markeredgewidth": 0.7,
                "linestyle": "none",
                "zorder": 3,
            },
            color=colour,
            markerfacecolor=face,
        )
    if curve.returned is not None:
        axes.plot(
            curve.iteration[curve.returned],
            values[curve.returned],
            color=colour,
            zorder=4,
            **RETURNED,
        )


def _finite(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    return np.where(np.isfinite(values), values, np.nan)


def _show(axes: Axes, values: Float[np.ndarray, " n"]) -> None:
    """Let the ordinate end close to the values, whatever else is drawn."""
    least, greatest = np.nanmin(_finite(values)), np.nanmax(_finite(values))
    margin = 0.06 * (greatest - least) or 0.05 * abs(greatest)
    axes.set_ylim(least - margin, greatest + margin)


def _run_key(name: str, curve: Curve, look: tuple[str, str]) -> Line2D:
    """Return the entry of a run, with what it came to."""
    text, best = "no certified iterate", curve.returned
    if best is not None:
        start, found = (
            (curve.held_out[i], 1e3 * curve.lateral[i], curve.effort[i]) for i in (0, best)
        )
        pairs = [f"{first:.3g} → {last:.3g}" for first, last in zip(start, found, strict=True)]
        text = f"objective {pairs[0]}, lateral RMS {pairs[1]} mm, effort {pairs[2]} m/s"
        text += f" (iteration {curve.iteration[best]})"
    return Line2D(
        [],
        [],
        color=look[0],
        marker=look[1],
        markersize=4,
        label=f"{name}: {text}" if name else text,
    )


def _learning_keys() -> list:
    mark: dict[str, Any] = {"marker": "o", "markersize": 3.5, "color": "0.25", "linewidth": 0.9}
    return [
        Line2D([], [], label="held-out laps, certified", **mark),
        Line2D([], [], label="held-out laps, not certified", markerfacecolor="white", **mark),
        Line2D([], [], color="0.2", linewidth=0.8, linestyle=(0, (2, 1)), label="training laps"),
        Patch(
            color="0.35", alpha=0.3, linewidth=0, label="10 % to 90 % of the held-out laps' costs"
        ),
    ]


@styled
def tube_figure(
    before: Polytope | None, after: Polytope | None, half_widths: Float[np.ndarray, "3"]
) -> Figure:
    """Draw the minimal robust invariant sets' bounds before and after, projected, with the box of
    the caps.

    Args:
        before: errors (m, m, rad); None where no bounded tube exists.
        after: likewise.
        half_widths: caps of |e_x|, |e_y|, |e_theta| (m, m, rad).
    """
    tubes = [(tube, line) for tube, line in ((before, BEFORE), (after, AFTER)) if tube is not None]
    box = np.array(list(product((-1, 1), repeat=3))) * half_widths * IN_CENTIMETRES
    figure = page_figure(3.0)
    for axes, plane in zip(figure.subplots(1, 3), PLANES, strict=True):
        draw_polygon(
            axes,
            box[:, plane],
            edgecolor=LIMIT["color"],
            linestyle=LIMIT["linestyle"],
            linewidth=0.9,
        )
        for tube, line in tubes:
            corners = (tube.vertices() * IN_CENTIMETRES)[:, plane]
            draw_polygon(axes, corners, facecolor=(line.colour, 0.22), edgecolor="none")
            draw_polygon(axes, corners, edgecolor=line.colour, linestyle=line.dashes, linewidth=1.3)
        axes.set_xlabel(error_label(plane[0], unit=CENTIMETRES[plane[0]]))
        axes.set_ylabel(error_label(plane[1], unit=CENTIMETRES[plane[1]]), labelpad=0)
        axes.margins(0.06)
    named = [
        line._replace(label=f"{line.label}: {_reach_text(tube, half_widths)}")
        for tube, line in ((before, BEFORE), (after, AFTER))
    ]
    bottom_legend(
        figure, line_keys([*named, Line("caps", LIMIT["color"], LIMIT["linestyle"])]), columns=1
    )
    return figure


def _reach_text(tube: Polytope | None, half_widths: Float[np.ndarray, "3"]) -> str:
    """Say how far a tube reaches, and which share of the caps that is."""
    if tube is None:
        return "no bounded tube"
    reach = np.max(tube.support(np.stack([np.eye(3), -np.eye(3)])), axis=0)
    parts = [
        f"${letter}$ up to {value:.3g} {unit} ({100 * share:.0f} %)"
        for letter, value, unit, share in zip(
            ("|e_x|", "|e_y|", "|e_\\theta|"),
            reach * IN_CENTIMETRES,
            CENTIMETRES,
            reach / half_widths,
            strict=True,
        )
    ]
    return f"{', '.join(parts)} of the cap"


@styled
def error_figure(
    before: Float[np.ndarray, "times laps 3"],
    after: Float[np.ndarray, "times laps 3"],
    dt: float,
    settled: int,
) -> Figure:
    """Draw median and 5 % to 95 % band of the errors over the laps, whole and magnified once
    settled.

    Args:
        before: errors (m, m, rad) at all steps, the start included; any number of laps.
        after: likewise.
        dt: period, s.
        settled: step from which laps have settled.
    """
    figure = page_figure(5.0)
    panels = figure.subplots(3, 2, sharex="col")
    for coordinate, row in enumerate(panels):
        for axes, first in zip(row, (0, settled), strict=True):
            shown = [errors[first:, :, coordinate] for errors in (before, after)]
            small = coordinate < 2 and max(np.max(np.abs(values)) for values in shown) < 0.1
            scales, units = (
                (IN_MILLIMETRES, MILLIMETRES) if small else (IN_CENTIMETRES, CENTIMETRES)
            )
            for values, line in zip(shown, (BEFORE, AFTER), strict=True):
                time = (first + np.arange(len(values))) * dt
                _draw_band(axes, time, values * scales[coordinate], line)
            axes.set_ylabel(error_label(coordinate, unit=units[coordinate]))
            axes.margins(x=0)
        row[0].axvline(settled * dt, **REFERENCE)
        roots = [
            settled_rms(errors, settled)[coordinate] * IN_MILLIMETRES[coordinate]
            for errors in (before, after)
        ]
        row[1].set_title(
            f"RMS {roots[0]:.3g} → {roots[1]:.3g} {MILLIMETRES[coordinate]}", loc="right", pad=3
        )
    panels[0, 0].set_title("whole lap, settled from the dotted line on", loc="left", pad=3)
    panels[0, 1].set_title("settled", loc="left", pad=3)
    for axes in panels[-1]:
        axes.set_xlabel("time [s]")
    keys = [
        *line_keys((BEFORE, AFTER)),
        Patch(color="0.35", alpha=0.3, linewidth=0, label="5 % to 95 % of the laps"),
    ]
    bottom_legend(figure, keys)
    return figure


def settled_rms(errors: Float[np.ndarray, "times laps 3"], settled: int) -> Float[np.ndarray, "3"]:
    """Return the mean over the laps of each lap's RMS from a step on, (m, m, rad)."""
    return np.sqrt(np.mean(errors[settled:] ** 2, axis=0)).mean(axis=0)


def _draw_band(axes: Axes, time, values: Float[np.ndarray, "times laps"], line: Line) -> None:
    low, median, high = np.quantile(values, QUANTILES, axis=1)
    axes.fill_between(time, low, high, color=line.colour, alpha=0.3, linewidth=0)
    # Edges tell apart bands that lie on each other.
    axes.plot(time, np.stack([low, high], axis=1), color=line.colour, linewidth=0.4)
    axes.plot(time, median, color=line.colour, linestyle=line.dashes)
