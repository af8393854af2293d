"""The report of `replay`: the promise and what became of it, then spans, W, and what a log can say.

Angles are in degrees, lengths in millimetres.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxtube.coordinates import COORDINATES, KEYS, TO_DISPLAY
from jaxtube.experiments.identify.report import say_log
from jaxtube.experiments.run.table import WIDTH, Column, format_table, left, wrap
from jaxtube.statistics.intervals import CONFIDENCE
from jaxtube.witness.examine import Witness
from jaxtube.witness.model_sets import measure_usage
from jaxtube.witness.shares import Promise, Share, judge_promise
from jaxtube.witness.span_test import JUDGED, SpanTest
from jaxtube.witness.spans import KINDS
from sets.polytope import Polytope

MOST_STRETCHES = 12
"""That the report lists; spans.npz has all."""

MILLIMETRES = TO_DISPLAY * [1e3, 1e3, 1.0]
UNITS = ("mm", "mm", "deg")
SYMBOLS = tuple(f"w_{coordinate.plain}" for coordinate in COORDINATES)

MUCH_NOISE = 0.8
"""Share of noise in what w may be, from which a test is called weak."""


class Compared(NamedTuple):
    """One set beside the spans that it is compared with."""

    name: str
    half_widths: Float[np.ndarray, "3"]
    inside: float
    alone: Float[np.ndarray, "3"]
    usage: float


def report(witness: Witness, promise: Promise | None, name: str) -> str:
    """Return the report."""
    parts = [
        _say_promise(witness, promise, name),
        _say_spans(witness),
        *[_say_stretches(test) for test in _tests(witness)],
        _say_sets(witness),
        "\n".join(_say_limits(witness)),
        f"The log, {witness.findings.log.path}:\n{say_log(witness.findings)}",
    ]
    return "\n\n".join(part for part in parts if part)


def _tests(witness: Witness) -> list[SpanTest]:
    return [test for test in (witness.period, witness.longer) if test is not None]


def _say_promise(witness: Witness, promise: Promise | None, name: str) -> str:
    """Return what was promised of new commands, and what the windows of this log say."""
    windows = witness.windows
    share = windows.share
    if not share.commands:
        found = (
            "No steady window of this log drives both wheels forwards at "
            f"{windows.least_wheel:.3g} m/s and more: it says nothing of a promise."
        )
        return "\n".join(wrap(found))
    low, high = share.interval
    found = (
        f"Found: {share.whole} of {share.commands} commands have all of their steady windows of "
        f"{windows.length:g} s inside the slips and the sideslip of {name}; of new commands "
        f"{_percent(low)} to {_percent(high)} ({CONFIDENCE:.0%}, a command counts once). Of the "
        f"windows {share.inside} of {share.count} are inside, {_percent(share.value)}."
    )
    if promise is None:
        first = "Promised: nothing that is known (--promised gives it)."
    else:
        first = (
            f"Promised: at least {_percent(promise.share)} of new commands inside, "
            f"{promise.source}: {judge_promise(share, promise)}."
        )
    lines = [*wrap(first), *wrap(found)]
    outside = windows.steady & ~windows.inside
    if outside.any():
        times = ", ".join(f"{start:.1f}" for start in windows.start[outside][:MOST_STRETCHES])
        more = int(outside.sum()) - MOST_STRETCHES
        rest = f" and {more} more" if more > 0 else ""
        lines += wrap(f"Steady windows outside begin at {times} s{rest}.")
    return "\n".join(lines)


def _percent(share: float) -> str:
    """Return a share in per cent; one that is not all does not look so."""
    rounded = f"{100 * share:.3g} %"
    return "> 99.9 %" if rounded == "100 %" and share < 1.0 else rounded


def _say_spans(witness: Witness) -> str:
    """Return the table of what is explained, by length and kind of span."""
    columns = [
        left("spans"),
        Column("number"),
        Column("explained"),
        *[Column(symbol) for symbol in SYMBOLS],
        Column("refuted"),
        Column("undecided"),
        Column(f"whole\ncommands,\n{CONFIDENCE:.0%} of new"),
        Column("usage\n99 %"),
    ]
    rows = [_span_row(test, kind) for test in _tests(witness) for kind in JUDGED]
    head = wrap(
        "Explained: some slips, sideslip and pose noise that the scenario allows, with the wheels as "
        "they turned, give exactly the motion that was measured. By coordinate: w alone is one that "
        "it may be. Usage: by how much all that is allowed would have to be scaled, 1 at the limit."
    )
    table = format_table(columns, [row for row in rows if row], WIDTH)
    return "\n".join([*head, "", table, *_say_left_out(witness), *_say_noise(witness)])


def _span_row(test: SpanTest, kind) -> list[str]:
    share = test.share(kind)
    if not share.count:
        return []
    rows = test.spans.is_kind(kind)
    low, high = share.interval
    return [
        f"{np.median(test.spans.duration):.2g} s, {kind}",
        f"{share.count:,}",
        _percent(share.value),
        *[_percent(value) for value in test.inside_alone(kind)],
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
    for test in _tests(witness):
        shares = test.noise_share
        parts = zip(SYMBOLS, shares, strict=True)
        said = ", ".join(f"{100 * share:.0f} % of {symbol}" for symbol, share in parts)
        weak = "" if shares.min() < MUCH_NOISE else ": a weak test of slip"
        lines += wrap(
            f"Pose noise alone may be {said} in {np.median(test.spans.duration):.2g} s{weak}."
        )
    return lines


def _say_stretches(test: SpanTest) -> str:
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
    return f"{head}\n{format_table(columns, rows, WIDTH)}"


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


def _say_sets(witness: Witness) -> str:
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
            _percent(one.inside),
            *[_percent(value) for value in one.alone],
            f"{one.usage:.2f}",
        ]
        for one in compared
    ]
    assert not isinstance(witness.sets, str)
    head = wrap(
        f"The same w of {int(witness.sets.compared.sum()):,} spans of one period, whose wheels the "
        "controller may command, beside sets of its whole operation, as half widths: W, and the part "
        "of it that is slip, sideslip and noise. The rest of W is products and sines of errors and "
        "inputs, which no log can witness."
    )
    return "\n".join([*head, "", format_table(columns, rows, WIDTH)])


def _say_limits(witness: Witness) -> list[str]:
    """Return what a log can say, and what it cannot."""
    clock = witness.findings.clock
    lines = ["What this can say, and what it cannot:"]
    lines += wrap(
        "* w is the error of a reference that starts at a measured pose and drives as the nominal "
        "model does on the logged wheels, at the next pose. Wheel speeds are taken as logged: their "
        "lag is in them, their own error counts as slip."
    )
    lines += wrap(
        f"* clocks were aligned on this log itself, poses {clock.offset:.3f} s behind wheels; "
        "nothing else is fitted to it"
    )
    period = witness.period
    if period.spans.pieces > 1:
        lines += wrap(
            f"* poses come every {np.median(period.spans.duration):.2g} s, later than the "
            f"controller's period: slip may change {period.spans.pieces - 1} times in a span"
        )
    lines += wrap(
        "* spans of one command are not independent: shares of spans have no interval, commands do"
    )
    return lines


def metrics(witness: Witness, promise: Promise | None) -> dict[str, Any]:
    """Return the numbers of a replay."""
    share = witness.windows.share
    return {
        "promised_share": promise.share if promise else None,
        "windows": _measure_share(share),
        "verdict_on_promise": judge_promise(share, promise) if promise else None,
        "confidence": CONFIDENCE,
        "period": _measure_test(witness.period),
        "longer": _measure_test(witness.longer) if witness.longer else None,
        "not_compared": witness.sets if isinstance(witness.sets, str) else None,
        "sets": [
            {
                "name": one.name,
                "half_widths": _by_coordinate(one.half_widths * TO_DISPLAY),
                "share_inside": one.inside,
                "share_inside_alone": _by_coordinate(one.alone),
                "greatest_usage": one.usage,
            }
            for one in compare(witness)
        ],
        "poses_behind_wheels_s": witness.findings.clock.offset,
    }


def _measure_share(share: Share) -> dict[str, Any]:
    return {
        "inside": share.inside,
        "count": share.count,
        "commands_whole": share.whole,
        "commands": share.commands,
        "share_of_commands_interval": share.interval,
    }


def _measure_test(test: SpanTest) -> dict[str, Any]:
    kinds = {kind: int(test.every.is_kind(kind).sum()) for kind in KINDS}
    judged = {
        kind: _measure_share(test.share(kind))
        | {"inside_alone": _by_coordinate(test.inside_alone(kind))}
        for kind in JUDGED
    }
    return {
        "duration_s": float(np.median(test.spans.duration)),
        "spans": kinds,
        **judged,
        "refuted": int(test.verdict.refuted.sum()),
        "undecided": int(test.verdict.undecided.sum()),
        "greatest_usage": float(test.verdict.usage.max()),
        "noise_share": _by_coordinate(test.noise_share),
        "not_explained_s": [
            [float(test.spans.start[run[0]]), float(test.spans.end[run[-1]])]
            for run in test.stretches()
        ],
    }


def _by_coordinate(values: Float[np.ndarray, "3"]) -> dict[str, float]:
    return dict(zip(KEYS, values.tolist(), strict=True))
