"""What a user says about a file where guessing would not do: columns, topics, units, sizes.

Source: new.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType

NOTHING: Mapping[str, str] = MappingProxyType({})


@dataclass(frozen=True)
class Hints:
    """What is said about a file beside the file itself.

    Attributes:
        columns: columns of a table by what they hold, such as {"left": "wl"}; a column's name, its
            number from 1 on, or a sum: {"time": "sec+nsec"} of seconds and nanoseconds,
            {"left": "front+rear"} of wheels that are averaged.
        units: of columns by what they hold, such as {"left": "rad/s", "heading": "deg"}.
        topics: topics of a bag by what they hold: "wheels", "poses", "commands"; of a tf topic with
            its frames, such as "/tf:map:base_link".
        wheel_radius_m: for wheels in rad/s, rpm or ticks; None where they are in m/s.
        ticks_per_revolution: of a wheel, for encoder ticks.
        pose_file: table with the poses where the log itself has none, such as a TUM pose file; the
            columns of poses are then sought there, its times in the column "pose_time".
    """

    columns: Mapping[str, str] = field(default_factory=lambda: NOTHING)
    units: Mapping[str, str] = field(default_factory=lambda: NOTHING)
    topics: Mapping[str, str] = field(default_factory=lambda: NOTHING)
    wheel_radius_m: float | None = None
    ticks_per_revolution: float | None = None
    pose_file: str | Path | None = None

    def of_pose_file(self) -> Hints:
        """Return what is said about the pose file."""

        def rename(pairs: Mapping[str, str]) -> dict[str, str]:
            others = {name: value for name, value in pairs.items() if name != "time"}
            return {name.replace("pose_time", "time"): others[name] for name in others}

        return replace(self, columns=rename(self.columns), units=rename(self.units))

    def require_radius(self, path: str, what: str) -> float:
        """Return the wheel radius, m.

        Raises:
            ValueError: in one line, where it was not given or is not positive.
        """
        return _require(
            path, what, "--wheel-radius", self.wheel_radius_m, "the wheel radius in m", "0.165"
        )

    def require_ticks(self, path: str, what: str) -> float:
        """Return the encoder's ticks per revolution of the wheel.

        Raises:
            ValueError: in one line, where they were not given or are not positive.
        """
        return _require(
            path, what, "--ticks", self.ticks_per_revolution, "the ticks per revolution", "2048"
        )


def _require(
    path: str, what: str, option: str, value: float | None, words: str, example: str
) -> float:
    """Return a size that a unit needs, positive."""
    if value is None:
        raise ValueError(f"{path}: {what}: {words} is needed; give {option} {example}")
    if not 0.0 < value < float("inf"):
        raise ValueError(f"{option} = {value}: is no positive number; give one, such as {example}")
    return float(value)


NO_HINTS = Hints()


def parse_pairs(option: str, text: str, known: tuple[str, ...]) -> dict[str, str]:
    """Read "left=wl,right=wr", the text of an option, to a mapping.

    Args:
        option: its name, for messages.
        text: to read; empty for nothing.
        known: what may stand on the left.

    Raises:
        ValueError: in one line, for what is no pair, and for names that are unknown or given twice.
    """
    pairs: dict[str, str] = {}
    for part in filter(str.strip, text.split(",")):
        name, sign, value = (piece.strip() for piece in part.partition("="))
        if not sign or not value:
            raise ValueError(f"{option}: {part.strip()} is no pair; write {known[0]}=NAME,...")
        if name not in known:
            raise ValueError(f"{option}: {name} is unknown; name one of {', '.join(known)}")
        if name in pairs:
            raise ValueError(f"{option}: {name} is given twice; give it once")
        pairs[name] = value
    return pairs
