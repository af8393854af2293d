"""A lap as moving pictures: the robot near its reference, and its errors against their limits."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from jaxtube.coordinates import COORDINATES
from jaxtube.figures.style import (
    LIMIT,
    REFERENCE,
    Line,
    controller_lines,
    error_label,
    line_key,
    line_keys,
)
from jaxtube.reporting.laps import LapSet, StoredLaps, find_poses

SIZE = (7.2, 3.6)
DPI = 100
"""Size of a picture in inches, and its resolution: 720 by 360 pixels."""
TRACE_S = 3.0
"""Of the path behind a robot."""


class Robot(NamedTuple):
    """A lap that is drawn: its controller's look, errors and poses, and the artists that move."""

    line: Line
    kept: LapSet
    errors: Float[np.ndarray, "steps+1 3"]
    poses: Float[np.ndarray, "steps+1 3"]
    shape: list  # patches of body and wheels
    trace: Any
    centre: Any
    curves: list


def choose_instants(last: int, frames: int) -> Int[np.ndarray, " frames"]:
    """Return the instants that are drawn, the first and the last among them."""
    return np.linspace(0, last, frames).round().astype(int)


def draw_frames(
    stored: StoredLaps, places: Mapping[str, int], frames: int
) -> Iterator[Image.Image]:
    """Yield the pictures in their order."""
    figure = Figure(figsize=SIZE, dpi=DPI, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    grid = figure.add_gridspec(3, 2, width_ratios=(1, 1.25))
    field = figure.add_subplot(grid[:, 0], xticks=[], yticks=[], aspect="equal")
    plots = [figure.add_subplot(grid[row, 1]) for row in range(3)]
    robots = _prepare(stored, places, field, plots)
    cursors = [axes.axvline(0, color="0.15", linewidth=0.8) for axes in plots]
    limits_key = line_key("limits of $\\mathcal{E}$", **LIMIT)
    keys = [*line_keys(robot.line for robot in robots), limits_key]
    figure.legend(handles=keys, loc="outside lower center", ncols=min(len(keys), 4))
    box = field.plot([], [], **LIMIT)[0]
    reach = 1.9 * max(robots[0].kept.limits[:2].max(), 0.6 * stored.track_m)
    dots = _draw_overview(field, stored, robots)
    _draw_scale(field, reach)
    for instant in choose_instants(len(stored.reference_poses) - 1, frames):
        at = stored.reference_poses[instant]
        _move(robots, box, stored, instant)
        for dot, robot in zip(dots, robots, strict=True):
            dot.set_data(robot.poses[instant, :1], robot.poses[instant, 1:2])
        field.set(xlim=(at[0] - reach, at[0] + reach), ylim=(at[1] - reach, at[1] + reach))
        field.set_title(f"{instant * stored.period_s:.1f} s")
        for cursor in cursors:
            cursor.set_xdata([instant * stored.period_s] * 2)
        canvas.draw()
        if figure.get_layout_engine() is not None:
            figure.set_layout_engine("none")  # once laid out, nothing may jump
        yield Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())


def _prepare(
    stored: StoredLaps, places: Mapping[str, int], field: Axes, plots: list[Axes]
) -> list[Robot]:
    """Draw what stands still, and return what moves."""
    reference = stored.reference_poses
    field.plot(reference[:, 0], reference[:, 1], **REFERENCE)
    lines = controller_lines(places)
    robots = [_add_robot(stored, name, places[name], lines[name], field, plots) for name in places]
    end = (len(reference) - 1) * stored.period_s
    for axes, coordinate, number in zip(plots, COORDINATES, range(3), strict=True):
        limit = robots[0].kept.limits[number] * coordinate.to_display
        axes.axhline(-limit, **LIMIT)
        axes.axhline(limit, **LIMIT)
        axes.set(xlim=(0, end), ylabel=error_label(number))
        largest = max(np.nanmax(np.abs(robot.errors[:, number])) for robot in robots)
        top = min(max(1.15 * limit, 1.05 * largest * coordinate.to_display), 3 * limit)
        axes.set_ylim(-top, top)
        if axes is not plots[-1]:
            axes.tick_params(labelbottom=False)
    plots[-1].set_xlabel("time [s]")
    return robots


def _draw_overview(field: Axes, stored: StoredLaps, robots: list[Robot]) -> list:
    """Draw the whole path in a corner, and return the dots that move on it."""
    corner = field.inset_axes((0.02, 0.02, 0.3, 0.3), xticks=[], yticks=[], aspect="equal")
    corner.set_facecolor((1.0, 1.0, 1.0, 0.85))
    path = stored.reference_poses
    corner.plot(path[:, 0], path[:, 1], color="0.5", linewidth=0.7)
    corner.margins(0.12)
    look = {"marker": "o", "markersize": 3.5, "linestyle": "none"}
    return [corner.plot([], [], color=robot.line.colour, **look)[0] for robot in robots]


def _draw_scale(field: Axes, reach: float) -> None:
    """Draw a bar of a round length in a corner of a view of twice the reach."""
    power = 10.0 ** np.floor(np.log10(reach / 2))
    length = max(factor * power for factor in (1, 2, 5) if factor * power <= reach / 2)
    share = length / (2 * reach)
    look = {"color": "0.15", "linewidth": 1.6, "transform": field.transAxes}
    field.plot([0.97 - share, 0.97], [0.05, 0.05], **look)
    words = f"{100 * length:g} cm" if length < 1 else f"{length:g} m"
    field.text(0.97, 0.07, words, ha="right", va="bottom", transform=field.transAxes)


def _add_robot(
    stored: StoredLaps, name: str, place: int, line: Line, field: Axes, plots: list[Axes]
) -> Robot:
    kept = stored.laps[name]
    errors = np.asarray(kept.errors[:, place], float)
    poses = find_poses(errors, stored.reference_poses)
    look = {"color": line.colour, "linewidth": 1.3}
    (trace,) = field.plot([], [], **look)
    (centre,) = field.plot([], [], marker="o", markersize=4, color=line.colour)
    fill = {"facecolor": (line.colour, 0.18), "edgecolor": line.colour, "linewidth": 1.0}
    shape = [field.fill([0], [0], **fill)[0]]
    shape += [field.fill([0], [0], facecolor=line.colour)[0] for _ in ("right", "left")]
    curves = [axes.plot([], [], **look)[0] for axes in plots]
    return Robot(line, kept, errors, poses, shape, trace, centre, curves)


def _move(robots: list[Robot], box: Any, stored: StoredLaps, instant: int) -> None:
    """Put everything where it is at an instant."""
    first = max(0, instant - round(TRACE_S / stored.period_s))
    time = np.arange(instant + 1) * stored.period_s
    for robot in robots:
        path = robot.poses[first : instant + 1]
        robot.trace.set_data(path[:, 0], path[:, 1])
        robot.centre.set_data(path[-1:, 0], path[-1:, 1])
        for patch, corners in zip(robot.shape, _outline_robot(stored.track_m), strict=True):
            patch.set_xy(_place(corners, robot.poses[instant]))
        for curve, coordinate, number in zip(robot.curves, COORDINATES, range(3), strict=True):
            curve.set_data(time, robot.errors[: instant + 1, number] * coordinate.to_display)
    a, b, _ = robots[0].kept.limits
    heading = robots[0].poses[instant, 2]
    corners = np.array([[-a, -b], [a, -b], [a, b], [-a, b], [-a, -b]])
    # Where the robot may be for its error to lie in E: turned as the robot is.
    placed = _place(corners, np.array([*stored.reference_poses[instant, :2], heading]))
    box.set_data(placed[:, 0], placed[:, 1])


def _outline_robot(track: float) -> list[Float[np.ndarray, "corners 2"]]:
    """Return body, right and left wheel of a robot of this track; their lengths are none that a
    scenario knows."""
    body = [[-0.375, -0.39], [0.375, -0.39], [0.54, 0], [0.375, 0.39], [-0.375, 0.39]]
    wheel = np.array([[-0.24, -0.06], [0.24, -0.06], [0.24, 0.06], [-0.24, 0.06]])
    return [
        track * np.array(body),
        *(track * (wheel + np.array([0, side])) for side in (-0.5, 0.5)),
    ]


def _place(
    points: Float[np.ndarray, "corners 2"], pose: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "corners 2"]:
    """Return points of a body's frame in the world."""
    cosine = np.cos(pose[2])
    sine = np.sin(pose[2])
    return pose[:2] + points @ np.array([[cosine, sine], [-sine, cosine]])
