"""Options of the commands that look for scenarios, weights and gains."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from jaxtube.experiments.options.common import Options
from jaxtube.experiments.options.rules import RATE, at_least


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
