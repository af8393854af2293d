"""What a page reports: a verdict of one sentence, then sections of tables, bars, conditions and
lists.

Commands fill these in with words and numbers; how they look is for `jaxtube.reporting.document`
alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, NamedTuple

Tone = Literal["good", "bad", "plain"]
"""Whether a word is good news, bad news or neither; always beside the word, never instead of it."""

MOST_DRAWN = 1.5
"""Share of a limit at which a bar ends; a longer one says so in its words."""
DECADES = 6
"""Of the margins that a bar distinguishes, from 1e-5 to 10."""


class Words(NamedTuple):
    """A cell, or a verdict, that is good or bad news."""

    text: str
    tone: Tone = "plain"


Cell = str | Words


class Heading(NamedTuple):
    """The heading of a column; numbers go to the right."""

    text: str
    number: bool = False


@dataclass(frozen=True)
class Table:
    """A table: its first column names the rows."""

    title: str
    headings: Sequence[Heading]
    rows: Sequence[Sequence[Cell]]
    note: str = ""
    kind: ClassVar[str] = "table"

    @property
    def is_prose(self) -> bool:
        """Whether all cells are words, which narrow screens put under each other."""
        return not any(heading.number for heading in self.headings)


class Bar(NamedTuple):
    """What is used of a limit: a share of 1 reaches it, NaN or infinity is drawn as beyond."""

    label: str
    share: float
    words: str
    is_judged: bool = True  # whether going beyond is bad news

    @property
    def percent(self) -> float:
        """Width of the bar in percent of the row; the limit is at 100 / MOST_DRAWN."""
        return 100 * max(min(_finite(self.share), MOST_DRAWN), 0.0) / MOST_DRAWN

    @property
    def tone(self) -> Tone:
        """Bad beyond the limit; NaN is beyond."""
        if not self.is_judged:
            return "plain"
        return "good" if self.share <= 1 else "bad"


@dataclass(frozen=True)
class Bars:
    """Bars against their limits."""

    title: str
    bars: Sequence[Bar]
    note: str = ""
    kind: ClassVar[str] = "bars"


class Interval(NamedTuple):
    """A share that was counted, with the bounds that hold for it."""

    label: str
    count: str
    share: float
    low: float
    high: float


@dataclass(frozen=True)
class Intervals:
    """Counted shares with their bounds, on a logarithmic axis from `least` to 1."""

    title: str
    rows: Sequence[Interval]
    note: str = ""
    kind: ClassVar[str] = "intervals"

    @property
    def decades(self) -> int:
        """Powers of ten on the axis."""
        least = [row.low or row.share or row.high for row in self.rows]
        smallest = min((value for value in least if value > 0), default=0.1)
        return max(1, min(12, math.ceil(-math.log10(smallest))))

    def place(self, share: float) -> float:
        """Return the place of a share on the axis, percent of its length."""
        if not share > 0:
            return 0.0
        return 100 * min(max(1 + math.log10(share) / self.decades, 0.0), 1.0)


class ConditionRow(NamedTuple):
    """A condition of a certificate: what it says, and by how much it holds or fails."""

    name: str
    holds: bool
    required: bool
    scope: str
    margin: float
    margin_words: str
    sentence: str

    @property
    def tone(self) -> Tone:
        """Good where it holds; what decides nothing is plain."""
        if not self.required:
            return "plain"
        return "good" if self.holds else "bad"

    @property
    def percent(self) -> float:
        """Length of the bar from the limit, percent of its half: logarithmic, of the size of the
        margin."""
        size = abs(self.margin)
        if not math.isfinite(size):
            return 100.0 if self.required else 0.0
        if size == 0:
            return 2.0
        return 100 * min(max((math.log10(size) + DECADES - 1) / DECADES, 0.02), 1.0)


@dataclass(frozen=True)
class Conditions:
    """The conditions of a certificate."""

    title: str
    rows: Sequence[ConditionRow]
    note: str = ""
    kind: ClassVar[str] = "conditions"


@dataclass(frozen=True)
class Listing:
    """Paragraphs, or items of a list."""

    items: Sequence[str]
    title: str = ""
    bulleted: bool = True
    note: str = ""
    kind: ClassVar[str] = "listing"


Part = Table | Bars | Intervals | Conditions | Listing


class Section(NamedTuple):
    """A section of a page: its title and what stands in it."""

    title: str
    parts: Sequence[Part]

    @property
    def anchor(self) -> str:
        """Name of the place in the page."""
        words = "".join(letter if letter.isalnum() else "-" for letter in self.title.lower())
        return f"section-{words}"


@dataclass(frozen=True)
class Page:
    """The report of a run.

    Attributes:
        verdict: one line, that of the printed report; the first thing that is read.
        tone: whether it is good news.
        lead: sentences that stand right under it.
        sections: in the order in which they are read.
        not_covered: what the guarantee takes for granted and what it says nothing about.
        player: laps to play, from `jaxtube.reporting.player`; None for a run without.
        not_covered_lead: what introduces `not_covered`.
    """

    verdict: str
    tone: Tone = "plain"
    lead: Sequence[str] = ()
    sections: Sequence[Section] = ()
    not_covered: Sequence[str] = ()
    player: Mapping[str, Any] | None = None
    not_covered_lead: str = (
        "What holds above takes this for granted, and says nothing about a robot for which it is "
        "not so:"
    )


class Picture(NamedTuple):
    """A figure of a run: its name, what it shows, the same in words, and its PNG."""

    name: str
    caption: str
    alternative: str
    png: bytes


@dataclass(frozen=True)
class Run:
    """What a page says of the run itself.

    Attributes:
        title: command and scenario.
        printed: the text that was printed.
        manifest: versions, platform, hashes, seed and date.
        pictures: in the order in which they were drawn.
    """

    title: str
    printed: str = ""
    manifest: Mapping[str, Any] = field(default_factory=dict)
    pictures: Sequence[Picture] = ()


def _finite(value: float) -> float:
    return value if math.isfinite(value) else MOST_DRAWN
