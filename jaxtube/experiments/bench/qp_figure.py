"""The figure of `bench qp`: what a program costs against how exact its answer is.

Source: new.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxtube.experiments.bench.rounds import spread
from jaxtube.experiments.bench.solvers import CLOCK, KNOWING, OURS, FamilyResult, Measured
from jaxtube.figures.style import bottom_legend, page_figure, styled
from jaxtube.qp.fixed_point import TOLERANCE

LOOKS = {
    OURS: ("#0072B2", "o"),
    KNOWING: ("#0072B2", "*"),
    "DAQP": ("#D55E00", "s"),
    CLOCK: ("#D55E00", "x"),
    "quadprog": ("#E69F00", "D"),
    "OSQP": ("#009E73", "v"),
    "OSQP polished": ("#009E73", "^"),
    "ProxQP": ("#CC79A7", "<"),
    "PIQP": ("#56B4E9", ">"),
    "Clarabel": ("0.4", "p"),
    "qpax": ("#332288", "h"),
}
"""Colour and mark of each solver."""
EXACT = 1e-16
"""Residuals below it are drawn there."""


@styled
def accuracy(results: Sequence[FamilyResult]) -> Figure:
    """Draw time against largest residual, a panel for each family."""
    figure = page_figure(3.4)
    panels = figure.subplots(1, len(results), sharex=True, sharey=True, squeeze=False)[0]
    for axes, result in zip(panels, results, strict=True):
        _draw(axes, result)
    panels[0].set_ylabel("time of a program [µs]")
    handles = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    bottom_legend(figure, list(handles.values()), columns=5)
    return figure


def _draw(axes: Axes, result: FamilyResult) -> None:
    ours = [each for each in result.solvers if each.name in (OURS, KNOWING, CLOCK)]
    shown = [*ours, *(each for each in result.sweep if each.name != CLOCK)]
    for name, (colour, mark) in LOOKS.items():
        points = [_place(each) for each in shown if each.name == name]
        if points:
            x, y = np.array(points).T
            style = {"color": colour, "marker": mark, "markersize": 4.5, "linewidth": 0.8}
            axes.plot(x, y, label=name, **style)
    axes.axvline(TOLERANCE[8], color="0.6", linewidth=0.8, linestyle=":")
    axes.set(xscale="log", yscale="log", xlabel="largest residual")
    axes.set_title(f"{result.scenario}, m = {result.m}", pad=3)
    axes.invert_xaxis()


def _place(solver: Measured) -> tuple[float, float]:
    return max(solver.accuracy.largest, EXACT), spread(solver.microseconds).median
