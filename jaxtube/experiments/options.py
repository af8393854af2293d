"""The options of each command, from which the parser is built; each option holds the rule of its
values.

Every command takes a scenario, the folder of its run, a seed, and overrides of single keys.
"""

import json
import math
import os
import re
import shlex
import textwrap
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

from tyro.conf import Positional, Suppress, arg

PROGRAM = "python -m jaxtube.experiments"
DEFAULT_COMMAND = "paper"
SEED_LIMIT = 2**63
REALISATIONS_LIMIT = 2**53
LAPS_LIMIT = 2**64
MOST_SHOWN = 40
"""Characters of overrides in the title of a figure."""

ControllerName = Literal[
    "tube_mpc", "plain_mpc", "equal_gain", "local_gain", "compensated", "uncompensated"
]


class Rule(NamedTuple):
    """What the value of an option has to be; `words` say what is wrong with another one, and the
    cure."""

    is_kept: Callable[[Any], bool]
    words: str


def at_least(least: int) -> Rule:
    """Return the rule of a count."""
    return Rule(lambda value: value >= least, f"is out of range; give a whole number from {least}")


def _is_count_of_laps(value: float) -> bool:
    return 1 <= value <= REALISATIONS_LIMIT and value == math.floor(value)


def _is_lap(value: int | None) -> bool:
    return value is None or 0 <= value < LAPS_LIMIT


LAPS = Rule(_is_count_of_laps, "is no whole number from 1 to 2^53 (9.0e15); give one, such as 1000")
LAP = Rule(_is_lap, "is out of range; give a lap's number, from 0 to below 2^64")
SEED = Rule(
    lambda value: 0 <= value < SEED_LIMIT,
    "is out of range; give a whole number from 0 to 2^63 - 1",
)
RATE = Rule(
    lambda value: 0 < value < math.inf, "is out of range; give a positive number, such as 0.1"
)
DURATION = Rule(
    lambda value: 0 < value < math.inf, "is out of range; give a positive number, such as 60"
)
POSITIVE_OR_NONE = Rule(
    lambda value: value is None or 0 < value < math.inf,
    "is out of range; give a positive number, or leave it out",
)
WINDOW = Rule(lambda value: 0.2 <= value <= 60, "is out of range; give seconds, such as 2")
MARGIN = Rule(lambda value: 0 <= value < 1, "is out of range; give a slip from 0 on, such as 0.01")
LOG_FILE = Rule(bool, "is missing; name the file of a log, or of a table of windows")
PATH_FILE = Rule(bool, "is missing; name the file of a path")
SCENARIO = Rule(bool, "is missing; name a scenario, such as the identified.toml of `identify`")
RUN = Rule(bool, "is missing; name the folder of a run")
STYLE = Rule(bool, "is missing; name a style of matplotlib, or a file that ends in .mplstyle")
HORIZONS = Rule(
    lambda value: all(re.fullmatch("[1-9][0-9]?", word) for word in value.split(",")),
    "holds no horizons; give whole numbers from 1 to 99 with commas between, such as 5,10,20",
)
SHARE = Rule(
    lambda value: value is None or 0 < value < 1,
    "is out of range; give a share between 0 and 1, such as 0.77",
)
FOLDER = Rule(lambda value: not os.path.isfile(value), "is a file; name a folder")


@dataclass(frozen=True)
class Options:
    """What every command takes."""

    command: ClassVar[str]
    module: ClassVar[str]
    positional: ClassVar[tuple[str, ...]] = ()
    """Options that are given by their place, without their name."""

    scenario: Annotated[str, arg(metavar="NAME|FILE.toml|DIR")] = "paper"
    """a scenario that `list` prints, a file, or the folder of a saved result or a run"""
    out: Annotated[
        str, arg(metavar="DIR", help_behavior_hint="(default: runs/COMMAND-SCENARIO)"), FOLDER
    ] = ""
    """folder of the run"""
    seed: Annotated[int, arg(metavar="INT"), SEED] = 0
    """seed of every random draw"""
    # Not tuple[str, ...]: to check that default, the parser would load a library that takes a third
    # of the help's time.
    overrides: Suppress[tuple] = ()

    @property
    def folder(self) -> Path:
        """The folder of the run."""
        return Path(self.out or f"runs/{self.command}-{title(self.scenario)}")

    @property
    def scenario_overrides(self) -> tuple[str, ...]:
        """The overrides with which the scenario is read."""
        return self.overrides

    @property
    def label(self) -> str:
        """The scenario of the run in the titles of figures, overrides included."""
        overrides = textwrap.shorten(" ".join(self.overrides), MOST_SHOWN, placeholder=" ...")
        return f"{title(self.scenario)} with {overrides}" if overrides else title(self.scenario)

    @property
    def scenario_files(self) -> list[Path]:
        """The files that scenarios are read from, those that come with the project left out."""
        names = [self.scenario, getattr(self, "against", "")]
        return [Path(name) for name in names if Path(name).suffix == ".toml"]

    def find_broken_rule(self) -> str:
        """Say in one line which option has a value that breaks its rule; empty where none does."""
        for field in fields(self):
            value = getattr(self, field.name)
            for rule in getattr(field.type, "__metadata__", ()):
                if isinstance(rule, Rule) and not rule.is_kept(value):
                    return f"{flag(field.name)} = {value}: {rule.words}"
        return ""


@dataclass(frozen=True)
class PaperOptions(Options):
    """Reproduce the paper's comparison of controllers (the default command)."""

    command = "paper"
    module = "paper.command"

    realisations: Annotated[int, arg(metavar="INT"), LAPS] = 256
    """number of simulated runs of each controller"""
    require_certificate: bool = False
    """exit with 3 when the terminal set is empty or the certificate fails"""


@dataclass(frozen=True)
class DesignOptions(Options):
    """Compute tubes, gains and terminal set of a scenario, and check their certificate."""

    command = "design"
    module = "design.command"

    optimise: bool = False
    """first search the caps and tracking gains whose tube fills least of what it may use"""
    require_certificate: bool = False
    """exit with 3 when the terminal set is empty or the certificate fails"""

    @property
    def folder(self) -> Path:
        """The folder of the run: another one for the design that the optimiser finds."""
        folder = super().folder
        return Path(f"{folder}-optimised") if self.optimise and not self.out else folder


@dataclass(frozen=True)
class MontecarloOptions(Options):
    """Run laps by the million and check every period against the design; resumes where it was
    interrupted."""

    command = "montecarlo"
    module = "montecarlo.command"

    realisations: Annotated[float, arg(metavar="COUNT"), LAPS] = 1e5
    """number of laps, such as 1e6"""
    controller: ControllerName = "tube_mpc"
    """controller of the closed loop"""
    plant: Literal["robot", "linear"] = "robot"
    """the slipping robot, or the prediction model with w drawn in W"""
    starts: Literal["scenario", "feasible", "edge"] = "scenario"
    """the scenario's start, or uniform in the feasible set of the tube-MPC, or on its edge"""
    chunk: Annotated[int, arg(metavar="BLOCKS"), at_least(1)] = 1
    """blocks that a device works through in one dispatch; changes no result"""
    devices: Annotated[
        int,
        arg(metavar="COUNT", help_behavior_hint="(default: all; processors count as devices)"),
        at_least(0),
    ] = 0
    """devices of this machine to use; changes no result"""
    cluster: Annotated[str, arg(metavar="local:N|ADDRESS", help_behavior_hint="")] = ""
    """workers that compute the blocks: N started here, or those of a Dask scheduler, such as
    tcp://host:8786"""
    replay: Annotated[int | None, arg(metavar="LAP", help_behavior_hint=""), LAP] = None
    """draw this lap of the run, by its number, instead of running any"""
    netcdf: bool = False
    """also write statistics.nc, which opens in xarray"""

    @property
    def folder(self) -> Path:
        """The folder of the run: one for each law that the options can name."""
        if self.out:
            return super().folder
        name = str(super().folder)
        for option in ("controller", "plant", "starts"):
            value = getattr(self, option)
            if value != getattr(type(self), option):
                name += f"-{value}"
        return Path(name)


@dataclass(frozen=True)
class FalsifyOptions(Options):
    """Search the smallest margins by gradient: slips, noise and start that drive a closed loop out
    of its limits."""

    command = "falsify"
    module = "falsify.command"

    controller: ControllerName = "tube_mpc"
    """controller of the closed loop"""
    plant: Literal["robot", "linear"] = "robot"
    """the slipping robot, or the prediction model with w in W"""
    target: Literal["error", "input", "tube", "all"] = "all"
    """what is to be left: E, U and the wheel limits, or the tube around a plan (of tube_mpc)"""
    starts: Literal["scenario", "feasible"] = "scenario"
    """the scenario's start, or anywhere in the feasible set of the tube-MPC"""
    seconds: Annotated[float, arg(metavar="SECONDS")] = 60.0
    """time of the search, without compilation; as much again for drawn laps to compare with"""
    replay: Annotated[str, arg(metavar="FILE.npz", help_behavior_hint="")] = ""
    """play a worst case again that an earlier search saved, and draw it beside its file"""


@dataclass(frozen=True)
class GuaranteeOptions(Options):
    """Attack a certified design by the million laps, and another one beside it; sets claims against
    what was seen."""

    command = "guarantee"
    module = "guarantee.command"

    scenario: Annotated[str, arg(metavar="NAME|FILE.toml|DIR")] = "certified"
    """a scenario that `list` prints, a file, or the folder of a saved result or a run"""
    against: Annotated[str, arg(metavar="NAME|FILE.toml|DIR")] = "paper"
    """the scenario whose sets, gains and model are attacked on the same robot, path and slip"""
    realisations: Annotated[float, arg(metavar="COUNT"), LAPS] = 1e5
    """number of laps of each design, such as 1e6: spread over five slip processes; the edge comes
    on top"""
    devices: Annotated[
        int,
        arg(metavar="COUNT", help_behavior_hint="(default: all; processors count as devices)"),
        at_least(0),
    ] = 0
    """devices of this machine to use; changes no result"""
    require_certificate: bool = False
    """exit with 3 when the certificate of the scenario fails"""

    @property
    def folder(self) -> Path:
        """The folder of the run: one for each pair of designs."""
        if self.out or self.against == type(self).against:
            return super().folder
        return Path(f"{super().folder}-{title(self.against)}")


@dataclass(frozen=True)
class MapsOptions(Options):
    """Map what can be guaranteed: over slip error, speed range and period, for three ways to choose
    a design."""

    command = "maps"
    module = "maps.command"

    scenario: Annotated[str, arg(metavar="NAME|FILE.toml|DIR")] = "certified"
    """a scenario that `list` prints, or a file; it needs caps"""
    points: Annotated[int, arg(metavar="COUNT"), at_least(2)] = 4
    """values along each axis, the scenario's own come on top"""
    feasible: bool = False
    """deprecated: run `coverage` afterwards"""


@dataclass(frozen=True)
class CoverageOptions(Options):
    """Measure how much of what any controller could keep has a plan, by the horizon, and what a
    step costs."""

    command = "coverage"
    module = "coverage.command"

    scenario: Annotated[str, arg(metavar="NAME|FILE.toml|DIR")] = "certified"
    """a scenario that `list` prints, or a file"""
    horizons: Annotated[str, arg(metavar="N,N,..."), HORIZONS] = "1,2,3,5,7,10,15,20"
    """horizons of the tube-MPC, from short to long"""

    @property
    def horizon_values(self) -> tuple[int, ...]:
        """The horizons."""
        return tuple(int(word) for word in self.horizons.split(","))


@dataclass(frozen=True)
class FitOptions(Options):
    """Find the largest speed, the smallest limits or the widest slip with a certificate; resumes
    where it was interrupted."""

    command = "fit"
    module = "fit.command"
    positional = ("quantity",)

    quantity: Positional[Literal["speed", "limits", "slip"]] = "speed"
    """what one factor scales: reference.speed_mps and its box of wheel speeds, all of
    [constraints], or what is not known of slip"""
    scenario: Annotated[str, arg(metavar="NAME|FILE.toml|DIR")] = "certified"
    """a scenario that `list` prints, or a file; caps and gains are searched"""
    require_certificate: bool = False
    """exit with 3 when no certified design is found"""

    @property
    def folder(self) -> Path:
        """The folder of the run: one for each quantity."""
        return super().folder if self.out else Path(f"{super().folder}-{self.quantity}")


@dataclass(frozen=True)
class BeyondOptions(Options):
    """Measure how imperfect the robot may be before a lap leaves W, and before it leaves what is
    certified."""

    command = "beyond"
    module = "beyond.command"

    realisations: Annotated[int, arg(metavar="INT"), LAPS] = 1024
    """number of laps under each of four slip processes, at each level of each imperfection"""


@dataclass(frozen=True)
class TuneOptions(Options):
    """Tune weights and gains by gradients through laps and through the tube; what comes out is
    certified."""

    command = "tune"
    module = "tune.command"

    scenario: Annotated[str, arg(metavar="NAME|FILE.toml|DIR")] = "untuned"
    """a scenario that `list` prints, or a file: where tuning starts, and under [tuning] what it
    aims at"""
    variables: Literal["both", "weights", "gains", "diagonal"] = "both"
    """what moves: Q, R and gains, or some of them; diagonal: those of Q and R"""
    method: Literal["lbfgs", "adam"] = "lbfgs"
    """L-BFGS-B on the same laps in every evaluation, or Adam with fresh ones in each"""
    evaluations: Annotated[int, arg(metavar="COUNT"), at_least(1)] = 120
    """gradients at most"""
    laps: Annotated[int, arg(metavar="COUNT"), at_least(1)] = 128
    """laps in each evaluation"""
    held_out: Annotated[int, arg(metavar="COUNT"), at_least(1)] = 256
    """laps, others than those, that judge every iterate"""
    learning_rate: Annotated[float, arg(metavar="RATE"), RATE] = 0.1
    """of Adam, in the logarithms of weights and gains"""
    patience: Annotated[int, arg(metavar="COUNT"), at_least(1)] = 40
    """iterates without a better held-out objective after which to stop"""
    compare: bool = False
    """also tune weights and gains alone, search without gradients, and drive paths that tuning
    never saw"""
    accept_uncertified: bool = False
    """return the best iterate even if its certificate fails; it is labelled as such"""


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
class ExportOptions(Options):
    """Write the controller of a design as NumPy and C99 for a robot, certified again as it is
    written."""

    command = "export"
    module = "export.command"
    positional = ("scenario",)

    scenario: Annotated[
        Positional[str], arg(metavar="NAME|FILE.toml|DIR", help_behavior_hint="")
    ] = "certified"
    """a scenario that `list` prints, a file, or the folder of a saved result or a run"""
    to: Annotated[
        str,
        arg(metavar="DIR", help_behavior_hint="(default: controller/ in the run's folder)"),
        FOLDER,
    ] = ""
    """folder of the controller"""
    require_certificate: bool = False
    """exit with 3 when the controller is not certified for the robot"""

    @property
    def controller_folder(self) -> Path:
        """The folder of the controller."""
        return Path(self.to) if self.to else self.folder / "controller"


@dataclass(frozen=True)
class BenchOptions(Options):
    """Measure speed beside peers in one run: programs, laps, gradients, designs, single steps; or
    laps on one GPU."""

    command = "bench"
    module = "bench.command"
    positional = ("topic",)

    topic: Positional[
        Literal["all", "qp", "loop", "design", "gradient", "scale", "latency", "gpu"]
    ] = "all"
    """qp: programs with active rows; loop: the closed loop; design: a design by stage; gradient: of
    the tuning objective; scale: laps, cores, share of active rows, horizon; latency: one step of
    one robot; gpu: laps on one GPU, also of `certified` and `tuned`, compared with the processor's;
    all: everything but the GPU"""
    quick: bool = False
    """a small part of each, which shows that it works; its speeds say little"""
    seconds: Annotated[float, arg(metavar="SECONDS"), DURATION] = 330.0
    """of gpu: time for all of it; what was measured by then is kept"""

    @property
    def folder(self) -> Path:
        """The folder of the run: one for each topic."""
        if self.out or self.topic == type(self).topic:
            return super().folder
        return Path(f"runs/{self.command}-{self.topic}-{title(self.scenario)}")


@dataclass(frozen=True)
class PastRunOptions(Options):
    """What every command takes that reads the folder of a run."""

    positional = ("run",)

    run: Annotated[Positional[str], arg(metavar="RUN", help_behavior_hint=""), RUN] = ""
    """folder of a run, such as runs/paper-paper"""
    scenario: Suppress[str] = ""
    seed: Suppress[int] = 0


@dataclass(frozen=True)
class AnimateOptions(PastRunOptions):
    """Write a lap of a run as moving picture, from the laps in its folder."""

    command = "animate"
    module = "animate.command"

    out: Suppress[str] = ""
    controller: Annotated[
        str, arg(metavar="NAME,...", help_behavior_hint="(default: the last of the run)")
    ] = ""
    """controller, or several that are drawn together"""
    lap: Annotated[str, arg(metavar="median|worst|NUMBER")] = "median"
    """lap: by the largest share of a limit that laps of the first controller used, or its number"""
    to: Annotated[
        str, arg(metavar="FILE.gif|FILE.mp4", help_behavior_hint="(default: RUN/lap.gif)")
    ] = ""
    """file to write; MP4 needs ffmpeg"""
    frames: Annotated[int, arg(metavar="COUNT"), at_least(2)] = 150
    """pictures from the first to the last instant"""


@dataclass(frozen=True)
class FiguresOptions(PastRunOptions):
    """Draw the figures of a run again in another style, from the data in its folder."""

    command = "figures"
    module = "figures.command"

    style: Annotated[str, arg(metavar="NAME|FILE.mplstyle", help_behavior_hint=""), STYLE] = ""
    """style of matplotlib, or a file of one"""
    out: Annotated[
        str, arg(metavar="DIR", help_behavior_hint="(default: RUN/figures-STYLE)"), FOLDER
    ] = ""
    """folder of the figures"""

    @property
    def folder(self) -> Path:
        """The folder of the figures."""
        return Path(self.out or Path(self.run) / f"figures-{Path(self.style).stem}")


@dataclass(frozen=True)
class ListOptions(Options):
    """List the scenarios that come with the project (--scenario: only this one)."""

    command = "list"
    module = "listing"

    scenario: Annotated[
        str, arg(metavar="NAME|FILE.toml|DIR", help_behavior_hint="(default: all)")
    ] = ""
    """a scenario, or a file"""


@dataclass(frozen=True)
class CheckOptions(Options):
    """Run scenarios again and compare their metrics with the expected ones; exit 1 when any is
    off."""

    command = "check"
    module = "check"

    names: Positional[
        Annotated[tuple[str, ...], arg(metavar="[NAME|FILE.toml|DIR ...]", help_behavior_hint="")]
    ] = ()
    """scenarios with an expected.toml beside them; none: all that come with the project"""
    scenario: Annotated[str, arg(metavar="NAME|FILE.toml|DIR", help_behavior_hint="")] = ""
    """the same as one NAME"""
    quick: bool = False
    """only the metrics that the design answers, without simulation"""


@dataclass(frozen=True)
class DoctorOptions(Options):
    """Check that everything jaxtube needs is installed and works: about 5 seconds; exit 1 where
    not."""

    command = "doctor"
    module = "doctor.command"

    scenario: Suppress[str] = ""
    out: Suppress[str] = ""
    seed: Suppress[int] = 0


@dataclass(frozen=True)
class CompletionOptions(Options):
    """Print what lets a shell complete commands, options, scenarios and keys; add to ~/.bashrc:
    eval "$(jaxtube completion bash)"."""

    command = "completion"
    module = "completion.command"
    positional = ("shell",)

    shell: Positional[Literal["bash", "zsh", "fish"]] = "bash"
    """the shell that reads the script"""
    scenario: Suppress[str] = ""
    out: Suppress[str] = ""
    seed: Suppress[int] = 0


COMMANDS: dict[str, type[Options]] = {
    kind.command: kind
    for kind in (
        PaperOptions,
        DesignOptions,
        MontecarloOptions,
        FalsifyOptions,
        GuaranteeOptions,
        FitOptions,
        MapsOptions,
        CoverageOptions,
        BeyondOptions,
        PathOptions,
        TuneOptions,
        IdentifyOptions,
        ReplayOptions,
        ExportOptions,
        BenchOptions,
        AnimateOptions,
        FiguresOptions,
        ListOptions,
        CheckOptions,
        DoctorOptions,
        CompletionOptions,
    )
}


def title(scenario: str) -> str:
    """Name a scenario in a folder's name: its own name, or that of its file, or of the folder of a
    scenario.toml; a design that was saved in the folder of a run has the name of that run."""
    path = Path(scenario)
    if path.suffix == ".toml" and path.stem != "scenario":
        return path.stem
    if path.suffix != ".toml" and path.name == scenario:
        return scenario
    folder = path.resolve().parent if path.suffix == ".toml" else path.resolve()
    return folder.parent.name if folder.name == "design" else folder.name


def flag(name: str) -> str:
    """Return an option as it is written on the command line."""
    return f"--{name.replace('_', '-')}"


def command_line(options: Options) -> str:
    """Return the command that has these options, for a shell; options at their default are left
    out."""
    words = [*PROGRAM.split(), options.command]
    for field in fields(options):
        value = getattr(options, field.name)
        if isinstance(value, tuple):
            words += value
        elif field.name in options.positional:
            words.append(str(value))
        elif value != field.default:
            words.append(flag(field.name))
            words += [] if value is True else [str(value)]
    return shlex.join(words)
