"""Figures of a worst case: the run that comes nearest to a limit with what drove it there, and the
tube it left."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from jaxtube.experiments.falsify.report import CAPS
from jaxtube.experiments.figures.sets import IN_MILLIMETRES, SMALL_UNITS
from jaxtube.experiments.figures.style import (
    CONTROLLERS,
    LIMIT,
    REFERENCE,
    TO_DISPLAY,
    bottom_legend,
    draw_polygon,
    error_label,
    mark_key,
    page_figure,
    styled,
)
from jaxtube.falsification.search import Worst
from jaxtube.plant.error_dynamics import world_pose
from jaxtube.simulation.usage import Replay, values_of
from jaxtube.synthesis.design import Design
from jaxtube.synthesis.problem import Problem

RUN, ATTACKED, SEARCHED, DRAWN = CONTROLLERS["tube_mpc"].colour, "#D55E00", "#D55E00", "0.45"
BOUNDS = LinearSegmentedColormap.from_list("bounds", ["#8073AC", "#F7F7F7", "#E08214"])
BEFORE_S, AFTER_S = 2.0, 0.6
"""Seconds of the path that are shown before and after the worst step."""
ATTACK_S = 10.0
"""Seconds of the attack that are shown before the worst step."""

ROWS = {
    "true": ("slip, right", "slip, left"),
    "measured": ("measured slip, right", "measured slip, left"),
    "disturbance": ("$w_x$", "$w_y$", "$w_\\theta$"),
    "noise": ("noise in $e_x$", "noise in $e_y$", "noise in $e_\\theta$"),
}


class Track(NamedTuple):
    """One quantity against time with the two facets that bound it, in display units."""

    label: str
    values: Float[np.ndarray, " times"]
    upper: float
    lower: float
    facets: tuple[int, int]


def _tracks(problem: Problem, name: str, played: Replay) -> list[Track]:
    """Return what the limit bounds; for a tube the errors of the lap up to the plan."""
    lap = played.trajectory
    if name in ("error", "tube"):
        limits = problem.error_set.offsets[:3] * TO_DISPLAY
        values = lap.errors[:, 0] * TO_DISPLAY
        return [
            Track(error_label(i), values[:, i], limits[i], -limits[i], (i, i + 3)) for i in range(3)
        ]
    values = values_of(name, played)
    if name == "input":
        values, bounds = values @ problem.input_set.normals[:2].T, problem.input_set.offsets
        labels = [f"{side} wheel's deficit [m/s]" for side in ("right", "left")]
        if problem.scenario.operating.yaw_rate_deficit_radps is not None:
            labels = [f"{what} [{unit}]" for what, unit in CAPS]
    else:
        bounds = np.repeat([problem.robot.wheel_speed_max, -problem.robot.wheel_speed_min], 2)
        labels = [f"{side} wheel [m/s]" for side in ("right", "left")]
    return [
        Track(label, values[:, i], bounds[i], -bounds[i + 2], (i, i + 2))
        for i, label in enumerate(labels)
    ]


@styled
def worst_run(problem: Problem, name: str, worst: Worst, played: Replay, reaches=None) -> Figure:
    """Draw the run that comes nearest to a limit: what the limit bounds, the path around the worst
    step, the attack.

    Args:
        problem: gives the limits, the reference and the period.
        name: the limit.
        worst, played: the worst case and its replay.
        reaches: greatest usage by step and facet that the search met, and that drawn laps met, by
            limit.
    """
    tracks, dt = _tracks(problem, name, played), problem.reference.dt
    strips = _strips(worst)
    figure = page_figure(3.3 + 0.16 * len(strips))
    parts: Any = figure.subfigures(1, 2, width_ratios=(1.15, 1))
    left, right = parts
    panels = left.subplots(len(tracks), 1, sharex=True)
    last = worst.step if name == "tube" else len(tracks[0].values) - 1
    for axes, track in zip(panels, tracks, strict=True):
        _draw_track(axes, track, name, worst, dt, last, reaches)
    panels[-1].set_xlabel("time [s]")
    path, attack = right.subplots(2, 1, height_ratios=(3, 0.35 + 0.33 * len(strips)))
    _draw_path(path, problem, worst, played)
    _draw_attack(attack, strips, worst, dt, problem.reference.steps)
    _legend(figure, name, reaches is not None)
    return figure


def _draw_track(
    axes: Axes, track: Track, name: str, worst: Worst, dt: float, last: int, reaches
) -> None:
    time = np.arange(len(track.values)) * dt
    if reaches is not None:
        for reach, colour in zip(reaches, (SEARCHED, DRAWN), strict=True):
            middle = (track.upper + track.lower) / 2
            above, below = (
                reach[name][:, facet] * (track.upper - middle) for facet in track.facets
            )
            # Errors are judged after each period, inputs during it.
            instants = time[-len(above) :]
            axes.fill_between(
                instants, middle - below, middle + above, color=colour, alpha=0.28, linewidth=0
            )
    axes.plot(time[: last + 1], track.values[: last + 1], color=RUN)
    for bound in (track.upper, track.lower):
        axes.axhline(bound, **LIMIT)
    axes.axvline(worst.step * dt, color=ATTACKED, linewidth=0.8)
    if name != "tube" and worst.facet in track.facets:
        axes.plot(
            worst.step * dt, track.values[worst.step], "o", color=ATTACKED, markersize=4, zorder=5
        )
    axes.set_ylabel(track.label)
    axes.margins(x=0.01)


def _draw_path(axes: Axes, problem: Problem, worst: Worst, played: Replay) -> None:
    """Draw reference and robot around the worst step, joined at that step."""
    dt, steps = problem.reference.dt, problem.reference.steps
    poses = problem.reference.poses[: steps + 1]
    first, last = (
        max(worst.step - round(BEFORE_S / dt), 0),
        min(worst.step + round(AFTER_S / dt), steps),
    )
    robot = np.asarray(world_pose(jnp.asarray(played.trajectory.errors[:, 0]), jnp.asarray(poses)))
    dots: Any = {"marker": "o", "markersize": 2.5}
    axes.plot(*poses[first : last + 1, :2].T, **{**REFERENCE, **dots})
    axes.plot(*robot[first : last + 1, :2].T, color=RUN, **dots)
    joined = np.stack([poses[worst.step, :2], robot[worst.step, :2]])
    axes.plot(*joined.T, color=ATTACKED, marker="o", markersize=4, zorder=5)
    axes.set(xlabel="$x$ [m]", ylabel="$y$ [m]")
    axes.set_title(f"path, {first * dt:.1f} to {last * dt:.1f} s, a dot each {dt:g} s")
    axes.set_aspect("equal", adjustable="datalim")


def _strips(worst: Worst) -> list[tuple[str, np.ndarray]]:
    """Return what varies, by component, each from -1 to 1."""
    found = []
    for key, labels in ROWS.items():
        if key in worst.attack:
            values = worst.attack[key]
            scale = np.max(np.abs(values), axis=0) if key == "disturbance" else np.ones(len(labels))
            found += [(label, values[:, i] / (scale[i] or 1.0)) for i, label in enumerate(labels)]
    return found


def _draw_attack(axes: Axes, strips, worst: Worst, dt: float, steps: int) -> None:
    """Draw the deviations as strips: full colour is a bound."""
    for row, (_, values) in enumerate(strips):
        values = values[:steps]
        edges = np.linspace(0, steps * dt, len(values) + 1)
        axes.pcolormesh(
            edges,
            [row - 0.4, row + 0.4],
            values[None],
            cmap=BOUNDS,
            vmin=-1,
            vmax=1,
            rasterized=True,
        )
    axes.axvline(worst.step * dt, color="0.1", linewidth=0.9)
    axes.set_yticks(range(len(strips)), [label for label, _ in strips])
    worst_time = worst.step * dt
    shown = (
        max(worst_time - ATTACK_S, 0),
        min(max(worst_time, ATTACK_S / 10) + ATTACK_S / 10, steps * dt),
    )
    axes.set(xlabel="time [s]", xlim=shown, ylim=(len(strips) - 0.5, -0.5))
    axes.grid(visible=False)


def _legend(figure: Figure, name: str, reached: bool) -> None:
    keys: list[Any] = [
        Line2D([], [], color=RUN, label="worst run"),
        Line2D([], [], label="reference", **REFERENCE),
        Line2D([], [], label="limits" if name != "tube" else "limits of $\\mathcal{E}$", **LIMIT),
        Line2D([], [], color=ATTACKED, linewidth=0.8, marker="o", markersize=4, label="worst step"),
        Patch(color=BOUNDS(1.0), label="deviation at its upper bound"),
        Patch(color=BOUNDS(0.0), label="at its lower bound"),
    ]
    if reached:
        keys.append(Patch(color=SEARCHED, alpha=0.28, linewidth=0, label="all runs of the search"))
        keys.append(Patch(color=DRAWN, alpha=0.4, linewidth=0, label="all drawn laps, equal time"))
    bottom_legend(figure, keys, columns=4)


@styled
def worst_section(design: Design, worst: Worst, played: Replay) -> Figure:
    """Draw the deviation from the plan that goes furthest, in the section of its stage and along
    its facet.

    Args:
        design: gives the tube in use; of `sequence` that of the widest window.
        worst, played: the worst case of the limit `tube` and its replay.
    """
    sections = design.tubes[design.problem.scenario.controller.tube]
    stage = worst.step - worst.when
    deviations = values_of("tube", played)
    polytope = sections[stage].polytope()
    normal, offset = polytope.normals[worst.facet], polytope.offsets[worst.facet]
    figure = page_figure(2.9)
    panels = figure.subplots(1, 3, width_ratios=(1, 1, 0.9))
    corners, path = sections[stage].vertices() * IN_MILLIMETRES, deviations * IN_MILLIMETRES
    for axes, plane in zip(panels, ((0, 1), (1, 2)), strict=False):
        on_facet = np.abs(sections[stage].vertices() @ normal - offset) <= 1e-9
        draw_polygon(axes, corners[:, plane], edgecolor="0.1", facecolor="0.94", linewidth=1.0)
        draw_polygon(
            axes,
            corners[on_facet][:, plane],
            edgecolor=ATTACKED,
            facecolor="#D55E0033",
            linewidth=1.0,
        )
        axes.plot(*path[: stage + 1, plane].T, color=RUN, marker="o", markersize=2.5)
        axes.plot(*path[stage, plane], "o", color=ATTACKED, markersize=4.5, zorder=5)
        for j in range(1, stage + 1):
            axes.annotate(
                str(j), path[j, plane], xytext=(3, 3), textcoords="offset points", fontsize=7
            )
        axes.set_xlabel(error_label(plane[0], unit=SMALL_UNITS[plane[0]]))
        axes.set_ylabel(error_label(plane[1], unit=SMALL_UNITS[plane[1]]), labelpad=1)
        axes.margins(0.12)
    panels[0].set_title(f"$R_{{{stage}}}$ and the deviation")
    stages = np.arange(1, len(sections))
    polytopes = [section.polytope() for section in sections[1:]]
    usage = [
        np.max(p.normals @ deviations[j] / p.offsets)
        for j, p in zip(stages, polytopes, strict=True)
    ]
    colours = [ATTACKED if share > 1 else RUN for share in usage]
    panels[2].bar(stages, 100 * np.array(usage), color=colours, width=0.6)
    panels[2].axhline(100, **LIMIT)
    panels[2].set(xlabel="stage $j$", ylabel="nearest facet of $R_j$ used [%]", xticks=stages)
    keys = [
        Line2D(
            [], [], color=RUN, marker="o", markersize=2.5, label="$e - \\bar e$ after $j$ steps"
        ),
        mark_key("worst stage", ATTACKED),
        Patch(facecolor="#D55E0033", edgecolor=ATTACKED, label="the facet"),
        Patch(facecolor="0.94", edgecolor="0.1", label=f"$R_{{{stage}}}$, projected"),
    ]
    bottom_legend(figure, keys, columns=4)
    return figure
