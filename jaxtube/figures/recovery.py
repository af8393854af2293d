"""The figure of a recovery: what was asked for, the governor's reference and the robot, from above;
beside it what the errors use of their caps against time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxtube.coordinates import COORDINATES
from jaxtube.figures.style import (
    LIMIT,
    REFERENCE,
    Line,
    bottom_legend,
    line_key,
    line_keys,
    page_figure,
    styled,
)
from jaxtube.simulation.governor import GovernedStep
from jaxtube.synthesis.parts import Design

STATES = {
    "followed": Line("followed", "#0072B2"),
    "joining": Line("joining", "#E69F00"),
    "held back": Line("held back", "#CC79A7"),
    "lost": Line("without a plan", "#D55E00"),
}
"""Looks of the governor's reference, by what became of what was asked for."""

ROBOT = {"color": "0.45", "linewidth": 0.7}
COLOURS = ("#009E73", "#332288", "#882255")
"""Of the three coordinates of an error."""


@styled
def recovery(design: Design, steps: Sequence[GovernedStep]) -> Figure:
    """Draw the steps of a governor.

    Args:
        design: of the governor; its reference is drawn as what was asked for.
        steps: of periods one after the other.
    """
    problem = design.problem
    asked = problem.reference.poses[: problem.reference.steps + 1]
    robot = np.array([find_pose(step) for step in steps])
    width, height = np.ptp(np.concatenate([asked, robot])[:, :2], axis=0)
    figure = page_figure(3.4)
    proportion = max(width / max(height, 0.8 * width), 0.5)
    above, beside = figure.subplots(1, 2, width_ratios=(proportion, 1.0))
    above.plot(asked[:, 0], asked[:, 1], **REFERENCE)
    above.plot(robot[:, 0], robot[:, 1], **ROBOT, zorder=3)
    above.plot(*robot[0, :2], marker="o", markersize=4, color="0.15", zorder=4)
    shown = dict.fromkeys(_draw_reference(above, steps))
    above.set(title="(a) from above", aspect="equal", xlabel="$x$ [m]", ylabel="$y$ [m]")
    keys = [line_key("asked for", **REFERENCE), line_key("robot", **ROBOT)]
    bottom_legend(figure, [*keys, *line_keys(STATES[state] for state in shown)], columns=6)
    _draw_errors(beside, design, steps)
    return figure


def find_pose(step: GovernedStep) -> Float[np.ndarray, "3"]:
    """Return the pose that was measured of the robot (x m, y m, heading rad)."""
    heading = step.reference_pose[2] - step.errors[2]
    offset = (step.errors[0] + 1j * step.errors[1]) * np.exp(1j * heading)
    return np.array(
        [step.reference_pose[0] - offset.real, step.reference_pose[1] - offset.imag, heading]
    )


def _draw_reference(axes: Axes, steps: Sequence[GovernedStep]) -> Iterator[str]:
    """Draw the reference in the colours of what became of it; yield these states."""
    numbered = enumerate(steps)
    for state, group in groupby(numbered, key=lambda step: step[1].state):
        places = [number for number, _ in group]
        stretch = steps[places[0] : places[-1] + 2]
        poses = np.array([step.reference_pose for step in stretch])
        axes.plot(poses[:, 0], poses[:, 1], color=STATES[state].colour)
        yield state


def _draw_errors(axes: Axes, design: Design, steps: Sequence[GovernedStep]) -> None:
    """Draw errors against time, as shares of their caps."""
    caps = design.problem.operating_set.support(np.eye(3))
    times = design.problem.reference.dt * np.arange(len(steps))
    shares = np.array([step.errors for step in steps]) / caps
    for values, coordinate, colour in zip(shares.T, COORDINATES, COLOURS, strict=True):
        axes.plot(times, values, color=colour, linewidth=0.9, label=f"${coordinate.error}$")
    for side in (-1.0, 1.0):
        axes.axhline(side, **LIMIT)
    axes.set(title="(b) errors", xlabel="$t$ [s]", ylabel="share of the cap")
    axes.legend(loc="lower right", ncols=3, bbox_to_anchor=(1.0, 0.05))
