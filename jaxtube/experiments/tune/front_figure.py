"""Figures of what tuning is compared with: a grid of weights and its front, and other designs on
other references.

The front holds the designs that no other beats in both lateral error and effort (Pareto).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Annotation, Text
from matplotlib.ticker import FixedLocator, NullLocator
from matplotlib.transforms import Bbox

from jaxtube.experiments.figures.style import LIMIT, bottom_legend, mark_key, page_figure, styled
from jaxtube.experiments.tune.figures import AFTER, BEFORE, plain_ticks, spans_decade

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
ANGLES = np.deg2rad([0, 180, 22.5, -22.5, 157.5, -157.5, 45, -45, 135, -135, 90, -90])
"""Directions from a mark to its name, the best ones first."""
GAPS = np.arange(9.0, 50.0, 4.0)
"""Between a mark and its name, points."""
SWEEPS = 3
LABEL_SIZE = 8
AS_TUNED: dict[str, Any] = {"color": AFTER.colour, "marker": "o", "markersize": 6}
OTHERS: list[dict[str, Any]] = [
    {"color": colour, "marker": marker, "markersize": 4.5}
    for colour, marker in zip(
        (BEFORE.colour, "#E69F00", "#009E73", "#CC79A7", "#56B4E9"), "Ds^vP", strict=True
    )
]
"""Looks of compared designs, the last of which is drawn as tuned."""
ROW, HEADING = 0.19, 0.24
"""Heights of a design's and of a reference's row, inches."""


class Group(NamedTuple):
    """Designs that are drawn alike, one an entry."""

    name: str
    lateral: Float[np.ndarray, " designs"]  # RMS of e_y once settled, m
    effort: Float[np.ndarray, " designs"]  # RMS, m/s
    tube: Float[
        np.ndarray, " designs"
    ]  # lateral half width of the minimal robust invariant set, m; NaN: unbounded
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
    none = _place_of_none(widths)
    for group in groups:
        if group.kind == "front":
            order, look = np.argsort(group.effort), LOOKS["front"]
            points = group.effort[order], 1e3 * group.lateral[order]
            effort.plot(*points, color=look["color"], linewidth=1.0, zorder=look["zorder"])
        _draw_group(effort, group, group.effort)
        _draw_group(tube, group, np.where(np.isfinite(group.tube), 1e2 * group.tube, none))
    effort.set(xlabel="RMS of effort [m/s]", ylabel="RMS of $e_y$ once settled [mm]", yscale="log")
    tube.set_xlabel("lateral half width of the minimal invariant set [cm]")
    effort.set_title("error and effort", loc="left")
    tube.set_title("error and tube", loc="left")
    plain_ticks(effort.yaxis)
    if spans_decade(widths):
        tube.set_xscale("log")
        plain_ticks(tube.xaxis)
    if not np.isfinite(widths).all():
        _draw_none(tube, widths, none)
    if effort_limit is not None:
        effort.axvline(effort_limit, **LIMIT)
    bottom_legend(figure, _keys(groups, effort_limit is not None), columns=4)
    figure.draw_without_rendering()
    for axes in (effort, tube):
        _place_names(figure, axes)
    return figure


def _place_of_none(widths: Float[np.ndarray, " n"]) -> float:
    """Return the abscissa of designs without a bounded tube, right of all others."""
    finite = widths[np.isfinite(widths)]
    if not finite.size:
        return 1.0
    return (
        finite.max() * (finite.max() / finite.min()) ** 0.15
        if spans_decade(widths)
        else 1.15 * finite.max()
    )


def _draw_none(axes: Axes, widths: Float[np.ndarray, " n"], none: float) -> None:
    """Set what has no bounded tube apart from the axis."""
    finite = widths[np.isfinite(widths)]
    greatest = finite.max() if finite.size else none / 2
    border = np.sqrt(greatest * none)
    axes.axvspan(border, none**2 / border, color="0.95", linewidth=0, zorder=0)
    axes.set_title("no bounded tube", loc="right", fontsize=LABEL_SIZE, color="0.3")
    axes.set_xlim(right=none**2 / border)
    axes.xaxis.set_major_locator(
        FixedLocator([tick for tick in axes.get_xticks() if tick < border])
    )
    axes.xaxis.set_minor_locator(NullLocator())


def _draw_group(axes: Axes, group: Group, abscissa: Float[np.ndarray, " designs"]) -> None:
    """Draw the marks of designs, hollow where they are not certified, and names where they are few."""
    look, lateral = LOOKS[group.kind], 1e3 * group.lateral
    for chosen, face in ((~group.certified, "white"), (group.certified, look["color"])):
        axes.plot(abscissa[chosen], lateral[chosen], linestyle="none", markerfacecolor=face, **look)
    for x, y in zip(abscissa, lateral, strict=True) if group.kind in LABELLED else ():
        if np.isfinite([x, y]).all():
            axes.annotate(
                group.name,
                (x, y),
                xytext=(GAPS[0], 0),
                textcoords="offset points",
                **{"color": look["color"], "fontsize": LABEL_SIZE, "zorder": 6, "in_layout": False},
                arrowprops={
                    "arrowstyle": "-",
                    "color": look["color"],
                    "linewidth": 0.6,
                    "shrinkA": 0,
                    "shrinkB": 3,
                },
            )


class _Place(NamedTuple):
    """A place for a name, pixels."""

    centre: Float[np.ndarray, "2"]
    box: Bbox
    leader: Float[np.ndarray, "k 2"]  # from the mark to the box
    gap: float  # between mark and box, points


def _places(
    mark: Float[np.ndarray, "2"], size: Float[np.ndarray, "2"], pixels: float
) -> list[_Place]:
    """Return the places around a mark for a name of a size, with so many pixels a point."""
    places = []
    for gap, angle in product(GAPS, ANGLES):
        direction = np.array([np.cos(angle), np.sin(angle)])
        away = gap * pixels * direction + size / 2 * np.clip(1.5 * direction, -1, 1)
        box = Bbox([mark + away - size / 2, mark + away + size / 2])
        leader = mark + np.linspace(0, 1, 30)[:, None] * away
        inside = np.all((leader >= box.min) & (leader <= box.max), axis=1)
        places.append(_Place(mark + away, box, leader[~inside], gap))
    return places


def _place_names(figure: Figure, axes: Axes) -> None:
    """Move each name to where it covers the fewest marks, and no name or leader, close to its own
    mark."""
    pixels, inside = figure.dpi / 72, axes.get_window_extent()
    names = [text for text in axes.texts if isinstance(text, Annotation)]
    marks = np.concatenate([_covered(line) for line in axes.lines])
    named = axes.transData.transform([text.xy for text in names]).reshape(-1, 2)
    around = [
        _places(mark, np.array(Text.get_window_extent(text).size), pixels)
        for mark, text in zip(named, names, strict=True)
    ]

    def own_cost(place: _Place) -> float:
        box = place.box.padded(1.5 * pixels)
        outside = not (inside.contains(*box.min) and inside.contains(*box.max))
        near = box.padded(4.5 * pixels).count_contains(named)
        return 1e3 * outside + 20 * near + 3 * box.count_contains(marks) + 0.3 * place.gap

    def mutual_cost(place: _Place, other: _Place) -> float:
        box = place.box.padded(pixels)
        crossed = other.box.count_contains(place.leader) + box.count_contains(other.leader) > 0
        between = place.leader[:, None] - other.leader
        touching = np.hypot(between[..., 0], between[..., 1]).min() < 4 * pixels
        return 1e3 * box.overlaps(other.box) + 40 * (crossed + touching)

    own = [[own_cost(place) for place in places] for places in around]
    chosen = [places[int(np.argmin(costs))] for places, costs in zip(around, own, strict=True)]
    # Again and again, for names give way to each other.
    for _, i in product(range(SWEEPS), range(len(names))):
        others = [*chosen[:i], *chosen[i + 1 :]]
        candidates = zip(around[i], own[i], strict=True)
        costs = [
            cost + sum(mutual_cost(place, other) for other in others) for place, cost in candidates
        ]
        chosen[i] = around[i][int(np.argmin(costs))]
    for i, text in enumerate(names):
        text.set(position=tuple((chosen[i].centre - named[i]) / pixels), ha="center", va="center")


def _covered(line: Line2D) -> Float[np.ndarray, "k 2"]:
    """Return the pixels of a line's marks, or many along it where it is drawn through."""
    pixels = line.get_transform().transform(np.asarray(line.get_xydata()))
    if line.get_linestyle() == "None":
        return pixels
    fine = np.linspace(0, len(pixels) - 1, 100 * len(pixels))
    return np.column_stack(
        [np.interp(fine, np.arange(len(pixels)), pixels[:, i]) for i in range(2)]
    )


def _keys(groups: Sequence[Group], limited: bool) -> list[Line2D]:
    unlabelled = [group for group in groups if group.kind not in LABELLED]
    keys = [
        Line2D(
            [],
            [],
            label=group.name,
            linestyle="-" if group.kind == "front" else "none",
            **LOOKS[group.kind],
        )
        for group in unlabelled
    ]
    if not all(group.certified.all() for group in groups):
        keys.append(mark_key("hollow: not certified", "0.25", markerfacecolor="white"))
    return [*keys, Line2D([], [], label="limit of the effort", **LIMIT)] if limited else keys


@styled
def comparison_figure(
    rows: Sequence[tuple[str, str, float, float, float]], confidence: float = 0.95
) -> Figure:
    """Draw mean lateral errors with their intervals, reference by reference.

    Args:
        rows: name of the reference, name of the design, mean of the lateral RMS and the ends of its
            interval, m; the design met last is drawn as the tuned one.
        confidence: of the intervals.
    """
    references, designs = (
        list(dict.fromkeys(row[0] for row in rows)),
        list(dict.fromkeys(row[1] for row in rows)),
    )
    figure = page_figure(0.65 + HEADING * len(references) + ROW * len(rows))
    axes = figure.subplots()
    beside: dict[str, Any] = {
        "transform": axes.get_yaxis_transform(),
        "va": "center_baseline",
        "fontsize": LABEL_SIZE,
    }
    place, places = 0.0, []
    for reference in references:
        place += HEADING
        axes.text(-0.012, place, reference, ha="right", weight="bold", **beside)
        for _, design, mean, low, high in [row for row in rows if row[0] == reference]:
            place += ROW
            places.append((place, design))
            look = (
                AS_TUNED if design == designs[-1] else OTHERS[designs.index(design) % len(OTHERS)]
            )
            mean, low, high = 1e3 * mean, 1e3 * low, 1e3 * high
            axes.plot(
                [low, high],
                [place, place],
                color=look["color"],
                linewidth=1.4,
                solid_capstyle="butt",
            )
            axes.plot(mean, place, **look)
            texts = [f"{value:#.3g}".rstrip(".") for value in (mean, low, high)]
            axes.text(1.015, place, f"{texts[0]}  ({texts[1]} to {texts[2]})", **beside)
    axes.set_yticks(*zip(*places, strict=True))
    axes.tick_params(axis="y", length=0)
    axes.grid(False, axis="y")
    axes.set(ylim=(place + ROW, HEADING / 2))
    axes.set_xlabel(f"lateral RMS once settled, {100 * confidence:g} % interval [mm]")
    if spans_decade(np.array([row[2] for row in rows])):
        axes.set_xscale("log")
        plain_ticks(axes.xaxis)
    else:
        axes.set_xlim(left=0)
    return figure
