"""Options of the commands that make a design and run it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from jaxtube.experiments.options.common import Options, title
from jaxtube.experiments.options.rules import FOLDER, HORIZONS, LAP, LAPS, at_least

ControllerName = Literal[
    "tube_mpc", "plain_mpc", "equal_gain", "local_gain", "compensated", "uncompensated"
]


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
class BeyondOptions(Options):
    """Measure how imperfect the robot may be before a lap leaves W, and before it leaves what is
    certified."""

    command = "beyond"
    module = "beyond.command"

    realisations: Annotated[int, arg(metavar="INT"), LAPS] = 1024
    """number of laps under each of four slip processes, at each level of each imperfection"""


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
