"""Options of the commands that measure, show and explain."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, Suppress, arg

from jaxtube.experiments.options.common import Options, title
from jaxtube.experiments.options.rules import DURATION, FOLDER, RUN, STYLE, at_least


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
