"""Closed-loop figures: paths, errors, wheel speeds, margins to E, and runs under stress, over many realisations.

Bands are pointwise in time: median, 5 to 95 % of the realisations, and the extremes. Controllers whose errors agree
to within `COINCIDE` are drawn once, under a joint name, so that no curve hides another.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from jaxtube.design.problem import Problem
from jaxtube.error_dynamics import world_pose
from jaxtube.experiments.metrics import TRANSIENT_S
from jaxtube.experiments.style import (
    CONTROLLERS,
    LIMIT,
    REFERENCE,
    TO_DISPLAY,
    Line,
    draw_polygon,
    error_label,
    page_figure,
    styled,
)

COINCIDE = 1e-5
"""Errors closer than this, m and rad, are the same line on paper."""

QUANTILES = (0.0, 0.05, 0.5, 0.95, 1.0)
THIN_RUNS = 30
"""Single runs drawn around a median path."""

ZOOM = 0.5
"""Half width of a magnified piece of the path, m."""

DOT_SECONDS = 0.5
"""Time between the dots on a magnified piece of the path."""

FIRST_SECONDS = 3.0
"""What the magnified start of a run shows."""

STRESSED = {"plain": "plain_mpc", "tube": "tube_mpc"}
MARKS = {"plain": {"marker": "o", "markersize": 2.2, "markeredgewidth": 0}, "tube": {"marker": "x", "markersize": 2.6}}
"""Marks of the starts whose run leaves E: a cross stays visible on a dot."""


class Curve(NamedTuple):
    """One curve to draw: its look and the run behind it."""

    line: Line
    errors: Float[np.ndarray, "steps+1 batch 3"]
    wheels: Float[np.ndarray, "steps batch 2"]


def _curves(runs: Mapping[str, Any]) -> dict[str, Curve]:
    """Return the runs in drawing order; those that coincide appear once, under the name listed last."""
    curves: dict[str, Curve] = {}
    for name in reversed([name for name in CONTROLLERS if name in runs]):
        errors, wheels, line = np.asarray(runs[name].errors), np.asarray(runs[name].wheels), CONTROLLERS[name]
        twin = next((key for key, curve in curves.items() if _coincide(curve.errors, errors)), None)
        if twin is None:
            curves[name] = Curve(line, errors, wheels)
        else:
            joint = curves[twin].line
            curves[twin] = curves[twin]._replace(line=joint._replace(label=f"{joint.label} = {line.label}"))
    return dict(reversed(curves.items()))


def _coincide(first, second) -> bool:
    return first.shape == second.shape and np.allclose(first, second, rtol=0, atol=COINCIDE)


def _outside(problem: Problem, errors: Float[np.ndarray, "steps+1 batch 3"]) -> np.ndarray:
    """Tell which runs leave E; NaN is outside."""
    return ~np.all(np.abs(errors) <= problem.error_set.offsets[:3], axis=(0, 2))


def _band(axes: Axes, time, values: Float[np.ndarray, "times batch"], line: Line) -> None:
    """Draw median, 5 to 95 % band and the extremes of many runs."""
    least, low, median, high, greatest = np.quantile(values, QUANTILES, axis=1)
    axes.fill_between(time, least, greatest, color=line.colour, alpha=0.15, linewidth=0)
    axes.fill_between(time, low, high, color=line.colour, alpha=0.3, linewidth=0)
    # Edges tell apart bands that lie on each other.
    axes.plot(time, np.stack([low, high], axis=1), color=line.colour, linewidth=0.4)
    axes.plot(time, median, color=line.colour, linestyle=line.dashes, label=line.label)


def _legend(figure: Figure, handles: list, columns: int = 3) -> None:
    figure.legend(handles=handles, loc="outside lower center", ncols=columns)


def _keys(curves: Mapping[str, Curve]) -> list:
    return [Line2D([], [], color=c.line.colour, linestyle=c.line.dashes, label=c.line.label) for c in curves.values()]


def _band_keys() -> list:
    return [
        Patch(color="0.35", alpha=0.45, linewidth=0, label="5 % to 95 % of the runs"),
        Patch(color="0.35", alpha=0.18, linewidth=0, label="all runs"),
    ]


@styled
def trajectories(problem: Problem, runs: Mapping[str, Any]) -> Figure:
    """Draw the paths in the world frame, whole and magnified at the start and where they lie furthest apart.

    Args:
        problem: gives the reference.
        runs: by controller's name, anything with `errors` (steps+1, batch, 3) and `wheels` (steps, batch, 2).
    """
    curves, reference = _curves(runs), problem.reference
    poses = reference.poses[: reference.steps + 1]
    paths = {name: np.asarray(world_pose(c.errors, poses[:, None]))[..., :2] for name, c in curves.items()}
    width, height = np.ptp(poses[:, :2], axis=0)
    figure = page_figure(3.7)
    panels = figure.subplot_mosaic(
        [["whole", "start", "legend"], ["whole", "apart", "legend"]],
        width_ratios=(2 * np.clip(width / height, 0.5, 1.0), 1.5, 0.9),
    )
    _whole_path(panels["whole"], curves, poses, paths)
    lateral = np.max([np.abs(np.median(c.errors[..., 1], axis=1)) for c in curves.values()], axis=0)
    settled = min(round(FIRST_SECONDS / reference.dt), reference.steps)
    apart = settled + int(np.argmax(lateral[settled:]))
    every = max(round(DOT_SECONDS / reference.dt), 1)
    for panel, title, step in (
        ("start", "(b) start", 0),
        ("apart", f"(c) around $t = {apart * reference.dt:.1f}$ s", apart),
    ):
        _zoom(panels[panel], curves, poses, paths, step, every)
        panels[panel].set_title(title)
        panels["whole"].plot(*poses[step, :2], "s", markersize=7, markerfacecolor="none", color="0.15", zorder=5)
        panels["whole"].annotate(title[1], poses[step, :2], xytext=(6, -9), textcoords="offset points")
    keys = [Line2D([], [], label="Reference", **REFERENCE)]
    keys.append(
        Line2D([], [], marker="o", color="0.15", linestyle="none", markersize=4, label=f"every {DOT_SECONDS} s")
    )
    for key in (own := _keys(curves)):
        key.set_label(str(key.get_label()).replace(" = ", "\n= "))
    panels["legend"].set_axis_off()
    panels["legend"].legend(handles=own + keys, loc="center left", borderaxespad=0)
    return figure


def _whole_path(axes: Axes, curves: Mapping[str, Curve], poses, paths) -> None:
    axes.set(title="(a) whole run, medians", aspect="equal", xlabel="$x$ [m]", ylabel="$y$ [m]")
    for name, curve in curves.items():
        axes.plot(*np.median(paths[name], axis=1).T, color=curve.line.colour, linestyle=curve.line.dashes)
    axes.plot(*poses[:, :2].T, **REFERENCE)


def _zoom(axes: Axes, curves: Mapping[str, Curve], poses, paths, step: int, every: int) -> None:
    """Draw the stretch around one step: single runs, medians, and where everyone is at the same instants."""
    axes.set(xlabel="$x$ [m]", ylabel="$y$ [m]")
    travelled = np.linalg.norm(np.diff(poses[:, :2], axis=0, prepend=poses[:1, :2]), axis=1).cumsum()
    near = np.flatnonzero(np.abs(travelled - travelled[step]) < 8 * ZOOM)
    instants = near[(near - step) % every == 0]
    dots = dict(marker="o", markersize=4, markeredgecolor="white", markeredgewidth=0.5, linestyle="none")
    for name, curve in curves.items():
        path, colour, median = paths[name], curve.line.colour, np.median(paths[name], axis=1)
        axes.plot(*path[near, :THIN_RUNS].transpose(2, 0, 1), color=colour, linewidth=0.4, alpha=0.25)
        axes.plot(*median[near].T, color=colour, linestyle=curve.line.dashes)
        axes.plot(*median[instants].T, color=colour, **dots, zorder=5)
    axes.plot(*poses[near, :2].T, **REFERENCE)
    axes.plot(*poses[instants, :2].T, color="0.15", **dots, zorder=4)
    middle = np.median([poses[step, :2], *(np.median(path[step], axis=0) for path in paths.values())], axis=0)
    if step == 0:
        middle = middle + 2 * ZOOM * np.array([np.cos(poses[0, 2]), np.sin(poses[0, 2])]) + [0, 0.5 * ZOOM]
    # The longer side of the panel shows more, at the same scale.
    axes.set_xlim(*(middle[0] + ZOOM * np.array([-1, 1])), auto=True)
    axes.set_ylim(*(middle[1] + ZOOM * np.array([-1, 1])), auto=True)
    axes.set_aspect("equal", adjustable="datalim")


@styled
def errors(problem: Problem, runs: Mapping[str, Any]) -> Figure:
    """Draw the tracking errors against time: all of them with the limits of E, and those that stay inside magnified.

    Args:
        problem: gives the limits and the period.
        runs: as for `trajectories`.
    """
    curves = _curves(runs)
    shares = {name: _outside(problem, curve.errors).mean() for name, curve in curves.items()}
    inside = {name: curve for name, curve in curves.items() if not shares[name]}
    figure = page_figure(5.6)
    panels = figure.subplots(3, 2 if inside and len(inside) < len(curves) else 1, sharex=True, squeeze=False)
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
    for axes, title in zip(
        panels[0], ("all controllers", "those that stay in $\\mathcal{E}$, magnified"), strict=False
    ):
        axes.set_title(title)
    for axes in panels[-1]:
        axes.set_xlabel("time [s]")
    keys = _keys(curves)
    for key, share in zip(keys, shares.values(), strict=True):
        key.set_label(f"{key.get_label()} ({100 * share:.0f} % leave $\\mathcal{{E}}$)" if share else key.get_label())
    _legend(figure, [*keys, Line2D([], [], label="limits of $\\mathcal{E}$", **LIMIT), *_band_keys()])
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
            axes.step(time[shown], problem.schedule[:steps][shown, wheel], where="post", **REFERENCE)
            axes.set_xlim(0, end)
        row[0].set_ylabel(f"{('right', 'left')[wheel]} wheel [m/s]")
    _wheel_limits(problem, panels)
    panels[0, 0].set_title("whole run")
    panels[0, 1].set_title(f"first {FIRST_SECONDS:.0f} s")
    for axes in panels[1]:
        axes.set_xlabel("time [s]")
    keys = [*_keys(curves), Line2D([], [], label="Reference", **REFERENCE), *_band_keys()]
    _legend(figure, keys)
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
    """Draw how near each run came to the limits of E: the distribution of 1 - max |e| / limit over realisations.

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
            look = dict(color=curve.line.colour, linewidth=1.0)
            _box(axes, relative.min(axis=0), place - 0.17, {**look, "facecolor": curve.line.colour})
            if settled < len(relative):
                _box(axes, relative[settled:].min(axis=0), place + 0.17, {**look, "facecolor": "white"})
        axes.axvline(0, **LIMIT)
        axes.axvline(100 * (1 - np.abs(problem.initial_error[coordinate]) / limits[coordinate]), **REFERENCE)
        axes.set_xlim(right=104)
        axes.axvspan(min(axes.get_xlim()[0], -5), 0, color="0.5", alpha=0.15, linewidth=0)
        axes.margins(x=0)
        axes.set_xlabel(f"margin in {error_label(coordinate).split(' ')[0]} [%]")
    panels[0].set_yticks(range(len(curves)), [curve.line.label.replace(" = ", "\n= ") for curve in curves.values()])
    panels[0].invert_yaxis()
    keys = [Patch(facecolor="0.4", edgecolor="0.4", label="whole run")]
    keys.append(Patch(facecolor="white", edgecolor="0.4", label=f"after the first {TRANSIENT_S:.0f} s"))
    keys.append(Patch(color="0.5", alpha=0.15, linewidth=0, label="outside $\\mathcal{E}$"))
    keys.append(Line2D([], [], label="margin of the start", **REFERENCE))
    _legend(figure, keys, columns=4)
    return figure


def _box(axes: Axes, values: Float[np.ndarray, " runs"], place: float, look: dict) -> None:
    """Draw quartiles as a box, the median as a bar and the extremes as whiskers."""
    colour = look["color"]
    axes.boxplot(
        values,
        positions=[place],
        orientation="horizontal",
        widths=0.26,
        whis=(0, 100),
        patch_artist=True,
        manage_ticks=False,
        boxprops={"facecolor": look["facecolor"], "edgecolor": colour, "linewidth": 0.9},
        medianprops={"color": "black", "linewidth": 1.2},
        whiskerprops={"color": colour},
        capprops={"color": colour},
    )


@styled
def stress(problem: Problem, cases: Sequence[Mapping[str, Any]], boundary: Float[np.ndarray, "k 3"]) -> Figure:
    """Draw tube MPC against MPC without tube from starts all over the feasible set, one row a case.

    Args:
        problem: gives the limits and the period.
        cases: each with `title` and the errors (steps+1, batch, 3) `tube` and `plain` from the same starts.
        boundary: points on the boundary of the feasible set.
    """
    figure = page_figure(0.9 + 1.55 * len(cases))
    panels = figure.subplots(len(cases), 5, sharex="col", sharey="col", squeeze=False, width_ratios=(1, 1, 1, 1.1, 1.1))
    dt, limits = problem.reference.dt, problem.error_set.offsets[:3] * TO_DISPLAY
    shown = round(max(FIRST_SECONDS, 1.2 * dt * max(_last_exit(problem, case) for case in cases)) / dt) + 1
    for row, case in zip(panels, cases, strict=True):
        for coordinate, axes in enumerate(row[:3]):
            for kind, name in STRESSED.items():
                values = np.abs(case[kind][:shown, :, coordinate]) * TO_DISPLAY[coordinate]
                _tail(axes, np.arange(len(values)) * dt, values, CONTROLLERS[name])
            axes.axhline(limits[coordinate], **LIMIT)
            axes.text(
                0.95, 0.78, error_label(coordinate, absolute=True), transform=axes.transAxes, ha="right", va="top"
            )
            axes.set(xlim=(0, (shown - 1) * dt), ylim=(0, 1.2 * limits[coordinate]))
            axes.locator_params(axis="x", nbins=4)
        for axes, plane in zip(row[3:], ((0, 1), (1, 2)), strict=True):
            _starts(axes, problem, case, boundary, plane)
        # A title reserves the line; the text itself runs on over the whole row.
        row[0].set_title(" ")
        row[0].text(0, 1.05, _verdict(problem, case), transform=row[0].transAxes, in_layout=False)
    for axes, label in zip(panels[-1], ["time [s]"] * 3 + [f"start: {error_label(i)}" for i in (0, 1)], strict=True):
        axes.set_xlabel(label)
    _legend(figure, _stress_keys(), columns=4)
    return figure


def _last_exit(problem: Problem, case: Mapping[str, Any]) -> int:
    """Return the last step at which a run is outside E, 0 where none ever is."""
    limits = problem.error_set.offsets[:3]
    outside = [~np.all(np.abs(case[kind]) <= limits, axis=(1, 2)) for kind in STRESSED]
    return int(np.max(np.nonzero(np.any(outside, axis=0))[0], initial=0))


def _tail(axes: Axes, time, values: Float[np.ndarray, "times batch"], line: Line) -> None:
    """Draw the median, the 95 % quantile and the greatest of absolute errors, the band between the last two filled."""
    median, high, greatest = np.quantile(values, (0.5, 0.95, 1.0), axis=1)
    axes.fill_between(time, high, greatest, color=line.colour, alpha=0.25, linewidth=0)
    axes.plot(time, np.stack([median, high], axis=1), color=line.colour, linewidth=0.6, linestyle=line.dashes)
    axes.plot(time, greatest, color=line.colour, linestyle=line.dashes)


def _starts(axes: Axes, problem: Problem, case: Mapping[str, Any], boundary, plane: tuple[int, int]) -> None:
    """Mark the starts from which each controller leaves E, in the plane of two errors."""
    starts, corners = (points[:, plane] * TO_DISPLAY[list(plane)] for points in (case["plain"][0], boundary))
    draw_polygon(axes, corners, edgecolor="0.4", facecolor="0.95", linewidth=0.8)
    axes.plot(*starts.T, ".", color="0.7", markersize=1.2, rasterized=True)
    for kind, name in STRESSED.items():
        left = starts[_outside(problem, case[kind])]
        axes.plot(*left.T, **MARKS[kind], color=CONTROLLERS[name].colour, linestyle="none", rasterized=True)
    axes.set_ylabel(error_label(plane[1]), labelpad=0)


def _verdict(problem: Problem, case: Mapping[str, Any]) -> str:
    counts = [f"{CONTROLLERS[STRESSED[k]].label} in {_outside(problem, case[k]).sum():,}" for k in STRESSED]
    return f"{case['title']}:  $\\mathcal{{E}}$ left by {', by '.join(counts)} of {case['plain'].shape[1]:,} runs"


def _stress_keys() -> list:
    lines = {kind: CONTROLLERS[name] for kind, name in STRESSED.items()}
    return [
        *(Line2D([], [], color=line.colour, linestyle=line.dashes, label=line.label) for line in lines.values()),
        Line2D([], [], color="0.35", linewidth=1.2, label="greatest of all runs"),
        Line2D([], [], color="0.35", linewidth=0.6, label="95 % quantile, median"),
        *(
            Line2D(
                [],
                [],
                **MARKS[kind],
                color=line.colour,
                linestyle="none",
                label=f"{line.label} leaves $\\mathcal{{E}}$",
            )
            for kind, line in lines.items()
        ),
        Line2D([], [], label="limits of $\\mathcal{E}$", **LIMIT),
        Patch(facecolor="0.95", edgecolor="0.4", label="feasible set, projected"),
    ]
