"""The figure of one lap: its path, what it used of E and W over time, its wheels and the slips
behind it."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from jaxtube.experiments.figures.sets import IN_MILLIMETRES, INSIDE, OUTSIDE, SMALL_UNITS
from jaxtube.experiments.figures.style import (
    LIMIT,
    REFERENCE,
    TO_DISPLAY,
    Line,
    bottom_legend,
    error_label,
    line_keys,
    mark_key,
    page_figure,
    styled,
)
from jaxtube.plant.error_dynamics import world_pose
from jaxtube.statistics.lap import Lap, Usage
from jaxtube.synthesis.problem import Problem

SIDES = (Line("right wheel", "#009E73"), Line("left wheel", "#CC79A7"))
DISTURBANCES = ("w_x", "w_y", "w_\\theta")
WORST = {
    "marker": "o",
    "markersize": 6,
    "markerfacecolor": "none",
    "markeredgecolor": OUTSIDE,
    "linestyle": "none",
}


@styled
def draw(problem: Problem, lap: Lap) -> Figure:
    """Draw a lap; a ring marks where it used most of E.

    Args:
        problem: gives reference, limits and period.
        lap: of the linear plant, which has no wheels, the virtual inputs are shown instead.
    """
    figure, worst = page_figure(5.8), int(np.argmax(lap.of_error_set.share)) + 1
    most = [
        f"{100 * usage.share.max():.4g} % of $\\mathcal{{{name}}}$"
        for name, usage in _usages(lap).items()
    ]
    figure.suptitle(f"Lap {lap.number:,}: at most {' and '.join(most)} used", fontsize=10)
    panels = figure.subplots(3, 3)
    _path(panels[0, 0], problem, lap, worst)
    if lap.slips is None:
        _inputs(panels[0, 1:], problem, lap)
    else:
        _wheels(panels[0, 1], problem, lap)
        _slips(panels[0, 2], problem, lap.slips)
    for coordinate in range(3):
        _error(panels[1, coordinate], problem, lap, worst, coordinate)
        _disturbance(panels[2, coordinate], problem, lap, coordinate)
    for axes in panels.flat[1:]:
        axes.set_xlim(0, problem.reference.steps * problem.reference.dt)
    for axes in (*panels[0, 1:], *panels[2]):
        axes.set_xlabel("time [s]")
    bottom_legend(figure, _keys(lap), columns=4)
    return figure


def _usages(lap: Lap) -> dict[str, Usage]:
    return {"E": lap.of_error_set, "W": lap.of_disturbance_set}


def _path(axes: Axes, problem: Problem, lap: Lap, worst: int) -> None:
    poses = problem.reference.poses[: len(lap.trajectory.errors)]
    path = np.asarray(world_pose(jnp.asarray(lap.trajectory.errors), jnp.asarray(poses)))[:, :2]
    axes.plot(*path.T, color=INSIDE)
    axes.plot(*poses[:, :2].T, **REFERENCE)
    axes.plot(*path[worst], **WORST)
    axes.set(title="path", xlabel="$x$ [m]", ylabel="$y$ [m]")
    axes.set_aspect("equal", adjustable="datalim")


def _inputs(row, problem: Problem, lap: Lap) -> None:
    """Draw the virtual inputs."""
    time = np.arange(len(lap.trajectory.inputs)) * problem.reference.dt
    for index, (axes, label) in enumerate(zip(row, ("$u_1$ [m/s]", "$u_2$ [rad/s]"), strict=True)):
        axes.step(time, lap.trajectory.inputs[:, index], where="post", color=INSIDE, linewidth=0.8)
        axes.set(title="virtual input", ylabel=label)


def _wheels(axes: Axes, problem: Problem, lap: Lap) -> None:
    """Draw the wheel speeds with those of the reference, and the limits that they come near."""
    time = np.arange(len(lap.trajectory.wheels)) * problem.reference.dt
    for wheel, side in enumerate(SIDES):
        axes.step(time, problem.schedule[: len(time), wheel], where="post", **REFERENCE)
        axes.step(
            time, lap.trajectory.wheels[:, wheel], where="post", color=side.colour, linewidth=1.0
        )
    low, high = axes.get_ylim()
    for limit in (problem.robot.wheel_speed_min, problem.robot.wheel_speed_max):
        if low <= limit <= high:
            axes.axhline(limit, **LIMIT)
    axes.set(title="wheels", ylabel="speed [m/s]")


def _slips(axes: Axes, problem: Problem, slips: Float[np.ndarray, "steps 2 2"]) -> None:
    """Draw by how much the slip that varies differs from the nominal one; the true one where both
    do."""
    settings = problem.scenario.slip
    kind = "measured" if settings.random == "measured" else "true"
    deviations = 100 * settings.relative_error * slips[:, ("true", "measured").index(kind)]
    time = np.arange(len(deviations)) * problem.reference.dt
    for values, side in zip(deviations.T, SIDES, strict=True):
        axes.plot(time, values, ".", color=side.colour, markersize=2.5)
    axes.set(title=f"{kind} slip", ylabel="off nominal [%]")


def _error(axes: Axes, problem: Problem, lap: Lap, worst: int, coordinate: int) -> None:
    values = lap.trajectory.errors[:, coordinate] * TO_DISPLAY[coordinate]
    limit = problem.error_set.support(np.eye(3)[coordinate]) * TO_DISPLAY[coordinate]
    axes.plot(np.arange(len(values)) * problem.reference.dt, values, color=INSIDE, linewidth=1.0)
    axes.plot(worst * problem.reference.dt, values[worst], **WORST)
    for level in (-limit, limit):
        axes.axhline(level, **LIMIT)
    axes.set_ylabel(error_label(coordinate), labelpad=0)


def _disturbance(axes: Axes, problem: Problem, lap: Lap, coordinate: int) -> None:
    """Draw w at the ends of the periods, those beyond W in this coordinate in another colour."""
    values = lap.disturbance[:, coordinate] * IN_MILLIMETRES[coordinate]
    limit = problem.disturbance_set.support(np.eye(3)[coordinate]) * IN_MILLIMETRES[coordinate]
    time = (np.arange(len(values)) + 1) * problem.reference.dt
    outside = lap.of_disturbance_set.by_coordinate[:, coordinate]
    for chosen, colour in ((~outside, INSIDE), (outside, OUTSIDE)):
        axes.plot(time[chosen], values[chosen], ".", color=colour, markersize=2.5)
    for level in (-limit, limit):
        axes.axhline(level, **LIMIT)
    axes.set_ylabel(f"${DISTURBANCES[coordinate]}$ [{SMALL_UNITS[coordinate]}]", labelpad=0)
    axes.set_title(f"{100 * outside.mean():.3g} % of the steps outside")


def _keys(lap: Lap) -> list:
    keys = [
        Line2D([], [], label="limits of $\\mathcal{E}$, $\\mathcal{W}$", **LIMIT),
        Line2D([], [], label="most of $\\mathcal{E}$ used", **WORST),
        mark_key("$w$ inside its limits", INSIDE, markersize=3),
        mark_key("$w$ outside", OUTSIDE, markersize=3),
        Line2D([], [], label="reference", **REFERENCE),
    ]
    return keys if lap.slips is None else keys + line_keys(SIDES)
