"""Closed-loop figures over time: errors, wheel speeds and margins to E, over many realisations.

Every function takes runs by controller's name: anything with `errors` (steps+1, batch, 3) in
(m, m, rad) and `wheels` (steps, batch, 2) in m/s.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from jaxtube.coordinates import COORDINATES, TO_DISPLAY
from jaxtube.figures.curves import (
    BAND_KEYS,
    Curve,
    draw_band,
    label_in_lines,
    leaves_error_set,
    make_curves,
)
from jaxtube.figures.style import (
    LIMIT,
    REFERENCE,
    area_key,
    bottom_legend,
    error_label,
    line_key,
    line_keys,
    page_figure,
    styled,
)
from jaxtube.plant.reference import TRANSIENT_S
from jaxtube.synthesis.problem import Problem

FIRST_SECONDS = 3.0
"""What the magnified start of a run shows."""

WHEELS = ("right wheel", "left wheel")
BOX_WIDTH = 0.26
BOX_OFFSET = 0.17
"""Of the boxes of a controller: width, and distance from the middle of its row."""


@styled
def errors(problem: Problem, runs: Mapping[str, Any]) -> Figure:
    """Draw the tracking errors against time: all of them with the limits of E, and those that stay
    inside magnified.

    Args:
        problem: gives the limits and the period.
        runs: by controller's name.
    """
    curves = make_curves(runs)
    shares = {name: _share_outside(problem, curve) for name, curve in curves.items()}
    inside = {name: curve for name, curve in curves.items() if not shares[name]}
    columns = [curves]
    if 0 < len(inside) < len(curves):
        columns.append(inside)
    figure = page_figure(5.6)
    panels = figure.subplots(3, len(columns), sharex=True, squeeze=False)
    for coordinate, row in enumerate(panels):
        for axes, shown in zip(row, columns, strict=True):
            _draw_errors(axes, problem, shown, coordinate)
        limit = problem.error_set.offsets[coordinate] * TO_DISPLAY[coordinate]
        row[0].axhline(-limit, **LIMIT)
        row[0].axhline(limit, **LIMIT)
        row[0].set_ylabel(error_label(coordinate))
    titles = ("all controllers", "those that stay in $\\mathcal{E}$, magnified")
    for axes, title in zip(panels[0], titles, strict=False):
        axes.set_title(title)
    for axes in panels[-1]:
        axes.set_xlabel("time [s]")
    limits_key = line_key("limits of $\\mathcal{E}$", **LIMIT)
    bottom_legend(figure, [*_share_keys(curves, shares), limits_key, *BAND_KEYS])
    return figure


def _share_outside(problem: Problem, curve: Curve) -> float:
    return float(leaves_error_set(problem, curve.errors).mean())


def _draw_errors(
    axes: Axes, problem: Problem, curves: Mapping[str, Curve], coordinate: int
) -> None:
    for curve in curves.values():
        values = curve.errors[..., coordinate] * TO_DISPLAY[coordinate]
        time = np.arange(len(values)) * problem.reference.dt
        draw_band(axes, time, values, curve.line)
    axes.margins(x=0)


def _share_keys(curves: Mapping[str, Curve], shares: Mapping[str, float]) -> list:
    """Return the legend's entries of the curves, with the share of runs that leave E."""
    keys = line_keys(curve.line for curve in curves.values())
    for key, share in zip(keys, shares.values(), strict=True):
        if share:
            key.set_label(f"{key.get_label()} ({100 * share:.0f} % leave $\\mathcal{{E}}$)")
    return keys


@styled
def wheel_speeds(problem: Problem, runs: Mapping[str, Any]) -> Figure:
    """Draw the wheel speeds against time, the whole run and its start, with those of the reference.

    Args:
        problem: gives the reference, the wheel limits and the period.
        runs: by controller's name.
    """
    curves = make_curves(runs)
    whole = problem.reference.steps * problem.reference.dt
    figure = page_figure(4.2)
    panels = figure.subplots(2, 2, sharex="col", sharey=True, width_ratios=(1.7, 1))
    for wheel, row in enumerate(panels):
        for axes, end in zip(row, (whole, FIRST_SECONDS), strict=True):
            _draw_wheel(axes, problem, curves, wheel, end)
        row[0].set_ylabel(f"{WHEELS[wheel]} [m/s]")
    _draw_wheel_limits(problem, panels)
    panels[0, 0].set_title("whole run")
    panels[0, 1].set_title(f"first {FIRST_SECONDS:.0f} s")
    for axes in panels[1]:
        axes.set_xlabel("time [s]")
    reference_key = line_key("Reference", **REFERENCE)
    keys = line_keys(curve.line for curve in curves.values())
    bottom_legend(figure, [*keys, reference_key, *BAND_KEYS])
    return figure


def _draw_wheel(
    axes: Axes, problem: Problem, curves: Mapping[str, Curve], wheel: int, end: float
) -> None:
    """Draw the speeds of one wheel from 0 to a time, s."""
    steps = problem.reference.steps
    time = np.arange(steps) * problem.reference.dt
    shown = time <= end
    for curve in curves.values():
        draw_band(axes, time[shown], curve.wheels[shown, :, wheel], curve.line)
    scheduled = problem.schedule[:steps, wheel]
    axes.step(time[shown], scheduled[shown], where="post", **REFERENCE)
    axes.set_xlim(0, end)


def _draw_wheel_limits(problem: Problem, panels) -> None:
    """Draw the wheel limits that the curves come near, leaving the range of the axes as it is."""
    low, high = panels[0, 0].get_ylim()
    for limit in (problem.robot.wheel_speed_min, problem.robot.wheel_speed_max):
        if not low <= limit <= high:
            continue
        for axes in panels.flat:
            axes.axhline(limit, **LIMIT)


@styled
def margins(problem: Problem, runs: Mapping[str, Any]) -> Figure:
    """Draw how near each run came to the limits of E: the distribution of 1 - max |e| / limit over
    realisations.

    Args:
        problem: gives the limits and the period.
        runs: by controller's name.
    """
    curves = make_curves(runs)
    figure = page_figure(0.9 + 0.42 * len(curves))
    panels = figure.subplots(1, 3, sharey=True)
    for coordinate, axes in enumerate(panels):
        _draw_margins(axes, problem, curves, coordinate)
    names = [label_in_lines(curve.line) for curve in curves.values()]
    panels[0].set_yticks(range(len(curves)), names)
    panels[0].invert_yaxis()
    keys = [
        Patch(facecolor="0.4", edgecolor="0.4", label="whole run"),
        Patch(facecolor="white", edgecolor="0.4", label=f"after the first {TRANSIENT_S:.0f} s"),
        area_key("outside $\\mathcal{E}$", "0.5", alpha=0.15),
        line_key("margin of the start", **REFERENCE),
    ]
    bottom_legend(figure, keys, columns=4)
    return figure


def _draw_margins(
    axes: Axes, problem: Problem, curves: Mapping[str, Curve], coordinate: int
) -> None:
    """Draw the margins in one coordinate, a row a controller."""
    limit = problem.error_set.offsets[coordinate]
    settled = round(TRANSIENT_S / problem.reference.dt)
    for row, curve in enumerate(curves.values()):
        margin = 100 * (1 - np.abs(curve.errors[..., coordinate]) / limit)
        colour = curve.line.colour
        _draw_box(axes, margin.min(axis=0), row - BOX_OFFSET, colour, filled=True)
        if settled < len(margin):
            least = margin[settled:].min(axis=0)
            _draw_box(axes, least, row + BOX_OFFSET, colour, filled=False)
    start = 100 * (1 - np.abs(problem.initial_error[coordinate]) / limit)
    axes.axvline(0, **LIMIT)
    axes.axvline(start, **REFERENCE)
    axes.set_xlim(right=104)
    axes.axvspan(min(axes.get_xlim()[0], -5), 0, color="0.5", alpha=0.15, linewidth=0)
    axes.margins(x=0)
    axes.set_xlabel(f"margin in ${COORDINATES[coordinate].error}$ [%]")


def _draw_box(
    axes: Axes, values: Float[np.ndarray, " runs"], place: float, colour: str, filled: bool
) -> None:
    """Draw quartiles as a box, the median as a bar and the extremes as whiskers; runs that are NaN
    are left out."""
    face = colour if filled else "white"
    axes.boxplot(
        values[~np.isnan(values)],
        positions=[place],
        orientation="horizontal",
        widths=BOX_WIDTH,
        whis=(0, 100),
        patch_artist=True,
        manage_ticks=False,
        boxprops={"facecolor": face, "edgecolor": colour, "linewidth": 0.9},
        medianprops={"color": "black", "linewidth": 1.2},
        whiskerprops={"color": colour},
        capprops={"color": colour},
    )
