"""Figures of a Monte Carlo run: the verdict with its intervals, errors and disturbances against
their sets, worst lap.

All but the worst lap, which is simulated again, are functions of the run's statistics alone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from jaxtube.experiments.figures.sets import IN_MILLIMETRES, INSIDE, OUTSIDE, SMALL_UNITS
from jaxtube.experiments.figures.style import (
    LIMIT,
    TO_DISPLAY,
    bottom_legend,
    error_label,
    mark_key,
    page_figure,
    styled,
)
from jaxtube.experiments.montecarlo import heat_figures, lap_figure
from jaxtube.experiments.options import Montecarlo
from jaxtube.experiments.run.folder import RunFolder
from jaxtube.experiments.run.progress import progress
from jaxtube.simulation.laps import lap
from jaxtube.simulation.starts import UniformStart
from jaxtube.statistics import histogram
from jaxtube.statistics import task as validation
from jaxtube.statistics.intervals import share_interval
from jaxtube.statistics.run import Statistics
from jaxtube.synthesis.design import Design
from jaxtube.synthesis.problem import Problem

QUANTILES = (0.5, 0.9, 0.999)
SHADES = (0.6, 0.35, 0.15)
FILL = 0.75
COORDINATES = ("longitudinal", "lateral", "heading")
DISTURBANCES = ("w_x", "w_y", "w_\\theta")
STAGES = 5
"""Stages of the tube listed with the shares."""
ROWS = {
    "w_outside_W": "$w$ outside $\\mathcal{W}$",
    "e_outside_E": "$e$ outside $\\mathcal{E}$",
    "u_outside_U": "$u$ outside $\\mathcal{U}$",
    "wheels_saturated": "wheels at their limits",
    "qp_infeasible": "QP infeasible",
    "qp_unsolved": "QP unsolved",
    "not_finite": "not finite",
}
LARGEST_RUN = 1e9
"""Laps up to which the figure says what a run without violation proves."""


def draw(
    found: Design, options: Montecarlo, statistics: Statistics, summary: dict, folder: RunFolder
) -> None:
    """Draw the figures of a run into its folder; those that have nothing to show are left out."""
    task = validation.make_task(
        found, options.controller, options.plant, options.starts, options.seed
    )
    problem, plans, start = found.problem, summary["plans"], task.starts
    drawings = {
        "violations": lambda: violations(summary),
        "margins": lambda: margins(problem, statistics),
        "disturbance": lambda: disturbance(problem, statistics, summary),
        "map": lambda: heat_figures.trajectory_map(problem, task.checks, statistics["map"]),
        "worst": lambda: lap_figure.draw(
            problem, lap(found, task, options.seed, summary["worst"]["error"][0]["lap"])
        ),
    }
    if plans:
        drawings["tube_cloud"] = lambda: heat_figures.tube_cloud(found, statistics, summary)
    if isinstance(start, UniformStart):
        corners = np.asarray(start.triangles).reshape(-1, 3)
        drawings["coverage"] = lambda: heat_figures.coverage(problem, statistics, summary, corners)
    with progress(len(drawings), "drawing", "figures") as bar:
        for name, figure in drawings.items():
            folder.save_figure(figure(), name)
            bar.update()


@styled
def margins(problem: Problem, statistics: Statistics) -> Figure:
    """Draw quantiles of the errors over the laps, step by step, and the largest of all, against the
    limits of E."""
    limits = problem.error_set.support(np.eye(3))
    largest = limits + np.max(np.reshape(statistics["excess/error"], (2, 3)), axis=0)
    bands = [histogram.quantile(statistics["error_by_step"], share) for share in QUANTILES]
    time = np.arange(1, len(bands[0]) + 1) * problem.reference.dt
    figure = page_figure(5.4)
    panels = figure.subplots(3, 1, sharex=True)
    for i, axes in enumerate(panels):
        least, scale = histogram.EDGES[1] * TO_DISPLAY[i], TO_DISPLAY[i]
        # The first bucket is open below, the last one above.
        curves = [
            np.clip(band[:, i], histogram.EDGES[0], histogram.EDGES[-1]) * scale for band in bands
        ]
        floors = [np.full_like(time, histogram.EDGES[0] * scale), *curves[:-1]]
        for lower, upper, look in zip(floors, curves, SHADES, strict=True):
            axes.fill_between(time, lower, upper, color=INSIDE, alpha=look, linewidth=0)
        axes.plot(time, curves[0], color=INSIDE, linewidth=1.0)
        axes.axhline(largest[i] * scale, color=OUTSIDE, linewidth=1.0)
        axes.axhline(limits[i] * scale, **LIMIT)
        axes.set(
            yscale="log", xlim=(0, time[-1]), ylim=(least, 1.6 * max(limits[i], largest[i]) * scale)
        )
        axes.set_ylabel(error_label(i, absolute=True))
        axes.set_title(
            f"largest: {100 * largest[i] / limits[i]:.3g} % of the limit", loc="right", pad=3
        )
    panels[-1].set_xlabel("time [s]")
    keys = [
        Patch(color=INSIDE, alpha=shade, linewidth=0, label=f"{100 * share:g} % of the laps")
        for share, shade in zip(QUANTILES, SHADES, strict=True)
    ]
    keys += [
        Line2D([], [], color=OUTSIDE, linewidth=1.0, label="largest of all laps and steps"),
        Line2D([], [], label="limits of $\\mathcal{E}$", **LIMIT),
    ]
    bottom_legend(figure, keys, columns=5)
    return figure


class Share(NamedTuple):
    """A share with its interval."""

    value: float
    low: float
    high: float


class Row(NamedTuple):
    """One line of the chart: what is counted and how often it was seen, and the shares."""

    label: str
    shares: dict[str, Share]


def share_rows(summary: dict) -> list[Row]:
    """Return what the chart of shares lists: W and E, stages of the tube in use, then the other
    events."""
    events = [_event_row(summary, name) for name in ROWS if name in summary["events"]]
    return [*events[:2], *_stage_rows(summary), *events[2:]]


def _event_row(summary: dict, name: str) -> Row:
    event = summary["events"][name]
    shares = {
        kind: Share(event[f"share_of_{kind}"], *event[f"share_of_{kind}_interval"])
        for kind in ("laps", "steps")
    }
    return Row(f"{ROWS[name]}: {event['laps']:,} laps", shares)


def _stage_rows(summary: dict) -> list[Row]:
    if not summary["plans"]:
        return []
    stages, rows = [stage["outside"] for stage in summary["tube"]["stages"]], []
    for j in np.unique(np.linspace(1, len(stages), min(len(stages), STAGES)).round().astype(int)):
        share = Share(stages[j - 1]["share"], *stages[j - 1]["interval"])
        count = summary["tube"]["plans_outside_by_stage"][summary["tube"]["used"]][j - 1]
        rows.append(Row(f"outside $R_{{{j}}}$: {count:,} plans", {"plans": share}))
    return rows


LOOKS = {
    "laps": {"marker": "o", "color": INSIDE, "markersize": 5},
    "steps": {"marker": "D", "color": OUTSIDE, "markersize": 4},
    "plans": {"marker": "s", "color": "#009E73", "markersize": 4.5},
}


@styled
def violations(summary: dict) -> Figure:
    """Draw how often what must not happen did, with intervals, and what a run without it proves by
    its length.

    Events that a run of this kind cannot have are not in its summary.
    """
    rows = share_rows(summary)
    figure = page_figure(1.4 + 0.27 * len(rows))
    chart, proof = figure.subplots(1, 2, width_ratios=(1.9, 1))
    bounds = [share.high for row in rows for share in row.shares.values()]
    least = min(bounds) / 30
    for place, row in enumerate(rows):
        for offset, (kind, share) in zip(
            (-0.17, 0.17) if len(row.shares) > 1 else (0.0,), row.shares.items(), strict=True
        ):
            _whisker(chart, place + offset, share, kind)
    chart.set_yticks(range(len(rows)), [row.label for row in rows])
    chart.set(xscale="log", xlim=(least, 1.6), ylim=(len(rows) - 0.5, -0.5), xlabel="share")
    chart.grid(False, axis="y")
    _proof(proof, summary)
    confidence = f"{summary['confidence']:.0%}".replace("%", " %")
    keys = [
        Line2D([], [], linestyle="none", label=f"share of {kind}", **look)
        for kind, look in LOOKS.items()
        if any(kind in row.shares for row in rows)
    ]
    keys.append(
        Line2D(
            [],
            [],
            color="0.35",
            linewidth=1.2,
            label=f"{confidence} interval; arrow: at most, none seen",
        )
    )
    bottom_legend(figure, keys, columns=4)
    return figure


def _whisker(axes: Axes, place: float, share: Share, kind: str) -> None:
    """Draw a share with its interval, or, where nothing was seen, an arrow down from the bound."""
    look = LOOKS[kind]
    if share.value > 0:
        axes.plot(
            [max(share.low, 1e-300), share.high], [place, place], color=look["color"], linewidth=1.2
        )
        axes.plot(share.value, place, linestyle="none", **look)
        return
    axes.plot(share.high, place, marker="|", color=look["color"], markersize=6, markeredgewidth=1.2)
    arrow = {
        "arrowstyle": "-|>",
        "color": look["color"],
        "linewidth": 1.0,
        "shrinkA": 0,
        "shrinkB": 0,
    }
    axes.annotate("", (share.high / 6, place), (share.high, place), arrowprops=arrow)


def _proof(axes: Axes, summary: dict) -> None:
    """Draw the largest share of laps that goes with none seen, by the number of laps, with this run
    marked."""
    laps = np.unique(
        np.geomspace(1e2, max(LARGEST_RUN, 10 * summary["laps"]), 60).round().astype(int)
    )
    axes.plot(laps, [share_interval(0, n, summary["confidence"])[1] for n in laps], color="0.15")
    here = share_interval(0, summary["laps"], summary["confidence"])[1]
    axes.plot(summary["laps"], here, **LOOKS["laps"])
    note = f"this run: {summary['laps']:,} laps,\nat most {_power_of_ten(here)}"
    axes.annotate(
        note,
        (0.96, 0.96),
        xycoords="axes fraction",
        ha="right",
        va="top",
        color=LOOKS["laps"]["color"],
    )
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="laps, none of them violating",
        ylabel="share of laps, at most",
    )


def _power_of_ten(value: float) -> str:
    """Write a small positive number as mathematics, such as 6.0 10^-5."""
    mantissa, exponent = f"{value:.1e}".split("e")
    return f"${mantissa} \\times 10^{{{int(exponent)}}}$"


def split_at(counts: Int[np.ndarray, " buckets"], limit: float, outside: int):
    """Return (edges, counts) of a histogram whose bucket around a limit is cut there: `outside` are
    known beyond it."""
    edges = np.concatenate([[0.0], histogram.EDGES[1:], [2.0**histogram.GREATEST]])
    bucket = int(np.searchsorted(edges, limit, side="right")) - 1
    if bucket >= len(counts) or edges[bucket] == limit:
        return edges, counts
    beyond = outside - counts[bucket + 1 :].sum()
    parts = [counts[bucket] - beyond, beyond]
    return np.insert(edges, bucket + 1, limit), np.concatenate(
        [counts[:bucket], parts, counts[bucket + 1 :]]
    )


@styled
def disturbance(problem: Problem, statistics: Statistics, summary: dict) -> Figure:
    """Draw how |w| is distributed in each coordinate, and how often it exceeds a size, against W."""
    limits = problem.disturbance_set.support(np.eye(3))
    normals = validation.facets(problem.disturbance_set).normals
    across = (
        np.abs(normals).T == 1.0
    )  # the two facets across each axis; W may have slanted ones besides
    largest = limits + np.array(
        [np.max(statistics["excess/disturbance"][facets]) for facets in across]
    )
    figure = page_figure(4.4)
    panels = figure.subplots(2, 3, sharex="col")
    for i, column in enumerate(panels.T):
        event = summary["events"][f"w_outside_{COORDINATES[i]}"]
        edges, counts = split_at(statistics["disturbance"][i], limits[i], event["steps"])
        unit = IN_MILLIMETRES[i]
        _distribution(column, edges * unit, counts, limits[i] * unit, largest[i] * unit)
        column[0].set_title(
            heat_figures.share_words(event["share_of_steps"], event["share_of_steps_interval"])
        )
        column[0].set_ylabel(f"density [1/{SMALL_UNITS[i]}]")
        column[1].set_xlabel(f"$|{DISTURBANCES[i]}|$ [{SMALL_UNITS[i]}]")
        column[1].sharey(panels[1, 0])
    panels[1, 0].set_ylabel("share of steps beyond")
    keys = [
        Patch(color=INSIDE, alpha=FILL, linewidth=0, label="steps with $w$ inside its limit"),
        Patch(color=OUTSIDE, alpha=FILL, linewidth=0, label="outside"),
        Line2D([], [], label="limits of $\\mathcal{W}$", **LIMIT),
        mark_key("largest", "0.15", markersize=4),
    ]
    bottom_legend(figure, keys, columns=4)
    return figure


def _distribution(column, edges, counts, limit: float, largest: float) -> None:
    """Draw a histogram, and the shares beyond its edges down to the largest value, of which there
    is one at least."""
    (density, exceedance), end = column, 1.08 * max(1.15 * limit, largest, edges[1])
    relative = counts / counts.sum() / np.diff(edges)
    for chosen, colour in ((edges[:-1] < limit, INSIDE), (edges[:-1] >= limit, OUTSIDE)):
        density.stairs(
            np.where(chosen, relative, 0), edges, fill=True, color=colour, alpha=FILL, linewidth=0
        )
    beyond = np.cumsum(counts[::-1])[::-1] / counts.sum()
    passed = (edges[:-1] < largest) & (beyond > 0)
    least = 1 / counts.sum()
    exceedance.plot([*edges[:-1][passed], largest], [*beyond[passed], least], color="0.15")
    exceedance.plot(largest, least, "o", color="0.15", markersize=4)
    exceedance.set(xlim=(0, end), yscale="log")
    for axes in (density, exceedance):
        axes.axvline(limit, **LIMIT)
        axes.axvspan(limit, end, color="0.5", alpha=0.12, linewidth=0)
