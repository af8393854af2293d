"""The figure of one lap: its path, what it used of E and W over time, its wheels and the slips
behind it."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxtube.figures.style import (
    INSIDE,
    LIMIT,
    METRES,
    MILLIMETRES,
    OUTSIDE,
    REFERENCE,
    Line,
    bottom_legend,
    disturbance_label,
    error_label,
    line_key,
    line_keys,
    mark_key,
    page_figure,
    styled,
)
from jaxtube.plant.error_dynamics import world_pose
from jaxtube.plant.reference import settled_step
from jaxtube.plant.slip_bounds import slip_bounds
from jaxtube.statistics.lap import Lap
from jaxtube.synthesis.problem import Problem

SIDES = (Line("right wheel", "#009E73"), Line("left wheel", "#CC79A7"))
WORST: dict[str, Any] = {
    "marker": "o",
    "markersize": 6,
    "markerfacecolor": "none",
    "markeredgecolor": OUTSIDE,
    "linestyle": "none",
}
WORST_SETTLED: dict[str, Any] = {**WORST, "marker": "D", "markersize": 5}
"""Marks of the step that uses most of E, and of the one that does once the lap has settled."""


class WorstInstant(NamedTuple):
    """The steps at which a lap uses most of E: of the whole lap, and once it has settled."""

    step: int
    settled: int | None  # None for a lap that is too short to settle
    share: float
    settled_share: float


@styled
def draw(problem: Problem, lap: Lap) -> Figure:
    """Draw a lap; a ring marks where it used most of E, a diamond where it did once settled.

    Args:
        problem: gives reference, limits and period.
        lap: of the linear plant, which has no wheels, the virtual inputs are shown instead.
    """
    worst = _find_worst(problem, lap)
    figure = page_figure(7.0)
    figure.suptitle(_title(problem, lap, worst))
    panels = figure.subplots(4, 3)
    _draw_path(panels[0, 0], problem, lap, worst)
    if lap.slips is None:
        _draw_inputs(panels[0, 1:], problem, lap)
    else:
        _draw_wheels(panels[0, 1], problem, lap)
        _draw_slips(panels[0, 2], problem, lap.slips)
    first_settled = settled_step(problem.reference)
    for coordinate in range(3):
        whole, settled, disturbance = panels[1:, coordinate]
        _draw_error(whole, problem, lap, worst, coordinate)
        _draw_settled_error(settled, problem, lap, worst, coordinate)
        _draw_disturbance(disturbance, problem, lap, coordinate)
        disturbance.set_xlabel("time [s]")
    end = problem.reference.steps * problem.reference.dt
    for axes in (*panels[0, 1:], *panels[1], *panels[3]):
        axes.set_xlim(0, end)
    for axes in panels[2]:
        axes.set_xlim(min(first_settled * problem.reference.dt, 0.99 * end), end)
    panels[1, 1].set_title("whole lap and the limits of $\\mathcal{E}$")
    panels[2, 1].set_title("once settled, magnified")
    bottom_legend(figure, _keys(lap), columns=4)
    return figure


def _find_worst(problem: Problem, lap: Lap) -> WorstInstant:
    share = lap.of_error_set.share
    step = int(np.argmax(share)) + 1
    first = settled_step(problem.reference)
    if first >= len(share):
        return WorstInstant(step, None, share[step - 1], np.nan)
    settled = first + int(np.argmax(share[first - 1 :]))
    return WorstInstant(step, settled, share[step - 1], share[settled - 1])


def _title(problem: Problem, lap: Lap, worst: WorstInstant) -> str:
    dt = problem.reference.dt
    of_errors = f"{100 * worst.share:.4g} % of $\\mathcal{{E}}$ at {worst.step * dt:.3g} s"
    if worst.settled is not None:
        once = f"once settled {100 * worst.settled_share:.4g} % at {worst.settled * dt:.3g} s"
        of_errors = f"{of_errors}, {once}"
    of_disturbances = f"{100 * lap.of_disturbance_set.share.max():.4g} % of $\\mathcal{{W}}$"
    return f"Lap {lap.number:,} uses at most {of_errors}; {of_disturbances}"


def _draw_path(axes: Axes, problem: Problem, lap: Lap, worst: WorstInstant) -> None:
    poses = problem.reference.poses[: len(lap.trajectory.errors)]
    path = np.asarray(jax.jit(world_pose)(lap.trajectory.errors, poses))
    axes.plot(path[:, 0], path[:, 1], color=INSIDE)
    axes.plot(poses[:, 0], poses[:, 1], **REFERENCE)
    axes.plot(path[worst.step, 0], path[worst.step, 1], **WORST)
    if worst.settled is not None:
        axes.plot(path[worst.settled, 0], path[worst.settled, 1], **WORST_SETTLED)
    axes.set(title="path", xlabel="$x$ [m]", ylabel="$y$ [m]")
    axes.set_aspect("equal", adjustable="datalim")


def _draw_inputs(row, problem: Problem, lap: Lap) -> None:
    """Draw the virtual inputs."""
    inputs = lap.trajectory.inputs
    time = np.arange(len(inputs)) * problem.reference.dt
    labels = ("$u_1$ [m/s]", "$u_2$ [rad/s]")
    for axes, values, label in zip(row, inputs.T, labels, strict=True):
        axes.step(time, values, where="post", color=INSIDE, linewidth=0.8)
        axes.set(title="virtual input", ylabel=label)


def _draw_wheels(axes: Axes, problem: Problem, lap: Lap) -> None:
    """Draw the wheel speeds with those of the reference, and the limits that they come near."""
    wheels = lap.trajectory.wheels
    time = np.arange(len(wheels)) * problem.reference.dt
    for wheel, side in enumerate(SIDES):
        axes.step(time, problem.schedule[: len(time), wheel], where="post", **REFERENCE)
        axes.step(time, wheels[:, wheel], where="post", color=side.colour, linewidth=1.0)
    low, high = axes.get_ylim()
    for limit in (problem.robot.wheel_speed_min, problem.robot.wheel_speed_max):
        if low <= limit <= high:
            axes.axhline(limit, **LIMIT)
    axes.set(title="wheels", ylabel="speed [m/s]")


def _draw_slips(axes: Axes, problem: Problem, deviations: Float[np.ndarray, "steps 2 2"]) -> None:
    """Draw the slip that varies; the true one where both do."""
    slips = slip_bounds(problem.scenario.slip)
    true, measured = np.moveaxis(deviations, 1, 0)
    is_measured_alone = slips.uncertain_slip == "measured"
    shown = slips.measured_slip(true, measured) if is_measured_alone else slips.true_slip(true)
    time = np.arange(len(deviations)) * problem.reference.dt
    for values, side in zip(np.asarray(shown).T, SIDES, strict=True):
        axes.plot(time, 100 * values, ".", color=side.colour, markersize=2.5)
    axes.set(title=f"{'measured' if is_measured_alone else 'true'} slip", ylabel="slip [%]")


def _draw_error(
    axes: Axes, problem: Problem, lap: Lap, worst: WorstInstant, coordinate: int
) -> None:
    """Draw an error over the whole lap, with its limits."""
    scale = METRES.factors[coordinate]
    values = lap.trajectory.errors[:, coordinate] * scale
    limit = problem.error_set.support(np.eye(3)[coordinate]) * scale
    dt = problem.reference.dt
    axes.plot(np.arange(len(values)) * dt, values, color=INSIDE, linewidth=1.0)
    axes.plot(worst.step * dt, values[worst.step], **WORST)
    axes.axhline(-limit, **LIMIT)
    axes.axhline(limit, **LIMIT)
    axes.set_ylabel(error_label(coordinate), labelpad=0)


def _draw_settled_error(
    axes: Axes, problem: Problem, lap: Lap, worst: WorstInstant, coordinate: int
) -> None:
    """Draw an error from where the lap has settled, in small units."""
    first = settled_step(problem.reference)
    values = lap.trajectory.errors[:, coordinate] * MILLIMETRES.factors[coordinate]
    dt = problem.reference.dt
    time = np.arange(first, len(values)) * dt
    axes.plot(time, values[first:], color=INSIDE, linewidth=1.0)
    if worst.settled is not None:
        axes.plot(worst.settled * dt, values[worst.settled], **WORST_SETTLED)
    axes.set_ylabel(error_label(coordinate, MILLIMETRES), labelpad=0)


def _draw_disturbance(axes: Axes, problem: Problem, lap: Lap, coordinate: int) -> None:
    """Draw w at the ends of the periods, those beyond W in this coordinate in another colour."""
    scale = MILLIMETRES.factors[coordinate]
    values = lap.disturbance[:, coordinate] * scale
    limit = problem.disturbance_set.support(np.eye(3)[coordinate]) * scale
    time = (np.arange(len(values)) + 1) * problem.reference.dt
    outside = lap.of_disturbance_set.by_coordinate[:, coordinate]
    _draw_dots(axes, time, values, ~outside, INSIDE)
    _draw_dots(axes, time, values, outside, OUTSIDE)
    axes.axhline(-limit, **LIMIT)
    axes.axhline(limit, **LIMIT)
    axes.set_ylabel(disturbance_label(coordinate), labelpad=0)
    axes.set_title(f"{100 * outside.mean():.3g} % of the steps outside")


def _draw_dots(axes: Axes, time, values, shown: Bool[np.ndarray, " steps"], colour: str) -> None:
    axes.plot(time[shown], values[shown], ".", color=colour, markersize=2.5)


def _keys(lap: Lap) -> list:
    keys = [
        line_key("limits of $\\mathcal{E}$, $\\mathcal{W}$", **LIMIT),
        line_key("most of $\\mathcal{E}$ used", **WORST),
        line_key("most once settled", **WORST_SETTLED),
        mark_key("$w$ inside its limits", INSIDE, markersize=3),
        mark_key("$w$ outside", OUTSIDE, markersize=3),
        line_key("reference", **REFERENCE),
    ]
    if lap.slips is not None:
        keys += line_keys(SIDES)
    return keys
