"""The figure of paths in the world frame: whole, and magnified where controllers differ."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxtube.figures.curves import Curve, label_in_lines, make_curves, quantiles
from jaxtube.figures.style import (
    REFERENCE,
    Line,
    draw_line,
    line_key,
    line_keys,
    mark_key,
    page_figure,
    styled,
)
from jaxtube.plant.error_dynamics import world_pose
from jaxtube.plant.reference import Reference
from jaxtube.synthesis.problem import Problem

THIN_RUNS = 30
"""Single runs drawn around a median path."""

START_S = 1.5
APART_S = 0.4
DOTS_S = 0.5
"""Of the path, s: the magnified start, half of the other magnified stretch, and from dot to dot."""

DOTS: dict[str, Any] = {
    "marker": "o",
    "markersize": 4,
    "markeredgecolor": "white",
    "markeredgewidth": 0.5,
    "linestyle": "",
}
PLACE: dict[str, Any] = {
    "marker": "s",
    "markersize": 7,
    "markerfacecolor": "none",
    "color": "0.15",
    "zorder": 5,
}
"""Mark of a magnified stretch on the whole path."""


class Path(NamedTuple):
    """The runs of one controller in the world frame, m."""

    line: Line
    runs: Float[np.ndarray, "steps+1 batch 2"]
    median: Float[np.ndarray, "steps+1 2"]


class Stretch(NamedTuple):
    """A part of the path that is magnified: steps `first` to `last`, and the step that marks it."""

    title: str
    first: int
    last: int
    middle: int


@styled
def trajectories(problem: Problem, runs: Mapping[str, Any]) -> Figure:
    """Draw the paths in the world frame, whole and magnified at the start and where they lie
    furthest apart.

    Args:
        problem: gives the reference.
        runs: by controller's name, anything with `errors` (steps+1, batch, 3) and `wheels` (steps,
            batch, 2).
    """
    curves = make_curves(runs)
    reference = problem.reference
    poses = reference.poses[: reference.steps + 1]
    paths = [_make_path(curve, poses) for curve in curves.values()]
    width, height = np.ptp(poses[:, :2], axis=0)
    figure = page_figure(3.7)
    panels = figure.subplot_mosaic(
        [["whole", "start", "legend"], ["whole", "apart", "legend"]],
        width_ratios=(2 * np.clip(width / height, 0.5, 1.0), 1.5, 0.9),
    )
    _draw_whole(panels["whole"], paths, poses)
    stretches = {"start": _start_stretch(reference), "apart": _apart_stretch(reference, curves)}
    every = max(round(DOTS_S / reference.dt), 1)
    for name, stretch in stretches.items():
        _draw_stretch(panels[name], paths, poses, stretch, every)
        _mark_place(panels["whole"], poses[stretch.middle, :2], stretch.title[1])
    keys = line_keys(path.line._replace(label=label_in_lines(path.line)) for path in paths)
    keys += [line_key("Reference", **REFERENCE), mark_key(f"every {DOTS_S} s", "0.15")]
    panels["legend"].set_axis_off()
    panels["legend"].legend(handles=keys, loc="center left", borderaxespad=0)
    return figure


def _make_path(curve: Curve, poses: Float[np.ndarray, "steps+1 3"]) -> Path:
    runs = np.asarray(jax.jit(world_pose)(curve.errors, poses[:, None]))[..., :2]
    median = [quantiles(runs[..., i], [0.5])[0] for i in range(2)]
    return Path(curve.line, runs, np.stack(median, axis=1))


def _start_stretch(reference: Reference) -> Stretch:
    last = min(round(START_S / reference.dt), reference.steps)
    return Stretch("(b) start", 0, last, 0)


def _apart_stretch(reference: Reference, curves: Mapping[str, Curve]) -> Stretch:
    """Return the stretch around the greatest median lateral error of a controller, once the start
    is over."""
    medians = [quantiles(curve.errors[..., 1], [0.5])[0] for curve in curves.values()]
    lateral = np.nan_to_num(np.max(np.abs(medians), axis=0))
    over = min(round(START_S / reference.dt), reference.steps)
    middle = over + int(np.argmax(lateral[over:]))
    half = round(APART_S / reference.dt)
    title = f"(c) around $t = {middle * reference.dt:.1f}$ s"
    return Stretch(title, max(middle - half, 0), min(middle + half, reference.steps), middle)


def _draw_whole(axes: Axes, paths: list[Path], poses) -> None:
    axes.set(title="(a) whole run, medians", aspect="equal", xlabel="$x$ [m]", ylabel="$y$ [m]")
    for path in paths:
        draw_line(axes, path.median[:, 0], path.median[:, 1], path.line)
    axes.plot(poses[:, 0], poses[:, 1], **REFERENCE)


def _mark_place(axes: Axes, place: Float[np.ndarray, "2"], letter: str) -> None:
    axes.plot(place[0], place[1], **PLACE)
    axes.annotate(letter, (place[0], place[1]), xytext=(6, -9), textcoords="offset points")


def _draw_stretch(axes: Axes, paths: list[Path], poses, stretch: Stretch, every: int) -> None:
    """Draw a stretch: single runs, medians, and where everyone is at the same instants."""
    axes.set(title=stretch.title, xlabel="$x$ [m]", ylabel="$y$ [m]")
    # The longer side of the panel shows more than the stretch, so the lines go on beyond it.
    length = stretch.last + 1 - stretch.first
    around = np.arange(max(stretch.first - length, 0), min(stretch.last + length, len(poses)))
    instants = around[(around - stretch.first) % every == 0]
    inside = np.arange(stretch.first, stretch.last + 1)
    for path in paths:
        single = path.runs[around, :THIN_RUNS]
        colour = path.line.colour
        axes.plot(single[..., 0], single[..., 1], color=colour, linewidth=0.4, alpha=0.25)
        draw_line(axes, path.median[around, 0], path.median[around, 1], path.line)
        axes.plot(
            path.median[instants, 0], path.median[instants, 1], color=colour, **DOTS, zorder=5
        )
    axes.plot(poses[around, 0], poses[around, 1], **REFERENCE)
    axes.plot(poses[instants, 0], poses[instants, 1], color="0.15", **DOTS, zorder=4)
    shown = np.concatenate([poses[inside, :2], *[path.median[inside] for path in paths]])
    least = np.nanmin(shown, axis=0)
    greatest = np.nanmax(shown, axis=0)
    margin = 0.08 * np.max(greatest - least)
    axes.set_xlim(least[0] - margin, greatest[0] + margin, auto=True)
    axes.set_ylim(least[1] - margin, greatest[1] + margin, auto=True)
    axes.set_aspect("equal", adjustable="datalim")
