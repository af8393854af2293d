"""The figure of `bench scale`: laps a second against laps and laps side by side, the time of a
program against the horizon.

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
from jaxtube.figures.style import page_figure, styled

COLOUR = "#0072B2"


@styled
def scale(laps: LapsResult, horizons: Sequence[HorizonResult]) -> Figure:
    """Draw three panels."""
    figure = page_figure(2.5)
    of_laps, of_tiles, of_horizons = figure.subplots(1, 3)
    _draw_speeds(of_laps, laps.checked, "laps of a Monte Carlo")
    of_laps.set_ylabel("laps a second, checked")
    _draw_speeds(of_tiles, laps.bare, "laps side by side")
    of_tiles.set_ylabel("laps a second, bare")
    _draw_times(of_horizons, horizons)
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
    axes.legend(fontsize=6.5, handlelength=1.4)
