"""The figures of `maps`: the ratio over slip error and speed range or period, and feasible sets by
horizon."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from jaxtube.experiments.figures.style import (
    LIMIT,
    TO_DISPLAY,
    Line,
    bottom_legend,
    draw_polygon,
    error_label,
    line_keys,
    mark_key,
    page_figure,
    styled,
)
from jaxtube.experiments.maps.points import Found, Grid, Point

TITLES = {
    "paper": "(a) the paper's weights and model",
    "weighted": "(b) LMI, weights (1, 3, 1), 0.3",
    "optimised": "(c) optimised caps and gains",
}
AXES = {"slowest_mps": "lowest reference wheel speed [m/s]", "dt_s": "period $T$ [s]"}
LEVELS = (0.2, 0.35, 0.5, 0.65, 0.8, 1.0, 1.3, 1.8, 3.0, 5.0, 8.0)
"""Borders of the colours: blue below 1, orange above."""
COLOURS = LinearSegmentedColormap.from_list(
    "ratio", ["#0b3f78", "#2b7bba", "#d9e9f5", "#fde3cf", "#f2a268", "#a63f00"]
)
HOLDS = {"marker": "o", "markersize": 3.5, "markerfacecolor": "black", "markeredgewidth": 0.7}
ABOVE = {**HOLDS, "markerfacecolor": "white"}
WHEELS = {**ABOVE, "marker": "s"}
NONE = {**HOLDS, "marker": "x", "markersize": 5}
OWN = {**HOLDS, "marker": "o", "markersize": 8, "markerfacecolor": "none", "markeredgewidth": 0.9}
BORDER = Line("ratio = 1, the border of what is guaranteed", "black")

FEASIBLE = {
    "operating": Line("caps $\\mathcal{E}_{op}$", LIMIT["color"], LIMIT["linestyle"]),
    "largest": Line("largest control invariant set $C$", "#009E73", (0, (4, 1.5))),
    "last": Line("feasible set $F_N$", "#0072B2"),
    "first": Line("feasible set $F_N$", "#D55E00", (0, (1, 1))),
}


@styled
def ratio_map(grid: Grid, found: Found, axis: str) -> Figure:
    """Draw the ratio of the three designs over slip error and "slowest_mps" or "dt_s"; dots are
    what was computed.

    Between dots colours and border are interpolated.
    """
    values = grid.slowest_mps if axis == "slowest_mps" else grid.periods_s
    figure = page_figure(3.3)
    panels = figure.subplots(1, 3, sharex=True, sharey=True)
    norm = BoundaryNorm(LEVELS, COLOURS.N, extend="both")
    for axes, (design, title) in zip(panels, TITLES.items(), strict=True):
        _draw_ratio(axes, grid, found, design, axis, values, norm)
        axes.set_title(title, pad=8)
        axes.set_xlabel("slip error [%]")
    panels[0].set_ylabel(AXES[axis])
    bar = figure.colorbar(
        ScalarMappable(norm, COLOURS), ax=panels, label="largest share of a cap", pad=0.015
    )
    bar.set_ticks(list(LEVELS))
    bar.ax.grid(False)
    keys = [
        *line_keys([BORDER]),
        mark_key("guaranteed", "black", **HOLDS),
        mark_key("not guaranteed", "black", **ABOVE),
        mark_key("wheels too weak", "black", **WHEELS),
        mark_key("no design found", "black", **NONE),
        mark_key("the scenario", "black", **OWN),
    ]
    bottom_legend(figure, keys)
    return figure


def _draw_ratio(
    axes: Axes, grid: Grid, found: Found, design: str, axis: str, values, norm: BoundaryNorm
) -> None:
    errors = 100 * np.array(grid.slip_errors)
    ratios = np.ma.masked_invalid(ratio_table(grid, found, design, axis))
    if not ratios.mask.all():
        axes.contourf(errors, values, ratios, LEVELS, norm=norm, cmap=COLOURS, extend="both")
        if ratios.min() < 1 < ratios.max():
            axes.contour(errors, values, ratios, [1.0], colors=BORDER.colour, linewidths=1.8)
    for value in values:
        for error in grid.slip_errors:
            condition = grid.own._replace(slip_error=error, **{axis: value})
            one = found[Point(design, condition)]
            below = one.ratio is not None and one.ratio < 1
            look = NONE if one.ratio is None else HOLDS if one.holds else WHEELS if below else ABOVE
            axes.plot(
                100 * error, value, color="black", linestyle="none", clip_on=False, zorder=3, **look
            )
            if condition == grid.own:
                axes.plot(
                    100 * error,
                    value,
                    color="black",
                    linestyle="none",
                    clip_on=False,
                    zorder=3,
                    **OWN,
                )
    axes.grid(False)
    axes.set(xlim=(errors[0], errors[-1]), ylim=(values[0], values[-1]))


def ratio_table(
    grid: Grid, found: Found, design: str, axis: str
) -> Float[np.ndarray, "values errors"]:
    """Return the ratios over "slowest_mps" or "dt_s" (rows) and slip error; NaN where no design was
    found."""
    values = grid.slowest_mps if axis == "slowest_mps" else grid.periods_s
    rows = [
        [
            found[Point(design, grid.own._replace(slip_error=error, **{axis: value}))].ratio
            for error in grid.slip_errors
        ]
        for value in values
    ]
    return np.array(rows, dtype=float)


@styled
def feasible_figure(sets: dict, operating: Float[np.ndarray, "8 3"]) -> Figure:
    """Draw volumes of the feasible set by horizon, and projections of the first and the last one.

    Args:
        sets: from `maps_feasible.feasible_sets`.
        operating: corners of E_op.
    """
    figure = page_figure(3.2)
    volumes, left, right = figure.subplots(1, 3)
    shown = [record for record in sets["horizons"] if record["volume"] is not None]
    horizons = [record["horizon"] for record in shown]
    sizes = np.array([record["volume"] for record in shown])
    largest = sets["control_invariant"]
    volumes.plot(
        horizons,
        100 * sizes / sets["operating_volume"],
        "o-",
        color=FEASIBLE["last"].colour,
        markersize=3,
    )
    volumes.axhline(
        100 * largest["volume"] / sets["operating_volume"],
        color=FEASIBLE["largest"].colour,
        linestyle=FEASIBLE["largest"].dashes,
    )
    volumes.axhline(100, **LIMIT)
    volumes.set(
        xlabel="horizon $N$ [steps]", ylabel="volume [% of $\\mathcal{E}_{op}$]", ylim=(0, 106)
    )
    volumes.set_title("(a) volume")
    volumes.xaxis.set_major_locator(MaxNLocator(integer=True))
    lines = dict(FEASIBLE)
    corners = {"operating": operating}
    if largest["corners"]:
        corners["largest"] = np.array(largest["corners"])
    for name, record in (("last", shown[-1]), ("first", shown[0])) if shown else ():
        corners[name] = np.array(record["corners"])
        lines[name] = lines[name]._replace(label=f"feasible set $F_{{{record['horizon']}}}$")
    for axes, plane, letter in ((left, (1, 2), "b"), (right, (0, 2), "c")):
        for name, points in corners.items():
            look = {
                "edgecolor": lines[name].colour,
                "linestyle": lines[name].dashes,
                "linewidth": 1.2,
            }
            draw_polygon(axes, (points * TO_DISPLAY)[:, plane], **look)
        axes.set(
            xlabel=error_label(plane[0]),
            ylabel=error_label(plane[1]),
            title=f"({letter}) projections",
        )
    handles: list[Line2D] = line_keys([lines[name] for name in corners])
    bottom_legend(figure, handles, columns=4)
    return figure
