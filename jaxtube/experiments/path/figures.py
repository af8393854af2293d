"""The figure of `path`: the rows of the file and the missions along them; their speeds, curvatures
and wheels."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from jaxtube.figures.style import (
    LIMIT,
    OUTSIDE,
    bottom_legend,
    line_key,
    mark_key,
    page_figure,
    styled,
)
from jaxtube.paths.deviation import find_positions
from jaxtube.paths.driving import Drive
from jaxtube.paths.missions import PathPlan
from jaxtube.paths.places import Note
from jaxtube.paths.timing import recorded_speeds
from jaxtube.recordings.path import RawPath

ROWS = {"color": "0.6", "marker": ".", "markersize": 3, "linewidth": 0.4}
CHANGED = {"marker": "|", "markersize": 6}
REFUSED = {"marker": "x", "markersize": 5}
COLOURS = ("#0072B2", "#009E73", "#CC79A7", "#E69F00")
RIGHT = "#0072B2"
LEFT = "#D55E00"
RECORDED = {"color": "0.6", "linewidth": 0.8}
POINTS_PER_PERIOD = 4
HEADROOM = 1.05
"""Of the axis of speeds above them."""

HIGHEST_CURVATURE = 1.5
"""Times the greatest curvature up to which is drawn; a wider limit is not shown."""


@styled
def plan_figure(raw: RawPath, plan: PathPlan, drive: Drive) -> Figure:
    """Draw a path and its missions; beside it speed, curvature and wheels over the way, missions
    one after the other."""
    figure = page_figure(4.6)
    grid = figure.add_gridspec(3, 2, width_ratios=[1.0, 1.15])
    plane = figure.add_subplot(grid[:, 0])
    panels = [figure.add_subplot(grid[row, 1]) for row in range(3)]
    _draw_plane(plane, raw, plan)
    _draw_profiles(panels, plan, drive)
    bottom_legend(figure, _make_keys(raw, plan), columns=4)
    return figure


def _make_keys(raw: RawPath, plan: PathPlan) -> list[Line2D]:
    """Return the legend's entries of what is drawn."""
    keys = [line_key("rows of the file", **ROWS)]
    if plan.missions:
        keys += [
            line_key("missions" if len(plan.missions) > 1 else "mission", color=COLOURS[0]),
            line_key("right wheel", color=RIGHT),
            line_key("left wheel", color=LEFT),
            line_key("limit", **LIMIT),
        ]
    if plan.missions and raw.time is not None:
        keys.append(line_key("recorded speed", **RECORDED))
    if any(note.place for note in plan.notes):
        keys.append(mark_key("cut or changed", "0.15", **CHANGED))
    if plan.refused:
        keys.append(mark_key("refused", OUTSIDE, **REFUSED))
    return keys


def _draw_plane(axes: Axes, raw: RawPath, plan: PathPlan) -> None:
    axes.plot(*raw.positions.T, **ROWS)
    for number, mission in enumerate(plan.missions):
        reference = mission.reference
        times = np.linspace(
            0.0, reference.dt * reference.steps, POINTS_PER_PERIOD * reference.steps + 1
        )
        x, y = find_positions(reference, times).T
        colour = COLOURS[number % len(COLOURS)]
        axes.plot(x, y, color=colour, linewidth=1.2)
        axes.annotate(
            str(number + 1), (x[0], y[0]), xytext=(3, 3), textcoords="offset points", color=colour
        )
    _mark(axes, raw, plan.notes, color="0.15", **CHANGED)
    for refused in plan.refused:
        axes.plot(*refused.piece.raw.positions.T, color=OUTSIDE, linewidth=0.8)
    _mark(axes, raw, [refused.note for refused in plan.refused], color=OUTSIDE, **REFUSED)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel(_label("x", raw.origin[0]))
    axes.set_ylabel(_label("y", raw.origin[1]), labelpad=1)


def _mark(axes: Axes, raw: RawPath, notes: list[Note], **look) -> None:
    """Mark the places of notes."""
    for note in notes:
        if note.place is not None:
            axes.plot(note.place.x - raw.origin[0], note.place.y - raw.origin[1], **look)


def _label(axis: str, origin: float) -> str:
    return f"{axis} \N{MINUS SIGN} {origin:.0f} m [m]" if origin else f"{axis} [m]"


def _draw_profiles(panels: list[Axes], plan: PathPlan, drive: Drive) -> None:
    """Draw speed, curvature and wheel speeds over the way."""
    speed, curvature, wheels = panels
    way = 0.0
    greatest = 0.0
    for mission in plan.missions:
        curve = mission.fit.curve
        reference = mission.reference
        lengths = np.linspace(0.0, curve.length, 1000)
        if mission.piece.raw.time is not None:
            recorded = recorded_speeds(curve, mission.fit.rows, mission.piece.raw.time, lengths)
            speed.plot(way + lengths, recorded, **RECORDED)
        bends = curve.at(lengths).curvature
        greatest = max(greatest, float(np.abs(bends).max()))
        curvature.plot(way + lengths, bends, color="0.15", linewidth=0.9)
        held = reference.wheels[: reference.steps]
        edges = way + np.append(0.0, np.cumsum(reference.dt * held.mean(axis=1)))
        speed.stairs(held.mean(axis=1), edges, baseline=None, color=COLOURS[0])
        wheels.stairs(held[:, 0], edges, baseline=None, color=RIGHT)
        wheels.stairs(held[:, 1], edges, baseline=None, color=LEFT)
        way += curve.length
        for axes in panels:
            axes.axvline(way, color="0.8", linewidth=0.6)
    for limit in (drive.limits.least, drive.limits.greatest):
        wheels.axhline(limit, **LIMIT)
    sharpest = drive.limits.sharpest_curvature
    if sharpest < HIGHEST_CURVATURE * greatest:
        curvature.axhline(sharpest, **LIMIT)
        curvature.axhline(-sharpest, **LIMIT)
    speed.set_ylabel("speed [m/s]")
    speed.set_ylim(0.0, HEADROOM * speed.get_ylim()[1])
    curvature.set_ylabel("curvature [1/m]")
    wheels.set_ylabel("wheels [m/s]")
    many = ", missions one after the other" if len(plan.missions) > 1 else ""
    wheels.set_xlabel(f"way{many} [m]")
    for axes in panels[:-1]:
        axes.sharex(wheels)
        axes.tick_params(labelbottom=False)
