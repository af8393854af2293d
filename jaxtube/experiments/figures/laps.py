"""Closed-loop figures: paths, errors, wheel speeds, margins to E, and runs under stress, over many
realisations.

Bands are pointwise in time: median, 5 to 95 % of the realisations, and the extremes. Controllers
whose errors agree to within `COINCIDE` are drawn once, under a joint name, so that no curve hides
another.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from jaxtube.experiments.figures.stress import leaves_error_set, stress
from jaxtube.experiments.figures.style import (
    CONTROLLERS,
    ERRORS,
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
from jaxtube.plant.reference import TRANSIENT_S
from jaxtube.synthesis.problem import Problem

__all__ = ["errors", "margins", "stress", "trajectories", "wheel_speeds"]

COINCIDE = 1e-5
"""Errors closer than this, m and rad, are the same line on paper."""

QUANTILES = (0.0, 0.05, 0.5, 0.95, 1.0)
THIN_RUNS = 30
"""Single runs drawn around a median path."""

SECONDS = {"start": 1.5, "apart": 0.4, "dots": 0.5}
"""Of the path: length of the magnified start, half length of the other magnified stretch, time
between dots."""

FIRST_SECONDS = 3.0
"""What the magnified start of a run shows."""


class Curve(NamedTuple):
    """One curve to draw: its look and the run behind it."""

    line: Line
    errors: Float[np.ndarray, "steps+1 batch 3"]
    wheels: Float[np.ndarray, "steps batch 2"]


def _curves(runs: Mapping[str, Any]) -> dict[str, Curve]:
    """Return the runs in drawing order; those that coincide appear once, under the name listed
    last."""
    curves: dict[str, Curve] = {}
    for name in reversed([name for name in CONTROLLERS if name in runs]):
        errors, wheels, line = (
            np.asarray(runs[name].errors),
            np.asarray(runs[name].wheels),
            CONTROLLERS[name],
        )
        twin = next((key for key, curve in curves.items() if _coincide(curve.errors, errors)), None)
        if twin is None:
            curves[name] = Curve(line, errors, wheels)
        else:
            joint = curves[twin].line
            curves[twin] = curves[twin]._replace(
                line=joint._replace(label=f"{joint.label} = {line.label}")
            )
    return dict(reversed(curves.items()))


def _coincide(first, second) -> bool:
    return first.shape == second.shape and np.allclose(first, second, rtol=0, atol=COINCIDE)


def _band(axes: Axes, time, values: Float[np.ndarray, "times batch"], line: Line) -> None:
    """Draw median, 5 to 95 % band and the extremes of many runs."""
    least, low, median, high, greatest = np.quantile(values, QUANTILES, axis=1)
    axes.fill_between(time, least, greatest, color=line.colour, alpha=0.15, linewidth=0)
    axes.fill_between(time, low, high, color=line.colour, alpha=0.3, linewidth=0)
    # Edges tell apart bands that lie on each other.
    axes.plot(time, np.stack([low, high], axis=1), color=line.colour, linewidth=0.4)
    axes.plot(time, median, color=line.colour, linestyle=line.dashes, label=line.label)


def _band_keys() -> list:
    return [
        Patch(color="0.35", alpha=0.45, linewidth=0, label="5 % to 95 % of the runs"),
        Patch(color="0.35", alpha=0.18, linewidth=0, label="all runs"),
    ]


@styled
def trajectories(problem: Problem, runs: Mapping[str, Any]) -> Figure:
    """Draw the paths in the world frame, whole and magnified at the start and where they lie
    furthest apart.

    Args:
        problem: gives the reference.
        runs: by controller's name, anything with `errors` (steps+1, batch, 3) and `wheels` (steps,
            batch, 2).
    """
    curves, reference = _curves(runs), problem.reference
    poses = reference.poses[: reference.steps + 1]
    paths = {
        name: np.asarray(world_pose(jnp.asarray(c.errors), jnp.asarray(poses[:, None])))[..., :2]
        for name, c in curves.items()
    }
    width, height = np.ptp(poses[:, :2], axis=0)
    figure = page_figure(3.7)
    panels = figure.subplot_mosaic(
        [["whole", "start", "legend"], ["whole", "apart", "legend"]],
        width_ratios=(2 * np.clip(width / height, 0.5, 1.0), 1.5, 0.9),
    )
    _whole_path(panels["whole"], curves, poses, paths)
    lateral = np.max([np.abs(np.median(c.errors[..., 1], axis=1)) for c in curves.values()], axis=0)
    seconds = {name: round(value / reference.dt) for name, value in SECONDS.items()}
    settled = min(seconds["start"], reference.steps)
    apart = settled + int(np.argmax(lateral[settled:]))
    stretches = {
        "start": ("(b) start", 0, seconds["start"]),
        "apart": (
            f"(c) around $t = {apart * reference.dt:.1f}$ s",
            apart - seconds["apart"],
            apart + seconds["apart"],
        ),
    }
    for name, (title, first, last) in stretches.items():
        stretch = np.arange(max(first, 0), min(last, reference.steps) + 1)
        _zoom(panels[name], curves, poses, paths, stretch, max(seconds["dots"], 1))
        panels[name].set_title(title)
        place = tuple(poses[0 if name == "start" else apart, :2])
        panels["whole"].plot(
            *place, marker="s", markersize=7, markerfacecolor="none", color="0.15", zorder=5
        )
        panels["whole"].annotate(title[1], place, xytext=(6, -9), textcoords="offset points")
    keys = [
        Line2D([], [], label="Reference", **REFERENCE),
        mark_key(f"every {SECONDS['dots']} s", "0.15"),
    ]
    for key in (own := line_keys(curve.line for curve in curves.values())):
        key.set_label(str(key.get_label()).replace(" = ", "\n= "))
    panels["legend"].set_axis_off()
    panels["legend"].legend(handles=own + keys, loc="center left", borderaxespad=0)
    return figure


def _whole_path(axes: Axes, curves: Mapping[str, Curve], poses, paths) -> None:
    axes.set(title="(a) whole run, medians", aspect="equal", xlabel="$x$ [m]", ylabel="$y$ [m]")
    for name, curve in curves.items():
        axes.plot(
            *np.median(paths[name], axis=1).T, color=curve.line.colour, linestyle=curve.line.dashes
        )
    axes.plot(*poses[:, :2].T, **REFERENCE)


def _zoom(axes: Axes, curves: Mapping[str, Curve], poses, paths, stretch, every: int) -> None:
    """Draw a stretch of the run: single runs, medians, and where everyone is at the same instants."""
    axes.set(xlabel="$x$ [m]", ylabel="$y$ [m]")
    # The longer side of the panel shows more than the stretch, so the lines go on beyond it.
    around = np.arange(
        max(stretch[0] - len(stretch), 0), min(stretch[-1] + len(stretch), len(poses))
    )
    instants = around[(around - stretch[0]) % every == 0]
    dots: Any = {
        "marker": "o",
        "markersize": 4,
        "markeredgecolor": "white",
        "markeredgewidth": 0.5,
        "linestyle": "",
    }
    shown = [poses[stretch, :2]]
    for name, curve in curves.items():
        path, colour, median = paths[name], curve.line.colour, np.median(paths[name], axis=1)
        axes.plot(
            *path[around, :THIN_RUNS].transpose(2, 0, 1), color=colour, linewidth=0.4, alpha=0.25
        )
        axes.plot(*median[around].T, color=colour, linestyle=curve.line.dashes)
        axes.plot(*median[instants].T, color=colour, **dots, zorder=5)
        shown.append(median[stretch])
    axes.plot(*poses[around, :2].T, **REFERENCE)
    axes.plot(*poses[instants, :2].T, color="0.15", **dots, zorder=4)
    least, greatest = np.min(shown, axis=(0, 1)), np.max(shown, axis=(0, 1))
    margin = 0.08 * np.max(greatest - least)
    axes.set_xlim(least[0] - margin, greatest[0] + margin, auto=True)
    axes.set_ylim(least[1] - margin, greatest[1] + margin, auto=True)
    axes.set_aspect("equal", adjustable="datalim")


@styled
def errors(problem: Problem, runs: Mapping[str, Any]) -> Figure:
    """Draw the tracking errors against time: all of them with the limits of E, and those that stay
    inside magnified.

    Args:
        problem: gives the limits and the period.
        runs: as for `trajectories`.
    """
    curves = _curves(runs)
    shares = {
        name: leaves_error_set(problem, curve.errors).mean() for name, curve in curves.items()
    }
    inside = {name: curve for name, curve in curves.items() if not shares[name]}
    figure = page_figure(5.6)
    panels = figure.subplots(
        3, 2 if inside and len(inside) < len(curves) else 1, sharex=True, squeeze=False
    )
    limits = problem.error_set.offsets[:3] * TO_DISPLAY
    for coordinate, row in enumerate(panels):
        for axes, shown in zip(row, (curves, inside), strict=False):
            for curve in shown.values():
                values = curve.errors[..., coordinate] * TO_DISPLAY[coordinate]
                _band(axes, np.arange(len(values)) * problem.reference.dt, values, curve.line)
            axes.margins(x=0)
        for limit in (-limits[coordinate], limits[coordinate]):
            row[0].axhline(limit, **LIMIT)
        row[0].set_ylabel(error_label(coordinate))
    titles = ("all controllers", "those that stay in $\\mathcal{E}$, magnified")
    for axes, title in zip(panels[0], titles, strict=False):
        axes.set_title(title)
    for axes in panels[-1]:
        axes.set_xlabel("time [s]")
    keys = line_keys(curve.line for curve in curves.values())
    for key, share in zip(keys, shares.values(), strict=True):
        key.set_label(
            f"{key.get_label()} ({100 * share:.0f} % leave $\\mathcal{{E}}$)"
            if share
            else key.get_label()
        )
    bottom_legend(
        figure, [*keys, Line2D([], [], label="limits of $\\mathcal{E}$", **LIMIT), *_band_keys()]
    )
    return figure


@styled
def wheel_speeds(problem: Problem, runs: Mapping[str, Any]) -> Figure:
    """Draw the wheel speeds against time, the whole run and its start, with those of the reference.

    Args:
        problem: gives the reference, the wheel limits and the period.
        runs: as for `trajectories`.
    """
    curves, steps = _curves(runs), problem.reference.steps
    figure = page_figure(4.2)
    panels = figure.subplots(2, 2, sharex="col", sharey=True, width_ratios=(1.7, 1))
    time = np.arange(steps) * problem.reference.dt
    for wheel, row in enumerate(panels):
        for axes, end in zip(row, (steps * problem.reference.dt, FIRST_SECONDS), strict=True):
            shown = time <= end
            for curve in curves.values():
                _band(axes, time[shown], curve.wheels[shown, :, wheel], curve.line)
            axes.step(
                time[shown], problem.schedule[:steps][shown, wheel], where="post", **REFERENCE
            )
            axes.set_xlim(0, end)
        row[0].set_ylabel(f"{('right', 'left')[wheel]} wheel [m/s]")
    _wheel_limits(problem, panels)
    panels[0, 0].set_title("whole run")
    panels[0, 1].set_title(f"first {FIRST_SECONDS:.0f} s")
    for axes in panels[1]:
        axes.set_xlabel("time [s]")
    keys = [
        *line_keys(curve.line for curve in curves.values()),
        Line2D([], [], label="Reference", **REFERENCE),
        *_band_keys(),
    ]
    bottom_legend(figure, keys)
    return figure


def _wheel_limits(problem: Problem, panels) -> None:
    """Draw the wheel limits that the curves come near, leaving the range of the axes as it is."""
    low, high = panels[0, 0].get_ylim()
    for limit in (problem.robot.wheel_speed_min, problem.robot.wheel_speed_max):
        if low <= limit <= high:
            for axes in panels.flat:
                axes.axhline(limit, **LIMIT)


@styled
def margins(problem: Problem, runs: Mapping[str, Any]) -> Figure:
    """Draw how near each run came to the limits of E: the distribution of 1 - max |e| / limit over
    realisations.

    Args:
        problem: gives the limits and the period.
        runs: as for `trajectories`.
    """
    curves, limits = _curves(runs), problem.error_set.offsets[:3]
    settled = round(TRANSIENT_S / problem.reference.dt)
    figure = page_figure(0.9 + 0.42 * len(curves))
    panels = figure.subplots(1, 3, sharey=True)
    for coordinate, axes in enumerate(panels):
        for place, curve in enumerate(curves.values()):
            relative = 100 * (1 - np.abs(curve.errors[..., coordinate]) / limits[coordinate])
            _box(axes, relative.min(axis=0), place - 0.17, curve.line.colour, filled=True)
            if settled < len(relative):
                _box(
                    axes,
                    relative[settled:].min(axis=0),
                    place + 0.17,
                    curve.line.colour,
                    filled=False,
                )
        axes.axvline(0, **LIMIT)
        axes.axvline(
            100 * (1 - np.abs(problem.initial_error[coordinate]) / limits[coordinate]), **REFERENCE
        )
        axes.set_xlim(right=104)
        axes.axvspan(min(axes.get_xlim()[0], -5), 0, color="0.5", alpha=0.15, linewidth=0)
        axes.margins(x=0)
        axes.set_xlabel(f"margin in ${ERRORS[coordinate]}$ [%]")
    panels[0].set_yticks(
        range(len(curves)), [curve.line.label.replace(" = ", "\n= ") for curve in curves.values()]
    )
    panels[0].invert_yaxis()
    keys = [
        Patch(facecolor="0.4", edgecolor="0.4", label="whole run"),
        Patch(facecolor="white", edgecolor="0.4", label=f"after the first {TRANSIENT_S:.0f} s"),
        Patch(color="0.5", alpha=0.15, linewidth=0, label="outside $\\mathcal{E}$"),
        Line2D([], [], label="margin of the start", **REFERENCE),
    ]
    bottom_legend(figure, keys, columns=4)
    return figure


def _box(
    axes: Axes, values: Float[np.ndarray, " runs"], place: float, colour: str, filled: bool
) -> None:
    """Draw quartiles as a box, the median as a bar and the extremes as whiskers."""
    axes.boxplot(
        values,
        positions=[place],
        orientation="horizontal",
        widths=0.26,
        whis=(0, 100),
        patch_artist=True,
        manage_ticks=False,
        boxprops={
            "facecolor": colour if filled else "white",
            "edgecolor": colour,
            "linewidth": 0.9,
        },
        medianprops={"color": "black", "linewidth": 1.2},
        whiskerprops={"color": colour},
        capprops={"color": colour},
    )
