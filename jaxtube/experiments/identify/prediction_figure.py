"""The figure of measured against predicted motion, over windows that the track was not fitted to.

Predicted by the wheels as they turned: with the slips in the middle of the box, and with any slips
in it (bars). Beside it, what the same wheels say without slip on the track between the wheels.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxtube.experiments.identify.figures import SIZE
from jaxtube.figures.style import (
    INSIDE,
    OUTSIDE,
    bottom_legend,
    line_key,
    mark_key,
    page_figure,
    styled,
)
from jaxtube.identification.identify import Identified

PANELS = (("forward", "m"), ("sideways", "m"), ("turn", "deg"))


class Prediction(NamedTuple):
    """Motion over a window in the frame of its start: (forward m, sideways m, turn deg)."""

    measured: Float[np.ndarray, "k 3"]
    nominal: Float[np.ndarray, "k 3"]
    least: Float[np.ndarray, "k 3"]
    greatest: Float[np.ndarray, "k 3"]
    without_slip: Float[np.ndarray, "k 3"]


@styled
def predictions(identified: Identified, length: float, track_width: float) -> Figure:
    """Draw the motion over windows of `length` seconds; `track_width` is that between the
    wheels, m."""
    motion = predict(identified, length, track_width)
    figure = page_figure(3.2)
    for column, axes in enumerate(figure.subplots(1, 3)):
        _draw_panel(axes, motion, column)
    keys = [
        mark_key("middle of the box", INSIDE, markersize=SIZE),
        line_key("any slips of the box", color=INSIDE, linewidth=1.0, alpha=0.5),
        mark_key("no slip, track between the wheels", OUTSIDE, marker="x", markersize=SIZE + 1),
        line_key("as measured", color="0.5", linewidth=0.8),
    ]
    bottom_legend(figure, keys, columns=4)
    return figure


def predict(identified: Identified, length: float, track_width: float) -> Prediction:
    """Predict the motion over the windows that count."""
    windows = identified.windows
    wheels = windows.wheels[identified.counts]
    geometry = identified.geometry
    box = identified.widened_box
    sideslips = (-box.sideslip, box.sideslip)
    corners = [
        _move(
            _drive(
                wheels * (1.0 - np.array([right, left])), geometry.track, geometry.lever_arm, side
            ),
            length,
        )
        for right, left, side in itertools.product(box.right, box.left, sideslips)
    ]
    nominal = wheels * (1.0 - box.middle)
    return Prediction(
        _move(windows.velocity[identified.counts], length),
        _move(_drive(nominal, geometry.track, geometry.lever_arm, 0.0), length),
        np.min(corners, axis=0),
        np.max(corners, axis=0),
        _move(_drive(wheels, track_width, 0.0, 0.0), length),
    )


def _drive(
    ground: Float[np.ndarray, "k 2"], track: float, lever_arm: float, sideslip: float
) -> Float[np.ndarray, "k 3"]:
    """Return the body's velocity (v, omega, v_y) from the ground speeds of its wheels."""
    speed = ground.mean(axis=1)
    yaw_rate = (ground[:, 0] - ground[:, 1]) / track
    return np.column_stack([speed, yaw_rate, sideslip * speed - lever_arm * yaw_rate])


def _move(velocity: Float[np.ndarray, "k 3"], length: float) -> Float[np.ndarray, "k 3"]:
    """Return the motion at constant velocity, in the frame of its start (m, m, deg)."""
    turn = velocity[:, 1] * length
    chord = length * np.sinc(turn / (2 * np.pi))
    ahead = chord * np.cos(turn / 2)
    aside = chord * np.sin(turn / 2)
    forward = velocity[:, 0] * ahead - velocity[:, 2] * aside
    sideways = velocity[:, 0] * aside + velocity[:, 2] * ahead
    return np.column_stack([forward, sideways, np.rad2deg(turn)])


def _draw_panel(axes: Axes, motion: Prediction, column: int) -> None:
    """Draw predicted against measured motion in one coordinate."""
    measured = motion.measured[:, column]
    axes.vlines(
        measured,
        motion.least[:, column],
        motion.greatest[:, column],
        color=INSIDE,
        linewidth=1.0,
        alpha=0.5,
    )
    axes.plot(
        measured,
        motion.without_slip[:, column],
        color=OUTSIDE,
        linestyle="none",
        marker="x",
        markersize=SIZE + 1,
    )
    axes.plot(
        measured,
        motion.nominal[:, column],
        color=INSIDE,
        linestyle="none",
        marker="o",
        markersize=SIZE,
    )
    ends = np.array([measured.min(), measured.max()])
    axes.plot(ends, ends, color="0.5", linewidth=0.8, zorder=0)
    name, unit = PANELS[column]
    axes.set(title=name, xlabel=f"measured [{unit}]")
    if column == 0:
        axes.set_ylabel(f"predicted [{unit}]")
