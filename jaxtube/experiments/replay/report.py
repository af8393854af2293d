"""The report of `replay`: the promise and what became of it, spans, W, and what a log can say."""

from __future__ import annotations

import numpy as np

from jaxtube.experiments.identify.report import say_log
from jaxtube.experiments.replay.set_table import say_sets
from jaxtube.experiments.replay.span_tables import list_tests, say_spans, say_stretches
from jaxtube.experiments.replay.words import say_percent
from jaxtube.experiments.run.table import wrap
from jaxtube.reporting.page import Page
from jaxtube.statistics.intervals import CONFIDENCE
from jaxtube.witness.examine import Witness
from jaxtube.witness.shares import QuotedPromise, is_own_log, judge_promise

MOST_TIMES = 12
"""Of windows that the report lists."""


def report(witness: Witness, promise: QuotedPromise | None, name: str) -> str:
    """Return the report."""
    parts = [
        say_verdict(witness, promise),
        _say_promise(witness, promise, name),
        say_spans(witness),
        *[say_stretches(test) for test in list_tests(witness)],
        say_sets(witness),
        "\n".join(_say_limits(witness)),
        f"The log, {witness.findings.log.path}:\n{say_log(witness.findings)}",
    ]
    return "\n\n".join(part for part in parts if part)


def say_verdict(witness: Witness, promise: QuotedPromise | None) -> str:
    """Return one line: what this log says of the promise, and how many of its commands are
    inside."""
    share = witness.windows.share
    if not share.commands:
        return "NO WITNESS: no steady window of this log drives both wheels forwards fast enough"
    inside = f"{share.whole} of {share.commands} commands are inside"
    if is_own_log(promise, witness.findings.log.path):
        return f"NO WITNESS: the scenario was made of this log; {inside}"
    if promise is None:
        return f"nothing was promised that is known; {inside}"
    judged = judge_promise(share, promise)
    return f"{judged}: promised {say_percent(promise.share)} of new commands, {inside}"


def make_page(witness: Witness, promise: QuotedPromise | None, name: str) -> Page:
    """Return the page of a replay."""
    verdict = say_verdict(witness, promise)
    return Page(
        verdict,
        "bad" if verdict.startswith("BROKEN") else "plain",
        _list_promise(witness, promise, name),
        not_covered=_list_limits(witness),
        not_covered_lead="What this can say, and what it cannot:",
    )


def _say_promise(witness: Witness, promise: QuotedPromise | None, name: str) -> str:
    """Return what was promised of new commands, and what the windows of this log say."""
    sentences = _list_promise(witness, promise, name)
    return "\n".join(line for sentence in sentences for line in wrap(sentence))


def _list_promise(witness: Witness, promise: QuotedPromise | None, name: str) -> list[str]:
    """Return the same, a sentence each."""
    windows = witness.windows
    share = windows.share
    if not share.commands:
        return [
            "No steady window of this log drives both wheels forwards at "
            f"{windows.least_wheel:.3g} m/s and more: it says nothing of a promise."
        ]
    low, high = share.interval
    found = (
        f"Found: {share.whole} of {share.commands} commands have all of their steady windows of "
        f"{windows.length:g} s inside the slips and the sideslip of {name}; of new commands "
        f"{say_percent(low)} to {say_percent(high)} ({CONFIDENCE:.0%}, a command counts once). Of "
        f"the windows {share.inside} of {share.count} are inside, {say_percent(share.value)}."
    )
    if is_own_log(promise, witness.findings.log.path):
        first = (
            "This is the log that the scenario was made of: it says nothing of new commands, "
            "whatever stands below. Replay one that was recorded besides."
        )
    elif promise is None:
        first = "Promised: nothing that is known (--promised gives it)."
    else:
        first = (
            f"Promised: at least {say_percent(promise.share)} of new commands inside "
            f"({promise.source}): {judge_promise(share, promise)}."
        )
    sentences = [first, found]
    outside = windows.steady & ~windows.inside
    if outside.any():
        times = ", ".join(f"{start:.1f}" for start in windows.start[outside][:MOST_TIMES])
        more = int(outside.sum()) - MOST_TIMES
        rest = f" and {more} more" if more > 0 else ""
        sentences.append(f"Steady windows outside begin at {times} s{rest}.")
    return sentences


def _say_limits(witness: Witness) -> list[str]:
    """Return what a log can say, and what it cannot, as lines."""
    lines = ["What this can say, and what it cannot:"]
    for sentence in _list_limits(witness):
        lines += wrap(f"* {sentence}")
    return lines


def _list_limits(witness: Witness) -> list[str]:
    """Return the same, a sentence each."""
    clock = witness.findings.clock
    told = [
        "w is the error of a reference that starts at a measured pose and drives as the nominal "
        "model does on the logged wheels, at the next pose. Wheel speeds are taken as logged: "
        "their lag is in them, their own error counts as slip.",
        f"clocks were aligned on this log itself, poses {clock.offset:.3f} s behind wheels; "
        "nothing else is fitted to it",
    ]
    period = witness.period
    if period.spans.pieces > 1:
        told.append(
            f"poses come every {np.median(period.spans.duration):.2g} s, later than the "
            f"controller's period: slip may change {period.spans.pieces - 1} times in a span"
        )
    told.append(
        "spans of one command are not independent: shares of spans have no interval, commands do"
    )
    return told
