"""How often an event was seen in a run, with an exact interval."""

from __future__ import annotations

from typing import NamedTuple


class Share(NamedTuple):
    """How often an event was seen, with the interval of the share of laps at 95 % confidence."""

    laps: int
    of: int
    low: float
    high: float

    def __repr__(self) -> str:
        return (
            f"{self.laps:,} of {self.of:,} laps, share {self.low:.3g} to {self.high:.3g} "
            "at 95 % confidence"
        )
