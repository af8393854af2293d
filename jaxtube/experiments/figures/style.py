"""The look of every figure: sizes of a two-column page, one colour a controller, names, units and
drawing of sets.

Colours are those of Okabe and Ito, which differ for colour-blind eyes and in print.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import wraps
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from sets.polytope import hull_vertices

PAGE_WIDTH = 7.16
"""Width of a page of two columns, inches."""

SETTINGS: dict[Any, Any] = {
    "font.family": "STIXGeneral",
    "mathtext.fontset": "stix",
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.labelsize": 9,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "legend.handlelength": 1.8,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "0.9",
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.2,
    **{f"axes3d.{letter}axis.panecolor": "#ffffff00" for letter in "xyz"},
    # Journals ask for embedded TrueType; text stays text and rasterised clouds stay sharp.
    "pdf.fonttype": 42,
    "savefig.dpi": 300,
}


class Line(NamedTuple):
    """How one curve is named and drawn."""

    label: str
    colour: str
    dashes: Any = "-"


CONTROLLERS = {
    "uncompensated": Line("No slip compensation", "#D55E00"),
    "compensated": Line("Slip compensation", "#009E73"),
    "local_gain": Line("Local gain $K(\\theta)$", "#CC79A7"),
    "equal_gain": Line("Static gain of the MPC", "#56B4E9", (0, (1, 1))),
    "plain_mpc": Line("MPC without tube", "#E69F00", (0, (4, 1.5))),
    "tube_mpc": Line("Tube MPC", "#0072B2"),
}
"""By name, in the order in which they are listed; a later one is drawn over an earlier one."""

LIMIT = {"color": "0.15", "linewidth": 0.9, "linestyle": (0, (5, 2))}
REFERENCE = {"color": "0.15", "linewidth": 1.0, "linestyle": (0, (1, 1.2))}

ERRORS = ("e_x", "e_y", "e_\\theta")
TO_DISPLAY = np.array([1.0, 1.0, np.rad2deg(1.0)])
UNITS = ("m", "m", "deg")


class PaperFigure(Figure):
    """A figure that is saved in the style it was drawn in, whatever the caller's settings."""

    def savefig(self, *arguments, **options) -> None:
        """Save as matplotlib does."""
        with matplotlib.rc_context(SETTINGS):
            super().savefig(*arguments, **options)


def styled(draw: Callable[..., Figure]) -> Callable[..., Figure]:
    """Make a function draw its figure in this style."""

    @wraps(draw)
    def drawn(*arguments, **options) -> Figure:
        with matplotlib.rc_context(SETTINGS):
            return draw(*arguments, **options)

    return drawn


def page_figure(height: float) -> Figure:
    """Return an empty figure over the width of the page, height in inches."""
    return PaperFigure(figsize=(PAGE_WIDTH, height), layout="constrained")


def bottom_legend(figure: Figure, handles: list, columns: int = 3) -> None:
    """Put one legend for all panels under them."""
    figure.legend(handles=handles, loc="outside lower center", ncols=columns)


def line_keys(lines: Iterable[Line]) -> list[Line2D]:
    """Return the legend's entries of lines."""
    return [
        Line2D([], [], color=line.colour, linestyle=line.dashes, label=line.label) for line in lines
    ]


def mark_key(label: str, colour: str, **look) -> Line2D:
    """Return the legend's entry of a mark without a line."""
    return Line2D(
        [],
        [],
        linestyle="none",
        color=colour,
        label=label,
        **{"marker": "o", "markersize": 4, **look},
    )


def error_label(coordinate: int, absolute: bool = False, unit: str = "") -> str:
    """Return the axis label of a tracking error, with its unit."""
    letter = f"|{ERRORS[coordinate]}|" if absolute else ERRORS[coordinate]
    return f"${letter}$ [{unit or UNITS[coordinate]}]"


def outline(points: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "v 2"]:
    """Return the corners of the convex hull of points in the plane, in order; flat sets have two,
    or one."""
    corners = hull_vertices(points)
    away = corners - corners.mean(axis=0)
    return corners[np.argsort(np.arctan2(away[:, 1], away[:, 0]))]


def draw_polygon(axes: Axes, points: Float[np.ndarray, "k 2"], **look) -> None:
    """Draw the convex hull of points as a closed line, filled where `facecolor` is given."""
    look = {"facecolor": "none", **look}
    (patch,) = axes.fill(*outline(points).T, **look)
    patch.set_joinstyle("round")
