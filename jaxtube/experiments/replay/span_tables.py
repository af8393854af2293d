"""Tables of spans: what is explained, by length and kind, and where nothing allowed does."""

from __future__ import annotations

import numpy as np

from jaxtube.experiments.replay.words import MILLIMETRES, SYMBOLS, UNITS, say_percent
from jaxtube.experiments.run.table import Column, format_table, left, wrap
from jaxtube.statistics.intervals import CONFIDENCE
from jaxtube.witness.examine import Witness
from jaxtube.witness.span_test import JUDGED, SpanTest
from jaxtube.witness.spans import KINDS, Kind

MOST_STRETCHES = 12
"""That the report lists; spans.npz has all."""

MUCH_NOISE = 0.8
"""Share of noise in what w may be, from which a test is called weak."""


def list_tests(witness: Witness) -> list[SpanTest]:
    return [test for test in (witness.period, witness.longer) if test is not None]


def say_spans(witness: Witness) -> str:
    """Return the table of what is explained, by length and kind of span."""
    columns = [
        left("spans"),
        Column("count"),
        Column("explained"),
        *[Column(symbol) for symbol in SYMBOLS],
        Column("refuted"),
        Column("undecided"),
        Column(f"whole\ncommands,\n{CONFIDENCE:.0%} of new"),
        Column("usage\n99 %"),
    ]
    rows = [_span_row(test, kind) for test in list_tests(witness) for kind in JUDGED]
    head = wrap(
        "Explained: some slips, sideslip and pose noise that the scenario allows, with the wheels "
        "as they turned, give exactly the motion that was measured. By coordinate: w alone is one "
        "that it may be. Usage: by how much all that is allowed would have to be scaled, 1 at the "
        "limit."
    )
    table = format_table(columns, [row for row in rows if row])
    return "\n".join([*head, "", table, *_say_left_out(witness), *_say_noise(witness)])


def _span_row(test: SpanTest, kind: Kind) -> list[str]:
    share = test.share(kind)
    if not share.count:
        return []
    rows = test.spans.is_kind(kind)
    low, high = share.interval
    return [
        f"{np.median(test.spans.duration):.2g} s, {kind}",
        f"{share.count:,}",
        say_percent(share.value),
        *[say_percent(value) for value in test.inside_alone(kind)],
        f"{test.verdict.refuted[rows].sum()}",
        f"{test.verdict.undecided[rows].sum()}",
        f"{share.whole} of {share.commands}\n{100 * low:.0f} to {100 * high:.0f} %",
        f"{np.percentile(test.verdict.usage[rows], 99):.2f}",
    ]


def _say_left_out(witness: Witness) -> list[str]:
    """Return the spans of a period that were not judged."""
    every = witness.period.every
    counts = {kind: int(every.is_kind(kind).sum()) for kind in KINDS if kind not in JUDGED}
    robot = witness.scenario.robot
    words = {
        "lost": "touch a cut or a gap of the wheels",
        "standing": "stand",
        "beyond": (
            f"have a wheel outside {robot.wheel_speed_min_mps:g} to "
            f"{robot.wheel_speed_max_mps:g} m/s"
        ),
    }
    said = [f"{counts[kind]:,} {words[kind]}" for kind in counts if counts[kind]]
    return wrap(f"Of a period, not judged: {', '.join(said) or 'none'}.")


def _say_noise(witness: Witness) -> list[str]:
    """Return how much of the allowance is noise."""
    lines = []
    for test in list_tests(witness):
        shares = test.noise_share
        parts = zip(SYMBOLS, shares, strict=True)
        said = ", ".join(f"{100 * share:.0f} % of {symbol}" for symbol, share in parts)
        weak = "" if shares.min() < MUCH_NOISE else ": a weak test of slip"
        lines += wrap(
            f"Pose noise alone may be {said} in {np.median(test.spans.duration):.2g} s{weak}."
        )
    return lines


def say_stretches(test: SpanTest) -> str:
    """Return where spans are not explained, the worst first."""
    stretches = test.stretches()
    if not stretches:
        return ""
    columns = [
        Column("from", "s"),
        Column("to", "s"),
        Column("spans"),
        Column("command"),
        Column("usage"),
        *[Column(symbol, unit) for symbol, unit in zip(SYMBOLS, UNITS, strict=True)],
        left("beyond"),
        left("proved"),
    ]
    rows = [_stretch_row(test, run) for run in stretches[:MOST_STRETCHES]]
    count = sum(len(run) for run in stretches)
    more = ", the worst" if len(stretches) > MOST_STRETCHES else ""
    head = f"Not explained, {count} spans of {np.median(test.spans.duration):.2g} s{more}:"
    return f"{head}\n{format_table(columns, rows)}"


def _stretch_row(test: SpanTest, run: np.ndarray) -> list[str]:
    worst = run[np.argmax(test.verdict.usage[run])]
    w = test.measured[worst] * MILLIMETRES
    excess = test.verdict.excess[worst] * MILLIMETRES
    beyond = [
        f"{symbol} by {value:.3g} {unit}"
        for symbol, value, unit in zip(SYMBOLS, excess, UNITS, strict=True)
        if value > 0.0
    ]
    return [
        f"{test.spans.start[run[0]]:.2f}",
        f"{test.spans.end[run[-1]]:.2f}",
        f"{len(run)}",
        f"{test.spans.command[worst]}",
        f"{test.verdict.usage[worst]:.2f}",
        *[f"{value:.1f}" for value in w],
        ", ".join(beyond) or "all three together",
        "refuted" if test.verdict.refuted[worst] else "undecided",
    ]
