"""Figures of a replay: w over time with all that it may be, histograms, slips of windows."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxtube.experiments.identify.figures import CUT, SIDE, SIDES, SIZE, draw_interval, draw_wheels
from jaxtube.figures.style import (
    INSIDE,
    LIMIT,
    MILLIMETRES,
    OUTSIDE,
    area_key,
    bottom_legend,
    disturbance_label,
    line_key,
    mark_key,
    page_figure,
    styled,
)
from jaxtube.witness.examine import Witness
from jaxtube.witness.span_test import SpanTest

REACH = "#56B4E9"
PART = {"color": "0.45", "linewidth": 0.9, "linestyle": (0, (1, 1.2))}
CHANGING = "#E69F00"
BINS = 40
HIGHEST_USAGE = 2.0
"""Of the histogram; what lies beyond stands in its last bin."""


@styled
def over_time(witness: Witness, test: SpanTest) -> Figure:
    """Draw wheel speeds and w over time, with whatever w may be; cuts are shaded."""
    figure = page_figure(5.6)
    ratios = {"height_ratios": (0.8, 1, 1, 1)}
    speeds, *panels = figure.subplots(4, 1, sharex=True, gridspec_kw=ratios)
    # Spans and cuts are on the clock of the poses.
    draw_wheels(speeds, witness.findings, witness.findings.clock.offset)
    speeds.set_ylabel("wheel speed [m/s]")
    middle = (test.spans.start + test.spans.end) / 2.0
    for axis, axes in enumerate(panels):
        _draw_coordinate(axes, test, middle, axis)
        _draw_set(axes, witness, test, axis)
    for axes in (speeds, *panels):
        for cut in witness.findings.cuts.cuts:
            axes.axvspan(cut.start, cut.end, color=CUT, alpha=0.35, linewidth=0.4, zorder=0)
    panels[-1].set_xlabel("time [s]")
    figure.align_ylabels()
    keys = [
        *[line_key(name, color=colour) for name, colour, _ in SIDES],
        area_key("all that $w$ may be", REACH, 0.5),
        mark_key("explained", INSIDE, markersize=SIZE),
        mark_key("not explained", OUTSIDE, marker="x", markersize=SIZE),
    ]
    if _is_compared(witness, test):
        keys.append(line_key(r"$\mathcal{W}$", **LIMIT))
    if witness.findings.cuts.cuts:
        keys.append(area_key("pose not trusted", CUT, 0.35))
    bottom_legend(figure, keys, columns=4)
    return figure


def _draw_coordinate(axes: Axes, test: SpanTest, middle: Float[np.ndarray, "k"], axis: int) -> None:
    """Draw one coordinate of w, and whatever it may be."""
    factor = MILLIMETRES.factors[axis]
    reach = test.reach
    low = factor * (reach.centre - reach.half_widths)[:, axis]
    high = factor * (reach.centre + reach.half_widths)[:, axis]
    edges = np.column_stack([test.spans.start, test.spans.end, test.spans.end]).ravel()
    axes.fill_between(edges, _hold(low), _hold(high), color=REACH, alpha=0.5, linewidth=0)
    w = factor * test.measured[:, axis]
    explained = test.verdict.explained
    _draw_marks(axes, middle[explained], w[explained], INSIDE, "o", 1.6)
    _draw_marks(axes, middle[~explained], w[~explained], OUTSIDE, "x", 2.4)
    axes.axhline(0.0, color="0.7", linewidth=0.5, zorder=0)
    axes.set_ylabel(disturbance_label(axis))


def _hold(values: Float[np.ndarray, "k"]) -> Float[np.ndarray, "3k"]:
    """Return values that hold from the start to the end of a span, NaN after each."""
    return np.column_stack([values, values, np.full(len(values), np.nan)]).ravel()


def _draw_marks(axes: Axes, x, y, colour: str, marker: str, size: float) -> None:
    look = {"linestyle": "none", "markeredgewidth": 0.6}
    axes.plot(x, y, color=colour, marker=marker, markersize=size, **look)


def _is_compared(witness: Witness, test: SpanTest) -> bool:
    """Tell whether W is of spans as long as those of a test."""
    return test is witness.period and not isinstance(witness.sets, str)


def _draw_set(axes: Axes, witness: Witness, test: SpanTest, axis: int) -> None:
    """Draw the half width of W."""
    if isinstance(witness.sets, str) or not _is_compared(witness, test):
        return
    half = float(witness.sets.whole.support(np.eye(3))[axis]) * MILLIMETRES.factors[axis]
    for end in (-half, half):
        axes.axhline(end, **LIMIT)


@styled
def histograms(witness: Witness) -> Figure:
    """Draw how often which usage occurs, and w of a period by coordinate beside W and its part."""
    figure = page_figure(4.6)
    panels = figure.subplots(2, 2)
    _draw_usages(panels[0, 0], witness)
    for axis, axes in enumerate(panels.flat[1:]):
        _draw_histogram(axes, witness, axis)
    for axes in panels[:, 0]:
        axes.set_ylabel("spans")
    keys = [
        area_key("steady", INSIDE, 0.7),
        area_key("changing", CHANGING, 0.7),
        line_key("the limit", color=OUTSIDE, linewidth=1.0),
    ]
    if witness.longer is not None:
        duration = np.median(witness.longer.spans.duration)
        keys.append(line_key(f"both, spans of {duration:.2g} s", color="0.15", linewidth=1.0))
    if not isinstance(witness.sets, str):
        keys.append(line_key(r"$\mathcal{W}$", **LIMIT))
        keys.append(line_key(r"slip, sideslip and noise of $\mathcal{W}$", **PART))
    bottom_legend(figure, keys, columns=3)
    return figure


def _draw_usages(axes: Axes, witness: Witness) -> None:
    bins = np.linspace(0.0, HIGHEST_USAGE, BINS + 1).tolist()
    usages = [
        np.minimum(witness.period.verdict.usage[rows], HIGHEST_USAGE - 1e-9)
        for rows in _split(witness.period)
    ]
    axes.hist(usages, bins=bins, stacked=True, color=(INSIDE, CHANGING), alpha=0.7)
    if witness.longer is not None:
        usage = np.minimum(witness.longer.verdict.usage, HIGHEST_USAGE - 1e-9)
        axes.hist(usage, bins=bins, histtype="step", color="0.15")
    axes.axvline(1.0, color=OUTSIDE, linewidth=1.0)
    xlabel = f"usage of all that is allowed, the last bin from {bins[-2]:.3g} on"
    axes.set(xlabel=xlabel, yscale="log")


def _split(test: SpanTest) -> tuple[Bool[np.ndarray, "k"], Bool[np.ndarray, "k"]]:
    return test.spans.is_kind("steady"), test.spans.is_kind("changing")


def _draw_histogram(axes: Axes, witness: Witness, axis: int) -> None:
    factor = MILLIMETRES.factors[axis]
    w = factor * witness.period.measured[:, axis]
    shown = [w[rows] for rows in _split(witness.period)]
    axes.hist(shown, bins=BINS, stacked=True, color=(INSIDE, CHANGING), alpha=0.7)
    axes.set(xlabel=disturbance_label(axis), yscale="log")
    if isinstance(witness.sets, str):
        return
    for polytope, look in ((witness.sets.whole, LIMIT), (witness.sets.part, PART)):
        half = factor * float(polytope.support(np.eye(3))[axis])
        axes.axvline(-half, **look)
        axes.axvline(half, **look)


@styled
def window_slips(witness: Witness) -> Figure:
    """Draw slips and sideslip of windows over time beside the intervals of the scenario."""
    figure = page_figure(4.4)
    panels = figure.subplots(3, 1, sharex=True)
    windows = witness.windows
    values = 100 * np.column_stack([windows.slips, windows.sideslips])
    box = windows.box
    intervals = (box.right, box.left, (-box.sideslip, box.sideslip))
    names = ("slip, right [%]", "slip, left [%]", "sideslip [%]")
    x = windows.start + windows.length / 2.0
    colours = (SIDES[0][1], SIDES[1][1], SIDE)
    for column, axes in enumerate(panels):
        off = _is_off(values[:, column], intervals[column])
        for rows, colour in ((~off, colours[column]), (off, OUTSIDE)):
            _draw_windows(axes, x, values[:, column], windows.steady & rows, colour, True)
            _draw_windows(axes, x, values[:, column], ~windows.steady & rows, colour, False)
        draw_interval(axes, intervals[column])
        axes.set_ylabel(names[column])
    panels[-1].set_xlabel("time [s]")
    figure.align_ylabels()
    keys = [
        mark_key("steady window", "0.35", markersize=SIZE),
        mark_key("changing window", "0.35", markersize=SIZE, markerfacecolor="white"),
        mark_key("outside", OUTSIDE, markersize=SIZE),
        line_key("what the scenario allows", **LIMIT),
    ]
    bottom_legend(figure, keys, columns=4)
    return figure


def _is_off(values: Float[np.ndarray, "k"], interval: tuple[float, float]) -> Bool[np.ndarray, "k"]:
    low, high = interval
    return ~((values >= 100 * low) & (values <= 100 * high))


def _draw_windows(axes: Axes, x, y, rows: Bool[np.ndarray, "k"], colour: str, filled: bool) -> None:
    axes.plot(
        x[rows],
        y[rows],
        linestyle="none",
        marker="o",
        markersize=SIZE,
        markeredgecolor=colour,
        markeredgewidth=0.7,
        markerfacecolor=colour if filled else "white",
    )
