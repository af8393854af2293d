"""The figure of what became of weights and gains along a tuning run; lines are named at their ends.

Positive entries have logarithmic axes; off the diagonals stands the share Q_ij / sqrt(Q_ii Q_jj),
between -1 and 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Annotation
from matplotlib.ticker import MaxNLocator
from scipy.optimize import isotonic_regression

from jaxtube.figures.style import LABEL_SIZE, area_key, bottom_legend, page_figure, styled
from jaxtube.figures.ticks import plain_ticks, spans_decade

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
DASHES = ("-", (0, (5, 1.5)), (0, (1, 1)), (0, (4, 1, 1, 1)))
"""Those of a panel's lines in turn, so that lines differ in print as well."""
SPACING = 1.35
"""Distance between names above each other, in sizes of their font."""
NEAR = 1.06
FAR = 1.22
"""Where names begin, in widths of the panel: beside few lines, and beside many, whose names lie far
from their ends."""
UNITS = {"Q": "1/m², 1/rad²", "R": "s²/m², s²/rad²"}
SHARES = {"Q": "\\sqrt{Q_{ii} Q_{jj}}", "R": "\\sqrt{R_{11} R_{22}}"}
NOT_CERTIFIED = "0.92"


@styled
def parameter_figure(
    error_weights: Float[np.ndarray, "iterates 3 3"],
    input_weights: Float[np.ndarray, "iterates 2 2"],
    gains: Float[np.ndarray, "iterates kappa"],
    gain_names: Sequence[str],
    certified: Bool[np.ndarray, " iterates"],
) -> Figure:
    """Draw weights and gains by iteration; what is off the diagonals only where it is not always
    zero.

    Args:
        error_weights: Q of the iterates, positive definite.
        input_weights: R of the iterates, positive definite.
        gains: of the iterates, in SI units with rad.
        gain_names: a letter with its indices, such as k1, or K2_13.
        certified: iterates whose design is; behind the others the background is grey.
    """
    weights = {"Q": error_weights, "R": input_weights}
    shares = {letter: _compute_shares(values) for letter, values in weights.items()}
    full = any(values.any() for values in shares.values())
    rows = [["Q", "R", "gains"]]
    if full:
        rows.append(["Q shares", "R shares", "gains"])
    room_of_names = 0.9 + len(gain_names) * SPACING * LABEL_SIZE / 72
    figure = page_figure(max(4.0 if full else 2.6, room_of_names))
    panels: dict[str, Axes] = figure.subplot_mosaic(rows, sharex=True)  # pyright: ignore[reportArgumentType, reportCallIssue]
    for letter, values in weights.items():
        _draw_diagonal(panels[letter], letter, values)
        if full:
            _draw_shares(panels[f"{letter} shares"], letter, shares[letter])
    _draw_lines(panels["gains"], gains, gain_names)
    panels["gains"].set(title="gains", ylabel="gain [SI units]")
    for axes in panels.values():
        _shade(axes, ~certified)
    for name in rows[-1]:
        panels[name].set_xlabel("iteration")
    if not certified.all():
        bottom_legend(figure, [area_key("iterates that are not certified", NOT_CERTIFIED)])
    _spread_names(figure, list(panels.values()))
    return figure


def _draw_diagonal(axes: Axes, letter: str, weights: Float[np.ndarray, "iterates n n"]) -> None:
    """Draw the entries on the diagonal of Q or R."""
    names = [f"{letter}{i}{i}" for i in range(1, weights.shape[1] + 1)]
    _draw_lines(axes, np.diagonal(weights, axis1=1, axis2=2), names)
    axes.set_title(f"diagonal of ${letter}$")
    axes.set_ylabel(f"${letter}_{{ii}}$ [{UNITS[letter]}]")


def _draw_shares(axes: Axes, letter: str, shares: Float[np.ndarray, "iterates pairs"]) -> None:
    """Draw what Q or R has off its diagonal."""
    size = {"Q": 3, "R": 2}[letter]
    _draw_lines(axes, shares, [f"{letter}{i + 1}{j + 1}" for i, j in _pairs(size)])
    axes.set(title=f"off the diagonal of ${letter}$", ylim=(-1.05, 1.05))
    axes.set_ylabel(f"${letter}_{{ij}} \\,/\\, {SHARES[letter]}$ [–]")


def _pairs(size: int) -> list[tuple[int, int]]:
    return [(i, j) for i in range(size) for j in range(i + 1, size)]


def _compute_shares(
    weights: Float[np.ndarray, "iterates n n"],
) -> Float[np.ndarray, "iterates pairs"]:
    """Return the entries off the diagonal over the root of the product of theirs on it."""
    roots = np.sqrt(np.diagonal(weights, axis1=1, axis2=2))
    shares = [weights[:, i, j] / (roots[:, i] * roots[:, j]) for i, j in _pairs(weights.shape[1])]
    return np.stack(shares, axis=1)


def _draw_lines(axes: Axes, values: Float[np.ndarray, "iterates k"], names: Sequence[str]) -> None:
    """Draw lines with their names at the right end, and the point that each ends at."""
    many = len(names) > len(COLOURS)
    for place, (line, name) in enumerate(zip(values.T, names, strict=True)):
        colour = COLOURS[place % len(COLOURS)]
        turn = place // len(COLOURS) if many else place
        axes.plot(line, color=colour, linestyle=DASHES[turn % len(DASHES)])
        _write_name(axes, name, line[-1], colour, FAR if many else NEAR)
    if (values > 0).all():
        _make_logarithmic(axes, values)
    axes.set_xlim(0, max(len(values) - 1, 1))
    axes.xaxis.set_major_locator(MaxNLocator(4, integer=True))


def _write_name(axes: Axes, name: str, end: float, colour: str, place: float) -> None:
    """Write the name of a line beside the panel, joined to the line's end."""
    leader: dict[str, Any] = {
        "arrowstyle": "-",
        "color": colour,
        "linewidth": 0.6,
        "shrinkA": 0,
        "shrinkB": 0,
        "relpos": (0, 0.5),
    }
    axes.annotate(
        f"${name[0]}_{{{name[1:].replace('_', ',')}}}$",
        (1.0, end),
        xycoords=("axes fraction", "data"),
        xytext=(place, 0.5),
        textcoords="axes fraction",
        arrowprops=leader,
        annotation_clip=False,
        color=colour,
        fontsize=LABEL_SIZE,
        va="center",
    )


def _make_logarithmic(axes: Axes, values: Float[np.ndarray, "iterates k"]) -> None:
    axes.set_yscale("log")
    if spans_decade(values):
        return
    # Powers of ten alone would be too few, and their multiples are hard to read.
    plain_ticks(axes.yaxis)
    if values.max() < 2 * values.min():
        axes.yaxis.set_major_locator(MaxNLocator(5))


def _shade(axes: Axes, shaded: Bool[np.ndarray, " iterates"]) -> None:
    """Grey the background behind iterates, each with half the way to its neighbours."""
    for i in np.flatnonzero(shaded):
        axes.axvspan(i - 0.5, i + 0.5, color=NOT_CERTIFIED, linewidth=0, zorder=0)


def _spread_names(figure: Figure, panels: Sequence[Axes]) -> None:
    """Move the names as little as keeps them apart and beside their panel."""
    figure.draw_without_rendering()
    for axes in panels:
        height = axes.get_window_extent().height / figure.dpi * 72
        names = [text for text in axes.texts if isinstance(text, Annotation)]
        to_axes = axes.transScale + axes.transLimits
        ends = np.array([to_axes.transform(text.xy)[1] for text in names])
        places = spread(ends, SPACING * LABEL_SIZE / height)
        for text, place in zip(names, places, strict=True):
            text.set_position((text.get_position()[0], place))


def spread(places: Float[np.ndarray, " k"], gap: float) -> Float[np.ndarray, " k"]:
    """Return places a gap apart and in the same order, nearest to the given ones in least squares.

    They lie in [0, 1] where there is room, and touch both its ends where there is not.
    """
    gap = min(gap, 1 / max(len(places) - 1, 1))
    order = np.argsort(places, kind="stable")
    steps = gap * np.arange(len(places))
    increasing = isotonic_regression(places[order] - steps).x
    apart = np.empty(len(places))
    apart[order] = np.clip(increasing, 0.0, 1.0 - steps[-1]) + steps
    return apart
