"""The figure of a worst case: the run that comes nearest to a limit, with what drove it there."""

from __future__ import annotations

import textwrap
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from jaxtube.coordinates import COORDINATES, TO_DISPLAY
from jaxtube.falsification.cases import CAPS
from jaxtube.falsification.cells import DURING_PERIODS
from jaxtube.falsification.worst import Worst
from jaxtube.figures.style import (
    CONTROLLERS,
    LIMIT,
    REFERENCE,
    area_key,
    bottom_legend,
    error_label,
    line_key,
    page_figure,
    styled,
)
from jaxtube.plant.error_dynamics import world_pose
from jaxtube.plant.reference import settled_step
from jaxtube.simulation.usage import Limits, Replay, read_values
from jaxtube.synthesis.problem import Problem

RUN = CONTROLLERS["tube_mpc"].colour
WORST = "#D55E00"
REACHES = {
    "all runs of the search": ("#D55E00", 0.28),
    "all drawn laps, equal time": ("0.45", 0.28),
}
"""Colour and strength of the bands of usage, by name."""
BOUNDS = LinearSegmentedColormap.from_list("bounds", ["#8073AC", "#F7F7F7", "#E08214"])
WORST_DOT: dict[str, Any] = {"marker": "o", "color": WORST, "markersize": 4, "zorder": 5}
SETTLED_DIAMOND: dict[str, Any] = {
    "marker": "D",
    "color": WORST,
    "markerfacecolor": "white",
    "markersize": 4.5,
    "linestyle": "none",
    "zorder": 5,
}
BEFORE_S = 2.0
AFTER_S = 0.6
"""Seconds of the path that are shown before and after the worst step."""
LABEL_WIDTH = 16
"""Characters of an ordinate's label in a line: longer ones would run into the next panel's."""
ATTACK_S = 10.0
"""Seconds of the attack that are shown before the worst step."""

STRIPS = {
    "true": ("slip, right", "slip, left"),
    "change": ("change of slip, right", "change of slip, left"),
    "measured": ("measured slip, right", "measured slip, left"),
    "sideslip": ("sideslip",),
    "lag": ("lag of the wheels",),
    "delay": ("delay of the command",),
    "disturbance": tuple(f"${coordinate.disturbance}$" for coordinate in COORDINATES),
    "noise": tuple(f"noise in ${coordinate.error}$" for coordinate in COORDINATES),
}
"""Components of an attack."""

BEGINNING = ("first slip, right", "first slip, left")
"""What `true` is where changes follow it."""


class Track(NamedTuple):
    """One quantity against time with the two facets that bound it, in display units.

    A usage of 0 is at the centre, 1 at a bound. Bounds may differ from step to step.
    """

    label: str
    values: Float[np.ndarray, " times"]
    upper: Float[np.ndarray, " times"]
    lower: Float[np.ndarray, " times"]
    centre: Float[np.ndarray, " times"]
    facets: tuple[int, int]

    def value_at(
        self, usage: Float[np.ndarray, "*k"], facet: int, steps: Int[np.ndarray, "*k"]
    ) -> Float[np.ndarray, "*k"]:
        """Return the values that use so much of one facet at these steps."""
        bound = self.upper if facet == self.facets[0] else self.lower
        centre = self.centre[steps]
        return centre + usage * (bound[steps] - centre)


class SettledUsage(NamedTuple):
    """The greatest usage that the search met once laps have settled."""

    usage: float
    step: int
    facet: int


def make_tracks(problem: Problem, limits: Limits, name: str, played: Replay) -> list[Track]:
    """Return what the limit bounds; for a tube the errors of the lap up to the plan."""
    shown = "error" if name == "tube" else name
    limit = limits[shown]
    values = played.trajectory.errors[:, 0] if shown == "error" else read_values(shown, played)
    stages = np.minimum(np.arange(len(values)), len(limit.offsets) - 1)
    normals = np.asarray(limit.normals)[stages]
    offsets = np.asarray(limit.offsets)[stages]
    centres = normals @ np.asarray(limit.centre)
    along = np.einsum("tfn,tn->tf", normals, values)
    side = offsets.shape[1] // 2
    labels = _labels(problem, shown)
    scales = TO_DISPLAY if shown == "error" else np.ones(side)
    return [
        Track(
            labels[i],
            along[:, i] * scales[i],
            offsets[:, i] * scales[i],
            -offsets[:, i + side] * scales[i],
            centres[:, i] * scales[i],
            (i, i + side),
        )
        for i in range(side)
    ]


def _labels(problem: Problem, name: str) -> list[str]:
    if name == "error":
        return [error_label(coordinate) for coordinate in range(3)]
    if name == "wheels":
        return ["right wheel [m/s]", "left wheel [m/s]"]
    if name == "acceleration":
        return ["right wheel's change [m/s]", "left wheel's change [m/s]"]
    operating = problem.scenario.operating
    if operating.bands or operating.yaw_rate_deficit_radps is not None:
        return [f"{what} [{unit}]" for what, unit in CAPS]
    return ["right wheel's deficit [m/s]", "left wheel's deficit [m/s]"]


@styled
def worst_run(
    problem: Problem, limits: Limits, worst: Worst, played: Replay, reaches=None
) -> Figure:
    """Draw the run that comes nearest to a limit: what the limit bounds, the path around the worst
    step, the attack.

    Args:
        problem: gives the reference and the period.
        limits: of a lap.
        worst, played: the worst case and its replay.
        reaches: greatest usage by step and facet that the search met, and that drawn laps met, by
            limit.
    """
    name = worst.limit
    dt = problem.reference.dt
    tracks = make_tracks(problem, limits, name, played)
    strips = make_strips(worst)
    settled = _find_settled(problem, name, worst, reaches[0][name]) if reaches else None
    figure = page_figure(max(3.3 + 0.16 * len(strips), 1.5 + 0.95 * len(tracks)))
    halves: Any = figure.subfigures(1, 2, width_ratios=(1.15, 1))
    left, right = halves
    panels = left.subplots(len(tracks), 1, sharex=True)
    last = worst.step if name == "tube" else len(tracks[0].values) - 1
    for axes, track in zip(panels, tracks, strict=True):
        if reaches:
            _draw_reaches(axes, track, name, reaches, dt)
        _draw_track(axes, track, worst, dt, last)
        if name != "tube" and worst.facet in track.facets:
            axes.plot(worst.step * dt, track.values[worst.step], **WORST_DOT)
        if settled is not None and settled.facet in track.facets:
            place = np.array(settled.step)
            value = track.value_at(np.array(settled.usage), settled.facet, place)
            axes.plot(settled.step * dt, value, **SETTLED_DIAMOND)
    panels[0].set_title(_title(problem, worst, settled))
    panels[-1].set_xlabel("time [s]")
    path, attack = right.subplots(2, 1, height_ratios=(3, 0.35 + 0.33 * len(strips)))
    _draw_path(path, problem, worst, played)
    end = min(worst.step + 1 - _first_instant(name), problem.reference.steps)
    _draw_strips(attack, strips, worst.step * dt, end * dt, problem)
    limits_label = "limits of $\\mathcal{E}$" if name == "tube" else "limits"
    bottom_legend(figure, _keys(limits_label, reaches is not None, settled is not None), columns=4)
    return figure


def _first_instant(name: str) -> int:
    """Return the step of the first usage of a limit: errors are judged after each period, inputs
    and wheels during it."""
    return 0 if name in DURING_PERIODS else 1


def _find_settled(
    problem: Problem, name: str, worst: Worst, reach: Float[np.ndarray, "steps facets"]
) -> SettledUsage | None:
    """Return the greatest usage once laps have settled, None where the worst of all is later."""
    first = settled_step(problem.reference)
    later = reach[first - _first_instant(name) :]
    if worst.step >= first or not len(later):
        return None
    place, facet = np.unravel_index(int(np.argmax(later)), later.shape)
    return SettledUsage(float(later[place, facet]), first + int(place), int(facet))


def _title(problem: Problem, worst: Worst, settled: SettledUsage | None) -> str:
    dt = problem.reference.dt
    text = f"worst: {100 * worst.usage:.3g} % of the limit at {worst.step * dt:.3g} s"
    if settled is None:
        return text
    return f"{text}; once settled {100 * settled.usage:.3g} % at {settled.step * dt:.3g} s"


def _draw_reaches(axes: Axes, track: Track, name: str, reaches, dt: float) -> None:
    """Draw the values that all laps of a search, or of drawn ones, kept between."""
    upper_facet, lower_facet = track.facets
    for reach, (colour, alpha) in zip(reaches, REACHES.values(), strict=True):
        steps = _first_instant(name) + np.arange(len(reach[name]))
        above = track.value_at(reach[name][:, upper_facet], upper_facet, steps)
        below = track.value_at(reach[name][:, lower_facet], lower_facet, steps)
        axes.fill_between(steps * dt, below, above, color=colour, alpha=alpha, linewidth=0)


def _draw_track(axes: Axes, track: Track, worst: Worst, dt: float, last: int) -> None:
    """Draw one quantity up to a step, with its bounds and the worst step."""
    instants = np.arange(last + 1) * dt
    axes.plot(instants, track.values[: last + 1], color=RUN)
    for bound in (track.upper, track.lower):
        if np.ptp(bound) == 0:
            axes.axhline(bound[0], **LIMIT)
        else:
            axes.step(instants, bound[: last + 1], where="post", **LIMIT)
    axes.axvline(worst.step * dt, color=WORST, linewidth=0.8)
    axes.set_ylabel(textwrap.fill(track.label, LABEL_WIDTH))
    axes.margins(x=0.01)


def _draw_path(axes: Axes, problem: Problem, worst: Worst, played: Replay) -> None:
    """Draw reference and robot around the worst step, joined at that step."""
    dt = problem.reference.dt
    steps = problem.reference.steps
    poses = problem.reference.poses[: steps + 1]
    robot = np.asarray(jax.jit(world_pose)(played.trajectory.errors[:, 0], poses))
    first = max(worst.step - round(BEFORE_S / dt), 0)
    last = min(worst.step + round(AFTER_S / dt), steps)
    shown = slice(first, last + 1)
    dots: dict[str, Any] = {"marker": "o", "markersize": 2.5}
    axes.plot(poses[shown, 0], poses[shown, 1], **{**REFERENCE, **dots})
    axes.plot(robot[shown, 0], robot[shown, 1], color=RUN, **dots)
    joined = np.stack([poses[worst.step], robot[worst.step]])
    axes.plot(joined[:, 0], joined[:, 1], **WORST_DOT)
    axes.set(xlabel="$x$ [m]", ylabel="$y$ [m]")
    axes.set_title(f"path, {first * dt:.1f} to {last * dt:.1f} s, a dot each {dt:g} s")
    axes.set_aspect("equal", adjustable="datalim")


def make_strips(worst: Worst) -> list[tuple[str, Float[np.ndarray, " times"]]]:
    """Return (name, values from -1 to 1) of every component of the attack."""
    strips = []
    for key, labels in STRIPS.items():
        if key not in worst.attack:
            continue
        values = worst.attack[key]
        if key == "true" and "change" in worst.attack:
            labels = BEGINNING
        # Disturbances have units; the other deviations are shares of their bounds already.
        largest = np.max(np.abs(values), axis=0) if key == "disturbance" else np.ones(len(labels))
        scales = np.where(largest > 0, largest, 1.0)
        strips += [(label, values[:, i] / scales[i]) for i, label in enumerate(labels)]
    return strips


def _draw_strips(axes: Axes, strips, worst_s: float, end_s: float, problem: Problem) -> None:
    """Draw the deviations as strips up to the last one that plays a part in the worst step: full
    colour is a bound."""
    dt = problem.reference.dt
    steps = problem.reference.steps
    for row, (_, values) in enumerate(strips):
        values = values[:steps]
        edges = np.linspace(0, steps * dt, len(values) + 1)
        sides = [row - 0.4, row + 0.4]
        look: dict[str, Any] = {"cmap": BOUNDS, "vmin": -1, "vmax": 1, "rasterized": True}
        axes.pcolormesh(edges, sides, values[None], **look)
    axes.axvline(worst_s, color="0.1", linewidth=0.9)
    axes.set_yticks(range(len(strips)), [label for label, _ in strips])
    axes.set(xlim=(max(end_s - ATTACK_S, 0), end_s), ylim=(len(strips) - 0.5, -0.5))
    axes.set(xlabel="time [s]", title="deviations up to the worst step")
    axes.grid(visible=False)


def _keys(limits_label: str, has_reaches: bool, has_settled: bool) -> list:
    keys: list[Any] = [
        line_key("worst run", color=RUN),
        line_key("reference", **REFERENCE),
        line_key(limits_label, **LIMIT),
        line_key("worst step", **{**WORST_DOT, "linewidth": 0.8}),
        area_key("deviation at its upper bound", BOUNDS(1.0)),
        area_key("at its lower bound", BOUNDS(0.0)),
    ]
    if has_reaches:
        keys += [area_key(label, *look) for label, look in REACHES.items()]
    if has_settled:
        keys.append(line_key("most once settled, of the search", **SETTLED_DIAMOND))
    return keys
