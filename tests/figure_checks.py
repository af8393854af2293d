"""What every figure keeps: it is drawn and saved without a warning, and its axes tell units."""

import io
import warnings

PURE_NUMBERS = ("iteration", "laps", "largest share", "plans", "share", "stage", "steps")
"""Beginnings of the labels of axes that have no unit."""


def save(figure):
    """Save a figure, a warning being an error, and return it.

    Small as PNG, which is drawn the fastest; the commands save large ones, and PDF.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        figure.savefig(io.BytesIO(), format="png", dpi=50)
    return figure


def assert_presentable(figure):
    """Save a figure; every label of an axis tells a unit, or counts something."""
    save(figure)
    for axes in figure.axes:
        for label in (axes.get_xlabel(), axes.get_ylabel()):
            has_unit = "[" in label or ", in m and rad" in label
            assert not label or has_unit or label.startswith(PURE_NUMBERS), label


def legend_texts(figure):
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def extent(patch):
    """Return the least and the greatest coordinates of a polygon, the second as [1]."""
    corners = patch.get_xy()
    return [corners.min(axis=0), corners.max(axis=0)]
