"""Figures of an identification: slips over time and against speed, and ground speeds of wheels.

Filled marks are the windows whose extremes make the box, hollow ones those that track and lever arm
were fitted to. Windows that drive otherwise are left out: their slips are no part of it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxtube.figures.style import (
    LIMIT,
    area_key,
    bottom_legend,
    line_key,
    mark_key,
    page_figure,
    styled,
)
from jaxtube.identification.findings import Findings
from jaxtube.identification.identify import Identified

RIGHT = "#0072B2"
LEFT = "#E69F00"
SIDE = "#009E73"
CUT = "#CC79A7"
SIDES = (("right wheel", RIGHT, "o"), ("left wheel", LEFT, "s"))
SIZE = 3.2

SHOWN_WHEELS = 4000
"""Samples of the wheels that a page can show."""


def mark_windows(
    axes: Axes,
    identified: Identified,
    x: Float[np.ndarray, "k"],
    y: Float[np.ndarray, "k"],
    colour: str,
    marker: str = "o",
) -> None:
    """Draw the windows that count, filled, and those that fit, hollow."""
    for used, filled in ((identified.fits, False), (identified.counts, True)):
        axes.plot(x[used], y[used], **_look(colour, marker, filled))


def _look(colour: str, marker: str, filled: bool) -> dict[str, Any]:
    return {
        "linestyle": "none",
        "marker": marker,
        "markersize": SIZE,
        "markeredgecolor": colour,
        "markeredgewidth": 0.7,
        "markerfacecolor": colour if filled else "white",
    }


def mark_keys() -> list:
    """Return the legend's entries of marks."""
    wheels = [mark_key(name, colour, marker=marker) for name, colour, marker in SIDES]
    fitted = mark_key("fits the track", "0.35", markerfacecolor="white", markeredgewidth=0.7)
    return [*wheels, mark_key("makes the box", "0.35"), fitted, line_key("box", **LIMIT)]


def draw_interval(axes: Axes, interval: tuple[float, float]) -> None:
    """Draw the ends of an interval of slip, in per cent."""
    for end in interval:
        axes.axhline(100 * end, **LIMIT)


@styled
def over_time(identified: Identified, findings: Findings | None) -> Figure:
    """Draw wheel speeds, slips and sideslip over time, cuts shaded; windows of a table by their
    number."""
    figure = page_figure(5.2)
    speeds, right, left, side = figure.subplots(
        4, 1, sharex=True, gridspec_kw={"height_ratios": (1.2, 1, 1, 0.8)}
    )
    if findings is None:
        x = np.arange(len(identified.windows.command), dtype=float)
        _draw_window_speeds(speeds, identified, x)
        side.set_xlabel("number of the window")
    else:
        x = findings.windows.start + findings.windows.length / 2.0
        draw_wheels(speeds, findings)
        for axes in (speeds, right, left, side):
            _shade_cuts(axes, findings)
        side.set_xlabel("time [s]")
    box = identified.widened_box
    for axes, column, interval in ((right, 0, box.right), (left, 1, box.left)):
        name, colour, marker = SIDES[column]
        mark_windows(axes, identified, x, 100 * identified.slips[:, column], colour, marker)
        draw_interval(axes, interval)
        axes.set_ylabel(f"slip, {name.split()[0]} [%]")
    mark_windows(side, identified, x, 100 * identified.sideslips, SIDE, "^")
    draw_interval(side, (-box.sideslip, box.sideslip))
    side.set_ylabel("sideslip [%]")
    speeds.set_ylabel("wheel speed [m/s]")
    figure.align_ylabels()
    keys = [*mark_keys(), mark_key("sideslip", SIDE, marker="^")]
    if findings is not None and findings.cuts.cuts:
        keys.append(area_key("pose not trusted", CUT, alpha=0.35))
    bottom_legend(figure, keys, columns=4)
    return figure


def draw_wheels(axes: Axes, findings: Findings, shift: float = 0.0) -> None:
    """Draw the wheel speeds of a log over time, so many seconds later than their own clock says."""
    log = findings.log
    time = log.time + shift
    every = max(1, len(log.time) // SHOWN_WHEELS)
    for column, (_, colour, _) in enumerate(SIDES):
        axes.plot(time[::every], log.wheels[::every, column], color=colour, linewidth=0.6)


def _draw_window_speeds(axes: Axes, identified: Identified, x: Float[np.ndarray, "k"]) -> None:
    for column, (_, colour, _) in enumerate(SIDES):
        wheels = identified.windows.wheels[:, column]
        axes.plot(x, wheels, color=colour, linewidth=0.6, drawstyle="steps-mid")


def _shade_cuts(axes: Axes, findings: Findings) -> None:
    """Shade where the pose is not trusted, on the clock of the wheels."""
    offset = findings.clock.offset
    for cut in findings.cuts.cuts:
        axes.axvspan(
            cut.start - offset, cut.end - offset, color=CUT, alpha=0.35, linewidth=0.4, zorder=0
        )


@styled
def by_speed(identified: Identified) -> Figure:
    """Draw the slips of each wheel against its speed and against the yaw rate."""
    figure = page_figure(4.6)
    panels = figure.subplots(2, 2, sharex="col", sharey="row")
    windows = identified.windows
    box = identified.widened_box
    yaw_rate = windows.velocity[:, 1]
    for row, interval in enumerate((box.right, box.left)):
        name, colour, marker = SIDES[row]
        slips = 100 * identified.slips[:, row]
        for axes, x in zip(panels[row], (windows.wheels[:, row], yaw_rate), strict=True):
            mark_windows(axes, identified, x, slips, colour, marker)
            draw_interval(axes, interval)
        panels[row, 0].set_ylabel(f"slip, {name} [%]")
    panels[1, 0].set_xlabel("speed of the wheel [m/s]")
    panels[1, 1].set_xlabel("yaw rate, left positive [rad/s]")
    bottom_legend(figure, mark_keys(), columns=5)
    return figure


@styled
def ground_by_wheel(identified: Identified) -> Figure:
    """Draw the ground speed of each wheel against its own speed, with the cone of its slips."""
    figure = page_figure(3.4)
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    windows = identified.windows
    box = identified.widened_box
    fastest = 1.05 * identified.fastest_wheel
    ends = np.array([0.0, fastest])
    for column, (axes, interval) in enumerate(zip(panels, (box.right, box.left), strict=True)):
        name, colour, marker = SIDES[column]
        least, greatest = interval
        axes.fill_between(
            ends, ends * (1 - greatest), ends * (1 - least), color=colour, alpha=0.18, linewidth=0
        )
        axes.plot(ends, ends, color="0.5", linewidth=0.8)
        wheels = windows.wheels[:, column]
        slips = np.where(identified.fits | identified.counts, identified.slips[:, column], np.nan)
        ground = wheels * (1.0 - slips)
        mark_windows(axes, identified, wheels, ground, colour, marker)
        axes.axvline(identified.least_wheel, **LIMIT)
        axes.set(title=name, xlabel="speed of the wheel [m/s]", xlim=(0, fastest))
    panels[0].set_ylabel("speed over ground [m/s]")
    keys = [
        mark_key("makes the box", "0.35"),
        mark_key("fits the track", "0.35", markerfacecolor="white", markeredgewidth=0.7),
        area_key("slips of the box", "0.35", alpha=0.18),
        line_key("no slip", color="0.5", linewidth=0.8),
        line_key("slowest wheel promised for", **LIMIT),
    ]
    bottom_legend(figure, keys, columns=5)
    return figure
