"""What a search of a closed loop found, whatever the system."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic

from jaxtube.falsification.cases import Row, list_worst_first
from jaxtube.falsification.setting import DesignType, LoopLimits
from jaxtube.falsification.worst import Worst
from jaxtube.simulation.promise import describe_certificate


@dataclass(frozen=True, eq=False, repr=False)
class WorstCases(Generic[DesignType]):
    """The worst case of each limit of a closed loop.

    Attributes:
        limits: that were searched, and whose they are.
        seed: of every draw.
        rows: by limit: the worst case, its search, and drawn laps to compare with.
    """

    limits: LoopLimits[DesignType]
    seed: int
    rows: dict[str, Row]

    @property
    def design(self) -> DesignType:
        """The design whose limits were searched."""
        return self.limits.design

    @property
    def worst(self) -> Worst:
        """The worst case of all limits, by usage."""
        return self.rows[list_worst_first(self.rows)[0]].worst

    @property
    def is_violated(self) -> bool:
        """Whether any limit is left by more than rounding."""
        return any(row.is_violated for row in self.rows.values())

    @property
    def verdict(self) -> str:
        """What was found, in one line."""
        raise NotImplementedError

    def __repr__(self) -> str:
        loop = f"{self.limits.controller} on the {self.limits.plant}"
        searched = sum(row.search.laps for row in self.rows.values())
        return (
            f"<{type(self).__name__}: {self.verdict}\n{loop}; {searched:,} laps by gradient; "
            f"{describe_certificate(self.design, self.limits.controller)}>"
        )
