"""The figure of `guarantee`: how often laps of each law left W and E, design by design."""

from __future__ import annotations

from matplotlib.figure import Figure

from jaxtube.experiments.guarantee.claims import DesignUnderTest
from jaxtube.figures.shares import (
    DrawnRow,
    draw_shares,
    find_least,
    make_shares,
    share_keys,
    typeset_event,
)
from jaxtube.figures.style import bottom_legend, page_figure, styled

EVENTS = ("w_outside_W", "e_outside_E")
ROW = 0.32
"""Height of a law, inches."""


@styled
def laws_figure(tested: list[DesignUnderTest]) -> Figure:
    """Draw the shares of laps and steps outside W and E under each law, a column a design."""
    most_laws = max(len(design.laws) for design in tested)
    figure = page_figure(1.6 + 2 * ROW * most_laws)
    panels = figure.subplots(len(EVENTS), len(tested), sharex=True, sharey=True, squeeze=False)
    every = []
    for row, event in zip(panels, EVENTS, strict=True):
        for axes, design in zip(row, tested, strict=True):
            rows = [
                DrawnRow(name, make_shares(law["events"][event]))
                for name, law in design.laws.items()
            ]
            draw_shares(axes, rows)
            axes.set_title(f"design “{design.name}”: {typeset_event(event)}")
            every += rows
    panels[0, 0].set_xlim(find_least(every), 1.6)
    for axes in panels[0]:
        axes.set_xlabel("")
    confidence = next(iter(tested[0].laws.values()))["confidence"]
    bottom_legend(figure, share_keys(every, confidence))
    return figure
