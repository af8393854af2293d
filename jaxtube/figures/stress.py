"""The figure of runs under stress: tube MPC against MPC without tube, from starts all over the
feasible set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from jaxtube.coordinates import TO_DISPLAY
from jaxtube.figures.curves import quantiles
from jaxtube.figures.style import (
    CONTROLLERS,
    LIMIT,
    Line,
    bottom_legend,
    draw_line,
    draw_polygon,
    error_label,
    line_key,
    line_keys,
    mark_key,
    page_figure,
    styled,
)
from jaxtube.synthesis.problem import Problem

FIRST_SECONDS = 3.0
"""What is shown of each run, or more where a run leaves E later."""
MOST_STARTS = 2000
"""Starts that are drawn of each case; those from which a run leaves E come on top."""
PLANE = [1, 2]
"""The errors whose plane shows the starts: e_y and e_theta."""

QUANTILES = (0.5, 0.95, 1.0)
"""Of the runs at each step, which are drawn."""

STRESSED = {"plain": "plain_mpc", "tube": "tube_mpc"}
MARKS: dict[str, dict[str, Any]] = {
    "plain": {"marker": "o", "markersize": 2.6, "markeredgewidth": 0},
    "tube": {"marker": "x", "markersize": 3.0, "markeredgewidth": 0.8},
}
"""Marks of the starts whose run leaves E: a cross stays visible on a dot."""


class Runs(NamedTuple):
    """The runs of one controller in one case."""

    tail: Float[np.ndarray, "3 steps+1"]  # of the largest |error| over its limit: QUANTILES
    leaves: Bool[np.ndarray, " batch"]  # E; NaN is outside
    last_exit: int  # last step at which a run is outside E, 0 where none ever is


class StressedCase(NamedTuple):
    """The runs of both controllers in one case, `plain` and `tube`, from the same starts."""

    title: str
    starts: Float[np.ndarray, "batch 3"]  # m, m, rad
    runs: Mapping[str, Runs]


@styled
def stress(
    problem: Problem, cases: Sequence[StressedCase], boundary: Float[np.ndarray, "k 3"]
) -> Figure:
    """Draw tube MPC against MPC without tube from starts all over the feasible set, one column a
    case.

    Args:
        problem: gives the reference and the period.
        cases: from `judge_case`.
        boundary: points on the boundary of the feasible set.
    """
    dt = problem.reference.dt
    figure = page_figure(5.2)
    usages, starts = figure.subplots(2, len(cases), sharex="row", sharey="row", squeeze=False)
    last_exit = max(int(runs.last_exit) for case in cases for runs in case.runs.values())
    shown = min(round(max(FIRST_SECONDS / dt, 1.2 * last_exit)), problem.reference.steps)
    for axes, case in zip(usages, cases, strict=True):
        for kind, name in STRESSED.items():
            _draw_tail(axes, dt, case.runs[kind].tail[:, : shown + 1], CONTROLLERS[name])
        axes.axhline(100, **LIMIT)
        axes.set(xlim=(0, shown * dt), xlabel="time [s]")
        axes.set_title(f"{case.title}\n{_count(case.runs)}")
    for axes, case in zip(starts, cases, strict=True):
        _draw_starts(axes, case.starts, boundary, case.runs)
        axes.set_xlabel(f"start: {error_label(PLANE[0])}")
    usages[0].set_ylim(bottom=0)
    usages[0].set_ylabel("largest share of a limit of $\\mathcal{E}$ [%]")
    starts[0].set_ylabel(f"start: {error_label(PLANE[1])}")
    bottom_legend(figure, _keys(), columns=3)
    return figure


def judge_case(
    title: str,
    limits: Float[np.ndarray, "3"],
    errors: Mapping[str, Float[np.ndarray, "steps+1 batch 3"]],
) -> StressedCase:
    """Return what is drawn of a case.

    Args:
        title: of the case.
        limits: half widths of E.
        errors: of the runs, `plain` and `tube`.
    """
    starts = errors["plain"][0]
    return StressedCase(title, starts, {kind: _judge(limits, errors[kind]) for kind in STRESSED})


def _judge(limits: Float[np.ndarray, "3"], errors: Float[np.ndarray, "steps+1 batch 3"]) -> Runs:
    usage = np.abs(errors[..., 0]) / limits[0]
    # Coordinate by coordinate: many runs at once are some hundred megabytes.
    for coordinate in (1, 2):
        np.maximum(usage, np.abs(errors[..., coordinate]) / limits[coordinate], out=usage)
    is_inside = usage <= 1
    outside = np.flatnonzero(~np.all(is_inside, axis=1))
    return Runs(
        quantiles(usage, QUANTILES), ~np.all(is_inside, axis=0), int(np.max(outside, initial=0))
    )


def _draw_tail(axes: Axes, dt: float, tail: Float[np.ndarray, "3 times"], line: Line) -> None:
    """Draw the median, the 95 % quantile and the greatest usage, the band between the last two
    filled."""
    time = np.arange(tail.shape[1]) * dt
    median, high, greatest = 100 * tail
    axes.fill_between(time, high, greatest, color=line.colour, alpha=0.25, linewidth=0)
    draw_line(axes, time, np.stack([median, high], axis=1), line, linewidth=0.6)
    draw_line(axes, time, greatest, line)


def _draw_starts(
    axes: Axes,
    points: Float[np.ndarray, "batch 3"],
    boundary: Float[np.ndarray, "k 3"],
    runs: Mapping[str, Runs],
) -> None:
    """Mark the starts from which each controller leaves E."""
    scale = TO_DISPLAY[PLANE]
    starts = points[:, PLANE] * scale
    corners = boundary[:, PLANE] * scale
    draw_polygon(axes, corners, edgecolor="0.4", facecolor="0.96", linewidth=0.8)
    some = starts[:MOST_STARTS]
    axes.plot(some[:, 0], some[:, 1], ".", color="0.75", markersize=1.0, rasterized=True)
    for kind, name in STRESSED.items():
        left = starts[runs[kind].leaves]
        look = {"color": CONTROLLERS[name].colour, "linestyle": "none", "rasterized": len(left) > 0}
        axes.plot(left[:, 0], left[:, 1], **MARKS[kind], **look)


def _count(runs: Mapping[str, Runs]) -> str:
    """Say how many runs leave E without and with tube."""
    total = len(runs["tube"].leaves)
    without = runs["plain"].leaves.sum()
    with_tube = runs["tube"].leaves.sum()
    return (
        f"of {total:,} runs leave $\\mathcal{{E}}$:\n{without:,} without tube, {with_tube:,} with"
    )


def _keys() -> list:
    lines = {kind: CONTROLLERS[name] for kind, name in STRESSED.items()}
    return [
        *line_keys(lines.values()),
        line_key("limits of $\\mathcal{E}$", **LIMIT),
        line_key("greatest of all runs", color="0.35", linewidth=1.2),
        line_key("95 % quantile, median", color="0.35", linewidth=0.6),
        Patch(facecolor="0.96", edgecolor="0.4", label="feasible set, projected; dots: starts"),
        *(
            mark_key(f"{line.label} leaves $\\mathcal{{E}}$", line.colour, **MARKS[kind])
            for kind, line in lines.items()
        ),
    ]
