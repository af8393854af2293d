"""A figure in words, for those who cannot see it: its panels, axes, ranges, titles and legend."""

from __future__ import annotations

import re
from collections.abc import Iterator

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.legend import Legend

MOST_PANELS = 12
"""Panels that are described one by one."""
SYMBOLS = {
    r"\\mathcal\{(\w)\}": r"\1",
    r"\\(?:mathrm|mathbf|text)\{([^}]*)\}": r"\1",
    r"\^\\top|\^\{\\top\}": "^T",
    r"\\infty": "infinity",
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
    panels = [axes for axes in figure.axes if axes.get_visible()]
    sentences = [plain(title)] if title else []
    if len(panels) > 1:
        sentences.append(f"{len(panels)} panels")
    for number, axes in enumerate(panels[:MOST_PANELS], 1):
        name = f"Panel {number}: " if len(panels) > 1 else ""
        sentences.append(f"{name}{_describe_axes(axes)}")
    if len(panels) > MOST_PANELS:
        sentences.append(f"{len(panels) - MOST_PANELS} more panels of the same kind")
    keys = list(dict.fromkeys(filter(None, _list_keys(figure))))
    if keys:
        sentences.append(f"Legend: {'; '.join(keys)}")
    return ". ".join(sentence.rstrip(".") for sentence in sentences) + "."


def plain(text: str) -> str:
    """Return text without LaTeX, in one line."""
    for pattern, replacement in SYMBOLS.items():
        text = re.sub(pattern, replacement, text)
    return " ".join(text.split())


def _describe_axes(axes: Axes) -> str:
    """Return title, quantities and ranges of a panel."""
    titles = [plain(axes.get_title(loc)) for loc in ("left", "center", "right")]
    words = [f"“{'; '.join(filter(None, titles))}”"] if any(titles) else []
    # Panels that share an axis have its label once: on the one at the edge of the figure.
    label_x = plain(axes.get_xlabel() or _shared_label(axes, "x"))
    label_y = plain(axes.get_ylabel() or _shared_label(axes, "y"))
    if label_y:
        words.append(f"{label_y}, {_describe_range(axes.get_ylim(), _is_named(axes.yaxis))}")
    if label_x:
        over = "against " if label_y else ""
        words.append(f"{over}{label_x}, {_describe_range(axes.get_xlim(), _is_named(axes.xaxis))}")
    return ", ".join(words) or "without labels"


def _shared_label(axes: Axes, letter: str) -> str:
    group = getattr(axes, f"get_shared_{letter}_axes")()
    labels = [getattr(other, f"get_{letter}label")() for other in group.get_siblings(axes)]
    return next(filter(None, labels), "")


def _is_named(axis) -> list[str]:
    """Return the words at the ticks of an axis whose ticks are words."""
    formatter = axis.get_major_formatter()
    names = [plain(text) for text in getattr(formatter, "seq", [])]
    return [name for name in names if name and not re.fullmatch(r"[−\-\d.e]+", name)]


def _describe_range(limits: tuple[float, float], names: list[str]) -> str:
    if names:
        return f"one each of {', '.join(names)}"
    low, high = sorted(limits)
    return f"from {low:.3g} to {high:.3g}"


def _list_keys(figure: Figure) -> Iterator[str]:
    legends = [*figure.legends, *(axes.get_legend() for axes in figure.axes)]
    for legend in legends:
        if isinstance(legend, Legend):
            yield from (plain(text.get_text()) for text in legend.get_texts())
