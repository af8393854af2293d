"""The figure of what tuning is compared with: a grid of weights and its front, and other designs.

The front holds the designs that no other beats in both lateral error and effort (Pareto).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, NullLocator

from jaxtube.experiments.tune.figures import AFTER
from jaxtube.experiments.tune.place_names import GAPS, place_names
from jaxtube.figures.style import (
    LABEL_SIZE,
    LIMIT,
    bottom_legend,
    line_key,
    mark_key,
    page_figure,
    styled,
)
from jaxtube.figures.ticks import plain_ticks, spans_decade

Kind = Literal["grid", "front", "search", "start", "tuned"]
LOOKS: dict[Kind, dict[str, Any]] = {
    "grid": {"color": "0.6", "marker": "o", "markersize": 2.6, "markeredgewidth": 0.6, "zorder": 2},
    "front": {"color": "#E69F00", "marker": "s", "markersize": 4, "zorder": 3},
    "search": {"color": "#009E73", "marker": "^", "markersize": 6, "zorder": 4},
    "start": {"color": "#D55E00", "marker": "X", "markersize": 7, "zorder": 4},
    "tuned": {"color": AFTER.colour, "marker": "*", "markersize": 11, "zorder": 5},
}
LABELLED = ("search", "start", "tuned")
"""Kinds of few designs, whose names stand beside their marks."""


class Group(NamedTuple):
    """Designs that are drawn alike, one an entry."""

    name: str
    lateral: Float[np.ndarray, " designs"]  # RMS of e_y once settled, m
    effort: Float[np.ndarray, " designs"]  # RMS, m/s
    tube: Float[np.ndarray, " designs"]
    """Lateral half width of the minimal robust invariant set, m; NaN: unbounded."""
    certified: Bool[np.ndarray, " designs"]
    kind: Kind


@styled
def front_figure(groups: Sequence[Group], effort_limit: float | None) -> Figure:
    """Draw lateral errors against effort and, at the same heights, against the size of the tube.

    Args:
        groups: designs; those of kind "front" are joined by a line in the order of their effort.
        effort_limit: of the RMS, m/s.
    """
    figure = page_figure(4.0)
    effort, tube = figure.subplots(1, 2, sharey=True)
    widths = 1e2 * np.concatenate([group.tube for group in groups])
    unbounded = _place_of_unbounded(widths)
    for group in groups:
        if group.kind == "front":
            _draw_front(effort, group)
        _draw_group(effort, group, group.effort)
        sizes = np.where(np.isfinite(group.tube), 1e2 * group.tube, unbounded)
        _draw_group(tube, group, sizes)
    effort.set(xlabel="RMS of effort [m/s]", yscale="log")
    effort.set_ylabel("RMS of $e_y$ once settled [mm]")
    tube.set_xlabel("lateral half width of the minimal invariant set [cm]")
    effort.set_title("error and effort", loc="left")
    tube.set_title("error and tube", loc="left")
    plain_ticks(effort.yaxis)
    if spans_decade(widths):
        tube.set_xscale("log")
        plain_ticks(tube.xaxis)
    if not np.isfinite(widths).all():
        _draw_strip(tube, widths, unbounded)
    if effort_limit is not None:
        effort.axvline(effort_limit, **LIMIT)
    bottom_legend(figure, _keys(groups, effort_limit is not None), columns=4)
    figure.draw_without_rendering()
    place_names(figure, effort)
    place_names(figure, tube)
    return figure


def _draw_front(axes: Axes, group: Group) -> None:
    """Join the designs of a front by a line."""
    order = np.argsort(group.effort)
    look = LOOKS["front"]
    lateral = 1e3 * group.lateral[order]
    axes.plot(
        group.effort[order], lateral, color=look["color"], linewidth=1.0, zorder=look["zorder"]
    )


def _place_of_unbounded(widths: Float[np.ndarray, " n"]) -> float:
    """Return the abscissa of designs without a bounded tube, right of all others."""
    finite = widths[np.isfinite(widths)]
    if not finite.size:
        return 1.0
    greatest = finite.max()
    if spans_decade(widths):
        return greatest * (greatest / finite.min()) ** 0.15
    return 1.15 * greatest


def _draw_strip(axes: Axes, widths: Float[np.ndarray, " n"], unbounded: float) -> None:
    """Set designs without a bounded tube apart from the axis."""
    finite = widths[np.isfinite(widths)]
    greatest = finite.max() if finite.size else unbounded / 2
    border = np.sqrt(greatest * unbounded)
    end = unbounded**2 / border
    axes.axvspan(border, end, color="0.95", linewidth=0, zorder=0)
    axes.set_title("no bounded tube", loc="right", fontsize=LABEL_SIZE, color="0.3")
    axes.set_xlim(right=end)
    ticks = [tick for tick in axes.get_xticks() if tick < border]
    axes.xaxis.set_major_locator(FixedLocator(ticks))
    axes.xaxis.set_minor_locator(NullLocator())


def _draw_group(axes: Axes, group: Group, abscissa: Float[np.ndarray, " designs"]) -> None:
    """Draw the marks of designs, hollow where not certified, and names where they are few."""
    look = LOOKS[group.kind]
    lateral = 1e3 * group.lateral
    for shown, face in ((~group.certified, "white"), (group.certified, look["color"])):
        axes.plot(abscissa[shown], lateral[shown], linestyle="none", markerfacecolor=face, **look)
    if group.kind not in LABELLED:
        return
    for x, y in zip(abscissa, lateral, strict=True):
        if np.isfinite([x, y]).all():
            _write_name(axes, group.name, (x, y), look["color"])


def _write_name(axes: Axes, name: str, place: tuple[float, float], colour: str) -> None:
    leader = {"arrowstyle": "-", "color": colour, "linewidth": 0.6, "shrinkA": 0, "shrinkB": 3}
    axes.annotate(
        name,
        place,
        xytext=(GAPS[0], 0),
        textcoords="offset points",
        color=colour,
        fontsize=LABEL_SIZE,
        zorder=6,
        in_layout=False,
        arrowprops=leader,
    )


def _keys(groups: Sequence[Group], limited: bool) -> list[Line2D]:
    keys = []
    for group in groups:
        if group.kind not in LABELLED:
            dashes = "-" if group.kind == "front" else "none"
            keys.append(line_key(group.name, linestyle=dashes, **LOOKS[group.kind]))
    if not all(group.certified.all() for group in groups):
        keys.append(mark_key("hollow: not certified", "0.25", markerfacecolor="white"))
    if limited:
        keys.append(line_key("limit of the effort", **LIMIT))
    return keys
