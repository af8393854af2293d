"""Figures of what tuning came to: the tube and the errors before and after.

What was before is grey, what comes after is drawn in a strong colour.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxtube.coordinates import COORDINATES, PLANES
from jaxtube.figures.style import (
    CENTIMETRES,
    LIMIT,
    LIMIT_EDGE,
    MILLIMETRES,
    REFERENCE,
    Line,
    area_key,
    bottom_legend,
    draw_line,
    draw_polygon,
    error_label,
    label_plane,
    line_keys,
    page_figure,
    styled,
)
from sets.polytope import Polytope

BEFORE = Line("before tuning", "0.5", (0, (4, 1.2)))
AFTER = Line("after tuning", "#0072B2")
CAPS = Line("caps", LIMIT["color"], LIMIT["linestyle"])
QUANTILES = (0.05, 0.5, 0.95)
SMALL_M = 0.1
"""Errors below this are shown in millimetres."""


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
    tubes = ((before, BEFORE), (after, AFTER))
    box = Polytope.box(-half_widths, half_widths).vertices() * CENTIMETRES.factors
    figure = page_figure(3.0)
    for axes, plane in zip(figure.subplots(1, 3), PLANES, strict=True):
        draw_polygon(axes, box[:, plane], **LIMIT_EDGE)
        for tube, line in tubes:
            if tube is not None:
                _draw_tube(axes, tube.vertices()[:, plane] * CENTIMETRES.factors[[*plane]], line)
        label_plane(axes, plane, CENTIMETRES)
        axes.margins(0.06)
    named = [
        line._replace(label=f"{line.label}: {_reach_text(tube, half_widths)}")
        for tube, line in tubes
    ]
    bottom_legend(figure, line_keys([*named, CAPS]), columns=1)
    return figure


def _draw_tube(axes: Axes, corners: Float[np.ndarray, "v 2"], line: Line) -> None:
    draw_polygon(axes, corners, facecolor=(line.colour, 0.22), edgecolor="none")
    look = {"edgecolor": line.colour, "linestyle": line.dashes, "linewidth": 1.3}
    draw_polygon(axes, corners, **look)


def _reach_text(tube: Polytope | None, half_widths: Float[np.ndarray, "3"]) -> str:
    """Say how far a tube reaches, and which share of the caps that is."""
    if tube is None:
        return "no bounded tube"
    reach = np.max(tube.support(np.stack([np.eye(3), -np.eye(3)])), axis=0)
    sizes = reach * CENTIMETRES.factors
    shares = 100 * reach / half_widths
    parts = [
        f"$|{coordinate.error}|$ up to {sizes[i]:.3g} {CENTIMETRES.units[i]} ({shares[i]:.0f} %)"
        for i, coordinate in enumerate(COORDINATES)
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
            _draw_errors(axes, before, after, dt, first, coordinate)
        row[0].axvline(settled * dt, **REFERENCE)
        roots = [
            settled_rms(errors, settled)[coordinate] * MILLIMETRES.factors[coordinate]
            for errors in (before, after)
        ]
        unit = MILLIMETRES.units[coordinate]
        row[1].set_title(f"RMS {roots[0]:.3g} → {roots[1]:.3g} {unit}", loc="right", pad=3)
    panels[0, 0].set_title("whole lap, settled from the dotted line on", loc="left", pad=3)
    panels[0, 1].set_title("settled", loc="left", pad=3)
    for axes in panels[-1]:
        axes.set_xlabel("time [s]")
    band = area_key("5 % to 95 % of the laps", "0.35", alpha=0.3)
    bottom_legend(figure, [*line_keys((BEFORE, AFTER)), band])
    return figure


def _draw_errors(axes: Axes, before, after, dt: float, first: int, coordinate: int) -> None:
    """Draw both bands of an error from a step on, in units that fit."""
    shown = [errors[first:, :, coordinate] for errors in (before, after)]
    largest = max(np.max(np.abs(values)) for values in shown)
    scale = MILLIMETRES if coordinate < 2 and largest < SMALL_M else CENTIMETRES
    for values, line in zip(shown, (BEFORE, AFTER), strict=True):
        time = (first + np.arange(len(values))) * dt
        _draw_band(axes, time, values * scale.factors[coordinate], line)
    axes.set_ylabel(error_label(coordinate, scale))
    axes.margins(x=0)


def settled_rms(errors: Float[np.ndarray, "times laps 3"], settled: int) -> Float[np.ndarray, "3"]:
    """Return the mean over the laps of each lap's RMS from a step on, (m, m, rad)."""
    return np.sqrt(np.mean(errors[settled:] ** 2, axis=0)).mean(axis=0)


def _draw_band(axes: Axes, time, values: Float[np.ndarray, "times laps"], line: Line) -> None:
    low, median, high = np.quantile(values, QUANTILES, axis=1)
    axes.fill_between(time, low, high, color=line.colour, alpha=0.3, linewidth=0)
    # Edges tell apart bands that lie on each other.
    axes.plot(time, np.stack([low, high], axis=1), color=line.colour, linewidth=0.4)
    draw_line(axes, time, median, line)
