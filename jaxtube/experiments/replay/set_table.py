"""The table of W, and of the part of it that a log can witness, beside the spans of a period."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxtube.experiments.replay.words import MILLIMETRES, SYMBOLS, UNITS, say_percent
from jaxtube.experiments.run.table import Column, format_table, left, wrap
from jaxtube.witness.examine import Witness
from jaxtube.witness.model_sets import measure_usage
from sets.polytope import Polytope


class Compared(NamedTuple):
    """One set beside the spans that it is compared with."""

    name: str
    half_widths: Float[np.ndarray, "3"]
    inside: float
    alone: Float[np.ndarray, "3"]
    usage: float


def compare(witness: Witness) -> list[Compared]:
    """Return W and its part beside the spans that they are compared with."""
    sets = witness.sets
    if isinstance(sets, str) or not sets.compared.any():
        return []
    w = witness.period.measured[sets.compared]
    kind = "computed" if sets.is_computed else "assumed"
    named = {"slip, sideslip, noise": sets.part, f"W, {kind}": sets.whole}
    return [_compare(name, polytope, w) for name, polytope in named.items()]


def _compare(name: str, polytope: Polytope, w: Float[np.ndarray, "k 3"]) -> Compared:
    usage = measure_usage(polytope, w)
    half_widths = polytope.support(np.eye(3))
    alone = np.mean(np.abs(w) <= half_widths, axis=0)
    return Compared(name, half_widths, float(np.mean(usage <= 1.0)), alone, float(usage.max()))


def say_sets(witness: Witness) -> str:
    """Return the table of W and its part."""
    compared = compare(witness)
    if not compared:
        sets = witness.sets
        reason = sets if isinstance(sets, str) else "no span has wheels that are commanded in it"
        return "\n".join(wrap(f"Not compared with W: {reason}."))
    columns = [
        left("set"),
        *[Column(symbol, unit) for symbol, unit in zip(SYMBOLS, UNITS, strict=True)],
        Column("inside"),
        *[Column(f"{symbol}\nalone") for symbol in SYMBOLS],
        Column("greatest\nusage"),
    ]
    rows = [
        [
            one.name,
            *[f"{value:.2f}" for value in one.half_widths * MILLIMETRES],
            say_percent(one.inside),
            *[say_percent(value) for value in one.alone],
            f"{one.usage:.2f}",
        ]
        for one in compared
    ]
    assert not isinstance(witness.sets, str)
    head = wrap(
        f"The same w of {int(witness.sets.compared.sum()):,} spans of one period, whose wheels the "
        "controller may command, beside sets of its whole operation, as half widths: W, and the "
        "part of it that is slip, sideslip and noise. The rest of W is products and sines of "
        "errors and inputs, which no log can witness."
    )
    return "\n".join([*head, "", format_table(columns, rows)])
