"""States and inputs of a linear system's laps against time."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxtube.figures.style import LIMIT, bottom_legend, line_key, page_figure, styled
from jaxtube.simulation.linear_laps import LinearLaps
from sets.polytope import Polytope

HEIGHT = 1.3
"""Inches of a panel."""
FAINT = {"color": "C0", "alpha": 0.25, "linewidth": 0.6}


@styled
def draw_linear_laps(laps: LinearLaps) -> Figure:
    """Draw every state and every input of all laps in a panel of its own, with the extent of E and
    U along it."""
    problem = laps.design.problem
    system = laps.design.system
    names = (*system.state_names, *system.input_names)
    figure = page_figure(HEIGHT * len(names) + 0.6)
    panels = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    states = np.moveaxis(laps.states, 2, 0)
    inputs = np.moveaxis(laps.inputs, 2, 0)
    extents = [*_find_extent(problem.error_set), *_find_extent(problem.input_set)]
    for axes, name, values, extent in zip(panels, names, [*states, *inputs], extents, strict=True):
        _draw_values(axes, values, system.dt)
        for limit in extent:
            axes.axhline(limit, **LIMIT)
        axes.set_ylabel(name)
    panels[-1].set_xlabel("time [s]")
    keys = [line_key("a lap", **FAINT), line_key("limits of E and U", **LIMIT)]
    bottom_legend(figure, keys)
    return figure


def _draw_values(axes: Axes, values: Float[np.ndarray, "times laps"], dt: float) -> None:
    axes.plot(dt * np.arange(len(values)), values, **FAINT)


def _find_extent(limits: Polytope) -> Float[np.ndarray, "n 2"]:
    """Return the least and the greatest value of each coordinate."""
    identity = np.eye(limits.dimension)
    return np.stack([-limits.support(-identity), limits.support(identity)], axis=1)
