"""Options of the commands that read the log of a robot or the file of a path."""

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, Suppress, arg

from jaxtube.experiments.options.common import Options, title
from jaxtube.experiments.options.rules import (
    LOG_FILE,
    MARGIN,
    PATH_FILE,
    POSITIVE_OR_NONE,
    RATE,
    SCENARIO,
    SHARE,
    WINDOW,
)


@dataclass(frozen=True)
class LogOptions(Options):
    """What every command takes that reads a robot's log."""

    positional = ("log",)

    log: Annotated[Positional[str], arg(metavar="LOG", help_behavior_hint=""), LOG_FILE] = ""
    """a table (CSV) or a bag of wheel speeds and poses"""
    columns: Annotated[str, arg(metavar="WHAT=NAME,...", help_behavior_hint="")] = ""
    """columns where they are not found, such as left=wl,right=wr"""
    units: Annotated[str, arg(metavar="WHAT=UNIT,...", help_behavior_hint="")] = ""
    """units of columns, such as left=rad/s,right=rad/s,heading=deg"""
    topics: Annotated[str, arg(metavar="WHAT=TOPIC,...", help_behavior_hint="")] = ""
    """topics of a bag: wheels, poses, commands"""
    wheel_radius: Annotated[
        float | None, arg(metavar="METRES", help_behavior_hint=""), POSITIVE_OR_NONE
    ] = None
    """of wheels that are not in m/s"""
    ticks: Annotated[
        float | None, arg(metavar="COUNT", help_behavior_hint=""), POSITIVE_OR_NONE
    ] = None
    """of an encoder in a revolution of its wheel"""
    pose_file: Annotated[str, arg(metavar="FILE", help_behavior_hint="")] = ""
    """table of the poses where the log has none, such as a TUM file"""
    window_s: Annotated[float, arg(metavar="SECONDS"), WINDOW] = 2.0
    """length of a window"""


@dataclass(frozen=True)
class IdentifyOptions(LogOptions):
    """Identify slip, track, lag and noise of a robot from its log, and say what the log can
    promise."""

    command = "identify"
    module = "identify.command"

    log: Annotated[Positional[str], arg(metavar="LOG", help_behavior_hint=""), LOG_FILE] = ""
    """a table (CSV) or a bag of wheel speeds and poses, or a table of windows"""
    scenario: Suppress[str] = ""
    select: Annotated[str, arg(metavar="COLUMN=VALUE,...", help_behavior_hint="")] = ""
    """rows of a table of windows, such as robot=husky"""
    track_m: Annotated[
        float | None, arg(metavar="METRES", help_behavior_hint=""), POSITIVE_OR_NONE
    ] = None
    """distance between the wheels, to name the effective track by"""
    least_wheel_mps: Annotated[
        float | None,
        arg(metavar="SPEED", help_behavior_hint="(default: a quarter of the fastest)"),
        POSITIVE_OR_NONE,
    ] = None
    """slowest wheel that is promised for"""
    box: Literal["each", "alike", "scaled"] = "each"
    """sides of the box: each wheel's slips and sideslip (5), both wheels' (3), or one factor (1)"""
    margin: Annotated[float, arg(metavar="SLIP"), MARGIN] = 0.0
    """widens the intervals of slip; promises nothing more"""

    @property
    def folder(self) -> Path:
        """The folder of the run: one for each log and selection."""
        words = [Path(self.log).stem, *re.findall(r"=([\w.-]+)", self.select)]
        return Path(self.out or f"runs/{self.command}-{'-'.join(words)}")


@dataclass(frozen=True)
class ReplayOptions(LogOptions):
    """Put a scenario to the test of a log that it was not made from: do its slips, sideslip and
    noise explain every period?"""

    command = "replay"
    module = "replay.command"

    scenario: Annotated[str, arg(metavar="NAME|FILE.toml|DIR", help_behavior_hint=""), SCENARIO] = (
        ""
    )
    """what is put to the test, such as identified.toml"""
    longer_s: Annotated[float, arg(metavar="SECONDS"), RATE] = 1.0
    """longer spans beside those of a period, in which pose noise hides less"""
    promised: Annotated[
        float | None, arg(metavar="SHARE", help_behavior_hint="(default: in FILE.toml)"), SHARE
    ] = None
    """what was promised of new commands, such as 0.77"""

    @property
    def folder(self) -> Path:
        """The folder of the run: one for each log and scenario."""
        return Path(self.out or f"{super().folder}-{Path(self.log).stem}")


@dataclass(frozen=True)
class PathOptions(Options):
    """Make missions of a recorded or planned path: cleaned, cut at stops and turns on the spot, and
    given speeds that keep the wheels in their box."""

    command = "path"
    module = "path.command"
    positional = ("file",)

    file: Annotated[Positional[str], arg(metavar="FILE", help_behavior_hint=""), PATH_FILE] = ""
    """a table (CSV, TUM poses) or a bag with a path, with or without time"""
    speed: Annotated[
        float | None,
        arg(metavar="M/S", help_behavior_hint="(default: reference.speed_mps)"),
        POSITIVE_OR_NONE,
    ] = None
    """speed along the path"""
    recorded_timing: bool = False
    """keep the speeds of the recording, as far as the wheels' box lets it"""
    deviation: Annotated[
        float | None,
        arg(metavar="METRES", help_behavior_hint="(default: a fifth of the effective track)"),
        POSITIVE_OR_NONE,
    ] = None
    """largest distance of a row from the smooth path"""
    through_stops: bool = False
    """drive on through stops, where the direction stays, instead of ending a mission there"""
    columns: Annotated[str, arg(metavar="WHAT=NAME,...", help_behavior_hint="")] = ""
    """columns where they are not found, such as x=east,y=north"""
    units: Annotated[str, arg(metavar="WHAT=UNIT,...", help_behavior_hint="")] = ""
    """units of columns, such as heading=deg"""
    topics: Annotated[str, arg(metavar="WHAT=TOPIC,...", help_behavior_hint="")] = ""
    """topic of a bag: poses"""

    @property
    def folder(self) -> Path:
        """The folder of the run: one for each file and scenario."""
        if self.out:
            return super().folder
        return Path(f"runs/{self.command}-{Path(self.file).stem}-{title(self.scenario)}")

    @property
    def scenario_overrides(self) -> tuple[str, ...]:
        """The overrides with which the scenario is read: its own path is not driven."""
        return (
            *self.overrides,
            'reference.shape="file"',
            f"reference.file={json.dumps(self.file)}",
        )
