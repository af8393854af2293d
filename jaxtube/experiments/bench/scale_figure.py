"""The figure of `bench scale`: laps a second against laps and laps side by side, the time of a plan
against the share that has active rows, and of a program against the horizon.

Source: new.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxtube.experiments.bench.horizons import HorizonResult, fit_exponents
from jaxtube.experiments.bench.lap_counts import LapsResult
from jaxtube.experiments.bench.qp_figure import LOOKS
from jaxtube.experiments.bench.rounds import spread
from jaxtube.experiments.bench.shares import SharesResult
from jaxtube.figures.style import page_figure, styled

COLOUR = "#0072B2"
LEGEND_SIZE = 7


@styled
def scale(laps: LapsResult, shares: SharesResult, horizons: Sequence[HorizonResult]) -> Figure:
    """Draw four panels."""
    figure = page_figure(4.6)
    panels = figure.subplots(2, 2)
    _draw_speeds(panels[0, 0], laps.checked, "laps of a Monte Carlo")
    panels[0, 0].set_ylabel("laps a second, checked")
    _draw_speeds(panels[0, 1], laps.bare, "laps side by side")
    panels[0, 1].set_ylabel("laps a second, bare")
    panels[0, 1].set_xticks(list(laps.bare), [f"{tile}" for tile in laps.bare])
    panels[0, 1].minorticks_off()
    _draw_shares(panels[1, 0], shares)
    _draw_times(panels[1, 1], horizons)
    return figure


def _draw_speeds(axes: Axes, speeds: dict[int, Float[np.ndarray, " rounds"]], label: str) -> None:
    """Draw medians with quartiles."""
    found = [spread(each) for each in speeds.values()]
    medians = np.array([each.median for each in found])
    below = medians - [each.low for each in found]
    above = [each.high for each in found] - medians
    axes.errorbar(
        list(speeds),
        medians,
        yerr=[below, above],
        color=COLOUR,
        marker="o",
        markersize=4,
        capsize=2,
    )
    axes.set_xscale("log")
    axes.set_ylim(0, 1.15 * medians.max())
    axes.set_xlabel(label)


def _draw_shares(axes: Axes, found: SharesResult) -> None:
    """Draw medians by share of a batch."""
    for name, times in found.microseconds.items():
        colour, mark = LOOKS[name]
        medians = [spread(each).median for each in times]
        percent = 100 * np.array(found.shares)
        axes.plot(percent, medians, color=colour, marker=mark, markersize=4, label=name)
    axes.set_xscale("symlog", linthresh=0.2, linscale=0.5)
    ticks = [0, 0.2, 1, 10, 100]
    axes.set_xticks(ticks, [f"{each:g}" for each in ticks])
    axes.set(yscale="log", xlabel="plans with active rows [%]", ylabel="time of a plan [µs]")
    times = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50]
    limits = axes.get_ylim()
    axes.set_yticks(times, [f"{each:g}" for each in times])
    axes.minorticks_off()
    axes.set_ylim(limits)
    axes.legend(fontsize=LEGEND_SIZE, handlelength=1.4)


def _draw_times(axes: Axes, results: Sequence[HorizonResult]) -> None:
    """Draw medians by horizon; the exponents are in the legend."""
    for name, exponent in fit_exponents(results).items():
        points = [
            (result.horizon, spread(each.microseconds).median)
            for result in results
            for each in result.solvers
            if each.name == name
        ]
        x, y = np.array(points).T
        colour, mark = LOOKS[name]
        label = f"{name}, $N^{{{exponent:.2f}}}$"
        axes.plot(x, y, color=colour, marker=mark, markersize=4, label=label)
    ticks = [result.horizon for result in results]
    axes.set(xscale="log", yscale="log", xlabel="horizon $N$", ylabel="time of a program [µs]")
    axes.set_xticks(ticks, [f"{each}" for each in ticks])
    axes.minorticks_off()
    # Room for the legend above the curves.
    axes.set_ylim(top=30 * axes.get_ylim()[1])
    axes.legend(fontsize=LEGEND_SIZE, handlelength=1.4, loc="upper left", ncols=2)
