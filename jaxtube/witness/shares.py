"""Shares of a log, and what they say of new commands.

Spans and windows of one command are not independent: their share has no interval. Commands are as
independent as they will ever be; a command is whole where all of its own are inside, and the number
of whole commands has the interval of Clopper and Pearson.

Source: `jaxtube.statistics.intervals`.
"""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int

from jaxtube.recordings.fingerprint import find_fingerprint
from jaxtube.statistics.intervals import share_interval

PROMISE = re.compile(
    r"holds for at least (?P<share>\d+) % of new commands at (?P<confidence>\d+) % confidence"
)
"""As `jaxtube.identification.words.say_promise` writes it."""

FINGERPRINT = re.compile(r"SHA-256 of the file begins with (?P<digits>[0-9a-f]+)")
"""As `jaxtube.identification.scenario_text` writes it, of the log that a promise comes from."""


class Share(NamedTuple):
    """How many are inside."""

    inside: int
    count: int
    whole: int  # commands
    commands: int

    @property
    def value(self) -> float:
        """Share inside, NaN of none."""
        return self.inside / self.count if self.count else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """Bounds of the share of new commands that are whole."""
        return share_interval(self.whole, self.commands) if self.commands else (0.0, 1.0)


class QuotedPromise(NamedTuple):
    """What was promised of new commands.

    Attributes:
        share: of them that is inside, at least.
        source: of the promise, in words.
        sentence: that it stands in, to be carried on; empty for one given otherwise.
        fingerprint: of the log that it comes from; empty where that is not known.
    """

    share: float
    source: str
    sentence: str = ""
    fingerprint: str = ""


def count_share(inside: Bool[np.ndarray, "k"], command: Int[np.ndarray, "k"]) -> Share:
    """Count what is inside, and the commands that are whole."""
    commands = np.unique(command)
    failed = np.unique(command[~inside])
    return Share(int(inside.sum()), len(inside), len(commands) - len(failed), len(commands))


def find_promise(text: str) -> QuotedPromise | None:
    """Return the promise that stands in the comments of a scenario file; None where none does."""
    comments = [line.strip()[1:] for line in text.splitlines() if line.strip().startswith("#")]
    told = " ".join(" ".join(comments).split())
    found = PROMISE.search(told)
    if found is None:
        return None
    origin = FINGERPRINT.search(told)
    words = [f"Its box of slips {found.group()}.", f"{origin.group()}." if origin else ""]
    return QuotedPromise(
        int(found["share"]) / 100,
        "in the scenario's file",
        " ".join(filter(None, words)),
        origin["digits"] if origin else "",
    )


def is_own_log(promise: QuotedPromise | None, path: str) -> bool:
    """Whether a promise comes from the log of this file, which then says nothing of it."""
    if promise is None or not promise.fingerprint:
        return False
    return promise.fingerprint == find_fingerprint(path)


def judge_promise(share: Share, promise: QuotedPromise) -> str:
    """Return what a log says of a promise, in words."""
    low, high = share.interval
    if not share.commands:
        return "this log has no command that it is about"
    if high < promise.share:
        return "BROKEN: the log contradicts it"
    return "kept: this log alone shows as much" if low >= promise.share else "not contradicted"
