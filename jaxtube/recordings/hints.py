"""What a user says about a file where guessing would not do: columns, topics, units, sizes.

Source: new.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType

from jaxtube.recordings.usual_names import LOG_ROLES, WINDOW_ROLES

COLUMN_NAMES = tuple(
    dict.fromkeys([*(role.name for role in (*LOG_ROLES, *WINDOW_ROLES)), "pose_time"])
)
"""What `--columns` and `--units` can name."""

TOPIC_NAMES = ("wheels", "left", "right", "poses", "commands")
"""What `--topics` can name."""

NOTHING: Mapping[str, str] = MappingProxyType({})


@dataclass(frozen=True)
class Hints:
    """What is said about a file beside the file itself.

    Attributes:
        columns: columns of a table by what they hold, such as {"left": "wl"}; a column's name, its
            number from 1 on, or a sum: {"time": "sec+nsec"} of seconds and nanoseconds,
            {"left": "front+rear"} of wheels that are averaged.
        units: of columns by what they hold, such as {"left": "rad/s", "heading": "deg"}.
        topics: topics of a bag by what they hold: "wheels", "poses", "commands"; a topic of
            transforms with its frames, as in "/tf:map:base_link"; "left" and "right" are topics of
            numbers with their field, as in "/left_drive/status:speed".
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

    def __post_init__(self) -> None:
        """Refuse what no column or topic can hold.

        Raises:
            ValueError: in one line.
        """
        _require_known("--columns", self.columns, COLUMN_NAMES)
        _require_known("--units", self.units, COLUMN_NAMES)
        _require_known("--topics", self.topics, TOPIC_NAMES)

    def find_unit(self, name: str) -> str | None:
        """Return the unit that is said of what a column holds, None for none; what is said of one
        wheel holds for the other."""
        other = {"left": "right", "right": "left"}.get(name, name)
        return self.units.get(name, self.units.get(other))

    def of_pose_file(self) -> Hints:
        """Return what is said about the pose file."""

        return replace(self, columns=_rename_time(self.columns), units=_rename_time(self.units))

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


def _rename_time(pairs: Mapping[str, str]) -> dict[str, str]:
    """Return what is said of columns, "pose_time" in the place of "time"."""
    others = {name: value for name, value in pairs.items() if name not in ("time", "pose_time")}
    return {**others, "time": pairs["pose_time"]} if "pose_time" in pairs else others


def _require(
    path: str, what: str, option: str, value: float | None, words: str, example: str
) -> float:
    """Return a size that a unit needs, positive."""
    if value is None:
        raise ValueError(f"{path}: {what}: {words} is needed; give {option} {example}")
    if not 0.0 < value < float("inf"):
        raise ValueError(f"{option} = {value}: is no positive number; give one, such as {example}")
    return float(value)


def _require_known(option: str, pairs: Mapping[str, str], known: Sequence[str]) -> None:
    """Refuse names that mean nothing."""
    for name in pairs:
        if name not in known:
            raise ValueError(
                f"{option} {name}={pairs[name]}: {name} is unknown; name one of {', '.join(known)}"
            )


NO_HINTS = Hints()


def parse_pairs(option: str, text: str) -> dict[str, str]:
    """Read "left=wl,right=wr", the text of an option such as `--columns`, to a mapping.

    Args:
        option: its name, for messages.
        text: to read; empty for nothing. A comma within quotes is part of a value.

    Raises:
        ValueError: in one line, for what is no pair, and for names that are given twice.
    """
    pairs: dict[str, str] = {}
    parts = next(csv.reader([text], skipinitialspace=True), [])
    for part in filter(str.strip, parts):
        name, sign, value = part.partition("=")
        if not sign or not value.strip():
            raise ValueError(f"{option}: {part.strip()} is no pair; write NAME=VALUE,NAME=VALUE")
        if name.strip() in pairs:
            raise ValueError(f"{option}: {name.strip()} is given twice; give it once")
        pairs[name.strip()] = value.strip()
    return pairs
