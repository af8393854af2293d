"""The figure of `coverage`: volumes and time by horizon, and two projections of the sets."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from jaxtube.coordinates import TO_DISPLAY
from jaxtube.figures.style import (
    LIMIT,
    Line,
    bottom_legend,
    draw_polygon,
    label_plane,
    line_keys,
    page_figure,
    styled,
)

LIMITS = Line("caps $\\mathcal{E}_{op}$", LIMIT["color"], LIMIT["linestyle"])
LARGEST = Line("largest control invariant set $C$", "#009E73", (0, (4, 1.5)))
LAST = Line("feasible set $F_N$", "#0072B2")
FIRST = Line("feasible set $F_N$", "#D55E00", (0, (1, 1)))


@styled
def draw_coverage(sets: dict, operating: Float[np.ndarray, "8 3"]) -> Figure:
    """Draw the coverage by horizon, and projections of the first and the last feasible set.

    Args:
        sets: from `measure.measure`.
        operating: corners of E_op.
    """
    figure = page_figure(3.2)
    coverage, left, right = figure.subplots(1, 3)
    records = [record for record in sets["horizons"] if record["volume"] is not None]
    _draw_shares(coverage, sets, records)
    shown = [(LIMITS, operating)]
    corners = sets["control_invariant"]["corners"]
    if corners:
        shown.append((LARGEST, np.array(corners)))
    if records:
        for line, record in ((LAST, records[-1]), (FIRST, records[0])):
            label = f"feasible set $F_{{{record['horizon']}}}$"
            shown.append((line._replace(label=label), np.array(record["corners"])))
    for axes, plane, title in (
        (left, (1, 2), "(b) lateral and heading error"),
        (right, (0, 2), "(c) longitudinal and heading error"),
    ):
        for line, points in shown:
            look = {"edgecolor": line.colour, "linestyle": line.dashes, "linewidth": 1.2}
            draw_polygon(axes, (points * TO_DISPLAY)[:, plane], **look)
        label_plane(axes, plane)
        axes.set_title(title)
    bottom_legend(figure, line_keys([line for line, _ in shown]), columns=4)
    return figure


def _draw_shares(axes: Axes, sets: dict, records: list[dict]) -> None:
    """Draw what of the largest control invariant set has a plan, in %."""
    largest = sets["control_invariant"]["volume"]
    covering = [record for record in records if record["covered"] is not None]
    horizons = [record["horizon"] for record in covering]
    shares = [100 * record["covered"] / largest for record in covering]
    axes.plot(horizons, shares, "o-", color=LAST.colour, markersize=3)
    axes.axhline(100, color=LARGEST.colour, linestyle=LARGEST.dashes)
    axes.set(title="(a) coverage", xlabel="horizon $N$ [steps]", ylim=(0, 106))
    axes.set_ylabel("$F_N \\cap C$ [% of the volume of $C$]")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
