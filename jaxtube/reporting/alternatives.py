"""A figure in words, for those who cannot see it: its panels, titles, axes and ranges, its legend,
and how far each curve of the legend reaches in each panel."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from jaxtyping import Bool
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D

MOST_PANELS = 12
"""Panels that are described one by one."""
SYMBOLS = {
    r"\\mathcal\{(\w)\}": r"\1",
    r"\\(?:mathrm|mathbf|text)\{([^}]*)\}": r"\1",
    r"\^\\top|\^\{\\top\}": "^T",
    r"\\infty": "infinity",
    r"\\[lc]?dots": "…",
    r"\\pm": "±",
    r"\\leq?": "≤",
    r"\\geq?": "≥",
    r"\\[,;! ]": " ",
    r"\\%": "%",
    r"\\([A-Za-z]+)": r"\1",
    r"[${}]": "",
}
"""What stands for LaTeX in plain text, in the order in which it is replaced."""


def describe_figure(figure: Figure) -> str:
    """Return what a figure shows, in sentences."""
    title = figure.get_suptitle()
    panels = [axes for axes in figure.axes if axes.get_visible() and axes.axison]
    keys = dict(_list_keys(figure))
    sentences = [plain(title)] if title else []
    if len(panels) > 1:
        sentences.append(f"{len(panels)} panels")
    for number, axes in enumerate(panels[:MOST_PANELS], 1):
        name = f"Panel {number}: " if len(panels) > 1 else ""
        sentences.append(f"{name}{_describe_axes(axes, panels)}{_describe_curves(axes, keys)}")
    if len(panels) > MOST_PANELS:
        sentences.append(f"{len(panels) - MOST_PANELS} more panels of the same kind")
    if keys:
        sentences.append(f"Legend: {'; '.join(keys)}")
    return ". ".join(sentence.rstrip(".") for sentence in sentences) + "."


def plain(text: str) -> str:
    """Return text without LaTeX, in one line."""
    for pattern, replacement in SYMBOLS.items():
        text = re.sub(pattern, replacement, text)
    return " ".join(text.split())


def _describe_axes(axes: Axes, panels: Sequence[Axes]) -> str:
    """Return title, quantities and ranges of a panel; a label that it lacks stands at the edge of
    its row or column."""
    titles = [plain(axes.get_title(loc)) for loc in ("left", "center", "right")]
    words = [f"“{'; '.join(filter(None, titles))}”"] if any(titles) else []
    label_x = plain(axes.get_xlabel() or _find_label(axes, panels, "x"))
    label_y = plain(axes.get_ylabel() or _find_label(axes, panels, "y"))
    if label_y:
        words.append(f"{label_y}, {_describe_range(axes.get_ylim(), _name_ticks(axes.yaxis))}")
    if label_x:
        over = "against " if label_y else ""
        words.append(
            f"{over}{label_x}, {_describe_range(axes.get_xlim(), _name_ticks(axes.xaxis))}"
        )
    return ", ".join(words) or "without labels"


def _find_label(axes: Axes, panels: Sequence[Axes], letter: str) -> str:
    """Return the label of the first panel that has one: of those in the same column (x) or row (y),
    then of those that share the axis."""
    group = getattr(axes, f"get_shared_{letter}_axes")()
    place = _find_place(axes, letter)
    beside = [
        other for other in panels if place is not None and _find_place(other, letter) == place
    ]
    others = [*beside, *group.get_siblings(axes)]
    return next(filter(None, (getattr(other, f"get_{letter}label")() for other in others)), "")


def _find_place(axes: Axes, letter: str) -> tuple[int, int] | None:
    """Return the columns (x) or rows (y) that a panel spans, None for one outside a grid."""
    cell = axes.get_subplotspec()
    if cell is None:
        return None
    span = cell.colspan if letter == "x" else cell.rowspan
    return span.start, span.stop


def _describe_curves(axes: Axes, keys: Mapping[str, str]) -> str:
    """Return how far each curve that the legend names reaches within a panel."""
    low, high = sorted(axes.get_xlim())
    told = []
    for label, colour in keys.items():
        values = [
            np.asarray(line.get_ydata(), float)[_lies_within(line, low, high)]
            for line in axes.lines
            if line.get_visible() and np.size(line.get_xdata()) > 2 and _find_colour(line) == colour
        ]
        reach = np.concatenate(values) if values else np.array([])
        reach = reach[np.isfinite(reach)]
        if reach.size:
            told.append(f"{label} {reach.min():.3g} to {reach.max():.3g}")
    return f"; curves: {', '.join(told)}" if told else ""


def _lies_within(line: Line2D, low: float, high: float) -> Bool[np.ndarray, " points"]:
    x = np.asarray(line.get_xdata(), float)
    return (x >= low) & (x <= high)


def _find_colour(line: Line2D) -> str:
    return to_hex(line.get_color())


def _name_ticks(axis) -> list[str]:
    """Return the words at the ticks of an axis whose ticks are words."""
    formatter = axis.get_major_formatter()
    names = [plain(text) for text in getattr(formatter, "seq", [])]
    return [name for name in names if name and not re.fullmatch(r"[−\-\d.e]+", name)]


def _describe_range(limits: tuple[float, float], names: list[str]) -> str:
    if names:
        return f"one each of {', '.join(names)}"
    low, high = sorted(limits)
    return f"from {low:.3g} to {high:.3g}"


def _list_keys(figure: Figure) -> Iterator[tuple[str, str]]:
    """Yield the entries of all legends, each with the colour of its line, "" for other marks."""
    legends = [*figure.legends, *(axes.get_legend() for axes in figure.axes)]
    for legend in legends:
        if isinstance(legend, Legend):
            for handle, text in zip(legend.legend_handles, legend.get_texts(), strict=True):
                label = plain(text.get_text())
                if not label:
                    continue
                if isinstance(handle, Line2D) and handle.get_linestyle() != "None":
                    yield label, _find_colour(handle)
                else:
                    yield label, ""
