"""The figure of runs under stress: tube MPC against MPC without tube, from starts all over the
feasible set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from jaxtube.experiments.figures.style import (
    CONTROLLERS,
    LIMIT,
    TO_DISPLAY,
    Line,
    bottom_legend,
    draw_polygon,
    error_label,
    line_keys,
    mark_key,
    page_figure,
    styled,
)
from jaxtube.synthesis.problem import Problem

FIRST_SECONDS = 3.0
"""What is shown of each run, or more where a run leaves E later."""

STRESSED = {"plain": "plain_mpc", "tube": "tube_mpc"}
MARKS: dict[str, dict[str, Any]] = {
    "plain": {"marker": "o", "markersize": 2.2, "markeredgewidth": 0},
    "tube": {"marker": "x", "markersize": 2.6},
}
"""Marks of the starts whose run leaves E: a cross stays visible on a dot."""


def leaves_error_set(
    problem: Problem, errors: Float[np.ndarray, "steps+1 batch 3"]
) -> Bool[np.ndarray, " batch"]:
    """Tell which runs leave E; NaN is outside."""
    return ~np.all(np.abs(errors) <= problem.error_set.offsets[:3], axis=(0, 2))


@styled
def stress(
    problem: Problem, cases: Sequence[Mapping[str, Any]], boundary: Float[np.ndarray, "k 3"]
) -> Figure:
    """Draw tube MPC against MPC without tube from starts all over the feasible set, one row a case.

    Args:
        problem: gives the limits and the period.
        cases: each with `title` and the errors (steps+1, batch, 3) `tube` and `plain` from the same
            starts.
        boundary: points on the boundary of the feasible set.
    """
    figure = page_figure(0.9 + 1.55 * len(cases))
    panels = figure.subplots(
        len(cases), 5, sharex="col", sharey="col", squeeze=False, width_ratios=(1, 1, 1, 1.1, 1.1)
    )
    dt, limits = problem.reference.dt, problem.error_set.offsets[:3] * TO_DISPLAY
    last_exit = max(_last_exit(problem, case) for case in cases)
    shown = min(round(max(FIRST_SECONDS / dt, 1.2 * last_exit)) + 1, problem.reference.steps + 1)
    for row, case in zip(panels, cases, strict=True):
        for coordinate, axes in enumerate(row[:3]):
            for kind, name in STRESSED.items():
                values = np.abs(case[kind][:shown, :, coordinate]) * TO_DISPLAY[coordinate]
                _tail(axes, np.arange(len(values)) * dt, values, CONTROLLERS[name])
            axes.axhline(limits[coordinate], **LIMIT)
            axes.text(
                0.95,
                0.78,
                error_label(coordinate, absolute=True),
                transform=axes.transAxes,
                ha="right",
                va="top",
            )
            axes.set(xlim=(0, (shown - 1) * dt), ylim=(0, 1.2 * limits[coordinate]))
            axes.locator_params(axis="x", nbins=4)
        for axes, plane in zip(row[3:], ((0, 1), (1, 2)), strict=True):
            _starts(axes, problem, case, boundary, plane)
        # A title reserves the line; the text itself runs on over the whole row.
        row[0].set_title(" ")
        row[0].text(0, 1.05, _verdict(problem, case), transform=row[0].transAxes, in_layout=False)
    for axes, label in zip(
        panels[-1], ["time [s]"] * 3 + [f"start: {error_label(i)}" for i in (0, 1)], strict=True
    ):
        axes.set_xlabel(label)
    bottom_legend(figure, _stress_keys(), columns=4)
    return figure


def _last_exit(problem: Problem, case: Mapping[str, Any]) -> int:
    """Return the last step at which a run is outside E, 0 where none ever is."""
    limits = problem.error_set.offsets[:3]
    outside = [~np.all(np.abs(case[kind]) <= limits, axis=(1, 2)) for kind in STRESSED]
    return int(np.max(np.nonzero(np.any(outside, axis=0))[0], initial=0))


def _tail(axes: Axes, time, values: Float[np.ndarray, "times batch"], line: Line) -> None:
    """Draw the median, the 95 % quantile and the greatest of absolute errors, the band between the
    last two filled."""
    median, high, greatest = np.quantile(values, (0.5, 0.95, 1.0), axis=1)
    axes.fill_between(time, high, greatest, color=line.colour, alpha=0.25, linewidth=0)
    axes.plot(
        time,
        np.stack([median, high], axis=1),
        color=line.colour,
        linewidth=0.6,
        linestyle=line.dashes,
    )
    axes.plot(time, greatest, color=line.colour, linestyle=line.dashes)


def _starts(
    axes: Axes, problem: Problem, case: Mapping[str, Any], boundary, plane: tuple[int, int]
) -> None:
    """Mark the starts from which each controller leaves E, in the plane of two errors."""
    starts, corners = (
        points[:, plane] * TO_DISPLAY[list(plane)] for points in (case["plain"][0], boundary)
    )
    draw_polygon(axes, corners, edgecolor="0.4", facecolor="0.95", linewidth=0.8)
    axes.plot(*starts.T, ".", color="0.7", markersize=1.2, rasterized=True)
    for kind, name in STRESSED.items():
        left = starts[leaves_error_set(problem, case[kind])]
        axes.plot(
            *left.T,
            **MARKS[kind],
            color=CONTROLLERS[name].colour,
            linestyle="none",
            rasterized=True,
        )
    axes.set_ylabel(error_label(plane[1]), labelpad=0)


def _verdict(problem: Problem, case: Mapping[str, Any]) -> str:
    counts = [
        f"{CONTROLLERS[STRESSED[k]].label} in {leaves_error_set(problem, case[k]).sum():,}"
        for k in STRESSED
    ]
    return f"{case['title']}:  $\\mathcal{{E}}$ left by {', by '.join(counts)} of {case['plain'].shape[1]:,} runs"


def _stress_keys() -> list:
    lines = {kind: CONTROLLERS[name] for kind, name in STRESSED.items()}
    return [
        *line_keys(lines.values()),
        Line2D([], [], color="0.35", linewidth=1.2, label="greatest of all runs"),
        Line2D([], [], color="0.35", linewidth=0.6, label="95 % quantile, median"),
        *(
            mark_key(f"{line.label} leaves $\\mathcal{{E}}$", line.colour, **MARKS[kind])
            for kind, line in lines.items()
        ),
        Line2D([], [], label="limits of $\\mathcal{E}$", **LIMIT),
        Patch(facecolor="0.95", edgecolor="0.4", label="feasible set, projected"),
    ]
