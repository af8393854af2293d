"""The look of every figure: sizes of a two-column page, one colour a controller, units of the axes
and drawing of sets.

Colours are those of Okabe and Ito, which differ for colour-blind eyes and in print.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from functools import wraps
from types import MappingProxyType
from typing import Any, NamedTuple

import matplotlib
import matplotlib.style
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import LayoutEngine, PlaceHolderLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from jaxtube.coordinates import COORDINATES, TO_DISPLAY
from sets.polytope import hull_vertices

PAGE_WIDTH = 7.16
"""Width of a page of two columns, inches."""

PNG_DPI = 200
"""Resolution at which figures are laid out: that of the PNG, so that its texts are set once."""

PNG_COMPRESSION = 3
"""Of zlib: files are 6 % larger than with its usual 6."""

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
    "figure.titlesize": 10,
    **{f"axes3d.{letter}axis.panecolor": "#ffffff00" for letter in "xyz"},
    # Journals ask for embedded TrueType; text stays text and rasterised clouds stay sharp.
    "pdf.fonttype": 42,
    "savefig.dpi": 300,
}


OF_NO_STYLE = ("backend", "interactive")
"""Settings in a style's file that are none of its look."""

_CHOSEN: ContextVar[Mapping[str, Any]] = ContextVar("style", default=MappingProxyType({}))
"""What a style that was chosen sets otherwise."""


def read_style(name: str) -> dict[str, Any]:
    """Return the settings of a style of matplotlib, by its name or file.

    Raises:
        OSError: where there is none of the name.
    """
    known = matplotlib.style.library.get(name)
    given = known or matplotlib.rc_params_from_file(name, use_default_template=False)
    return {key: value for key, value in given.items() if key not in OF_NO_STYLE}


@contextmanager
def use_style(settings: Mapping[str, Any]) -> Iterator[None]:
    """Let figures follow a style besides this one, over which it goes; its width, where it sets
    `figure.figsize`, becomes theirs."""
    token = _CHOSEN.set(settings)
    try:
        yield
    finally:
        _CHOSEN.reset(token)


def current_settings() -> dict[Any, Any]:
    """Return the settings that figures are drawn in."""
    return SETTINGS | dict(_CHOSEN.get())


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

OWN_COLOURS = ("#332288", "#882255", "#44AA99", "#999933")
"""Of controllers that are none of these."""


def controller_lines(names: Iterable[str]) -> dict[str, Line]:
    """Return the look of each controller, in drawing order: the known ones first."""
    listed = list(names)
    known = {name: line for name, line in CONTROLLERS.items() if name in listed}
    others = [name for name in listed if name not in CONTROLLERS]
    own = {
        name: Line(name, OWN_COLOURS[number % len(OWN_COLOURS)])
        for number, name in enumerate(others)
    }
    return known | own


LABEL_SIZE = 8
"""Size of names beside marks and lines, points."""

INSIDE = "#0072B2"
OUTSIDE = "#D55E00"
"""Colours of what respects a limit and of what passes it."""

LIMIT = {"color": "0.15", "linewidth": 0.9, "linestyle": (0, (5, 2))}
LIMIT_EDGE = {"edgecolor": "0.15", "linewidth": 0.9, "linestyle": (0, (5, 2))}
"""Looks of a limit as a line and as the edge of a polygon."""
REFERENCE = {"color": "0.15", "linewidth": 1.0, "linestyle": (0, (1, 1.2))}


NEGLIGIBLE = 1e-9
"""Entries of a constraint's normal that are not written."""


class Scale(NamedTuple):
    """Units of the three coordinates on an axis, and the factors to them from (m, m, rad)."""

    units: tuple[str, str, str]
    factors: Float[np.ndarray, "3"]


METRES = Scale(("m", "m", "deg"), TO_DISPLAY)
CENTIMETRES = Scale(("cm", "cm", "deg"), TO_DISPLAY * [1e2, 1e2, 1.0])
MILLIMETRES = Scale(("mm", "mm", "deg"), TO_DISPLAY * [1e3, 1e3, 1.0])


class PaperFigure(Figure):
    """A figure that is saved in the style it was drawn in, whatever the caller's settings.

    Its layout is computed once, for all formats it is saved in.
    """

    def get_layout_engine(self) -> LayoutEngine | None:
        """Return the engine, None once the layout is fixed: a figure with one is drawn twice to be
        saved."""
        engine = super().get_layout_engine()
        return None if isinstance(engine, PlaceHolderLayoutEngine) else engine

    def savefig(self, *arguments, **options) -> None:
        """Save as matplotlib does, PNG with less compression in half of the time."""
        if options.get("format") == "png":
            options.setdefault("pil_kwargs", {"compress_level": PNG_COMPRESSION})
        with matplotlib.rc_context(current_settings()):
            self._fix_layout()
            super().savefig(*arguments, **options)

    def _fix_layout(self) -> None:
        engine = self.get_layout_engine()
        if engine is not None:
            engine.execute(self)
            self.set_layout_engine("none")


def styled(draw: Callable[..., Figure]) -> Callable[..., Figure]:
    """Make a function draw its figure in this style."""

    @wraps(draw)
    def draw_in_style(*arguments, **options) -> Figure:
        with matplotlib.rc_context(current_settings()):
            return draw(*arguments, **options)

    return draw_in_style


def page_figure(height: float) -> Figure:
    """Return an empty figure over the width of the page, height in inches at PAGE_WIDTH."""
    width = _CHOSEN.get().get("figure.figsize", (PAGE_WIDTH,))[0]
    return PaperFigure(
        figsize=(width, height * width / PAGE_WIDTH), dpi=PNG_DPI, layout="constrained"
    )


def bottom_legend(figure: Figure, handles: list, columns: int = 3) -> None:
    """Put one legend for all panels under them, in fewer columns where a style that was chosen
    makes it wider than the figure."""
    legend = figure.legend(handles=handles, loc="outside lower center", ncols=columns)
    while _CHOSEN.get() and columns > 1 and legend.get_window_extent().width > figure.bbox.width:
        legend.remove()
        columns -= 1
        legend = figure.legend(handles=handles, loc="outside lower center", ncols=columns)


def line_keys(lines: Iterable[Line]) -> list[Line2D]:
    """Return the legend's entries of lines."""
    return [line_key(line.label, color=line.colour, linestyle=line.dashes) for line in lines]


def line_key(label: str, **look) -> Line2D:
    """Return the legend's entry of a line."""
    return Line2D([], [], label=label, **look)


def mark_key(label: str, colour: str, **look) -> Line2D:
    """Return the legend's entry of a mark without a line."""
    look = {"marker": "o", "markersize": 4, **look}
    return Line2D([], [], linestyle="none", color=colour, label=label, **look)


def area_key(label: str, colour: Any, alpha: float = 1.0) -> Patch:
    """Return the legend's entry of a filled area."""
    return Patch(color=colour, alpha=alpha, linewidth=0, label=label)


def error_label(coordinate: int, scale: Scale = METRES, absolute: bool = False) -> str:
    """Return the label of an axis of a tracking error, with its unit."""
    symbol = COORDINATES[coordinate].error
    if absolute:
        symbol = f"|{symbol}|"
    return f"${symbol}$ [{scale.units[coordinate]}]"


def disturbance_label(coordinate: int, absolute: bool = False) -> str:
    """Return the label of an axis of a disturbance, in mm or deg."""
    symbol = COORDINATES[coordinate].disturbance
    if absolute:
        symbol = f"|{symbol}|"
    return f"${symbol}$ [{MILLIMETRES.units[coordinate]}]"


def row_text(normal: Float[np.ndarray, "3"]) -> str:
    """Return the left side of a constraint on errors as LaTeX, such as e_y - 0.5 e_theta."""
    terms = []
    for value, coordinate in zip(normal, COORDINATES, strict=True):
        if abs(value) > NEGLIGIBLE:
            terms.append(f"{value:+.3g}\\,{coordinate.error}")
    return "".join(terms).replace("+1\\,", "+").replace("-1\\,", "-").removeprefix("+")


def label_plane(axes: Axes, plane: tuple[int, int], scale: Scale = METRES) -> None:
    """Label the axes of a panel that shows two coordinates of tracking errors."""
    axes.set_xlabel(error_label(plane[0], scale))
    axes.set_ylabel(error_label(plane[1], scale), labelpad=1)


def outline(points: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "v 2"]:
    """Return the corners of the convex hull of points in the plane, in order; flat sets have two,
    or one."""
    corners = hull_vertices(points)
    away = corners - corners.mean(axis=0)
    return corners[np.argsort(np.arctan2(away[:, 1], away[:, 0]))]


def draw_polygon(axes: Axes, points: Float[np.ndarray, "k 2"], **look) -> None:
    """Draw the convex hull of points as a closed line, filled where `facecolor` is given."""
    look = {"facecolor": "none", **look}
    corners = outline(points)
    (patch,) = axes.fill(corners[:, 0], corners[:, 1], **look)
    patch.set_joinstyle("round")


def draw_line(axes: Axes, x, y, line: Line, **look) -> None:
    """Draw a curve in the colour and dashes of its line."""
    axes.plot(x, y, color=line.colour, linestyle=line.dashes, **look)
