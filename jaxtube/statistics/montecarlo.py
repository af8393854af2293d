"""`montecarlo`: laps by the million, every period checked against the design."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import jax

from jaxtube.arguments import require_count
from jaxtube.control.laws import input_map_of, solves_qp
from jaxtube.precision import in_64_bits
from jaxtube.progress import show_progress
from jaxtube.scenario.tree import to_toml
from jaxtube.simulation.choices import (
    ControllerChoice,
    PlantChoice,
    SlipChoice,
    choose_controller,
    choose_plant,
    choose_starts,
    find_plant,
    name_choice,
)
from jaxtube.simulation.promise import (
    describe_certificate,
    describe_error_limits,
    limit_true_errors,
)
from jaxtube.statistics.dataset import make_dataset
from jaxtube.statistics.events import EVENT_NAMES
from jaxtube.statistics.linear_montecarlo import LinearMonteCarlo, run_linear
from jaxtube.statistics.run import BLOCK, Run, Statistics, Task, merge
from jaxtube.statistics.share import Share
from jaxtube.statistics.summary import SamplingLaw, summarise
from jaxtube.statistics.task import make_task
from jaxtube.storage import StoredResult, write_result
from jaxtube.synthesis.parts import Design, LinearDesign, require_design

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, repr=False)
class MonteCarlo:
    """A Monte Carlo run of a design.

    E holds the caps and the pose noise together, which may be narrower than [constraints]; on the
    linear plant the caps alone. The text of the run names its half widths.

    Attributes:
        design: that it is a run of.
        law: what laps were drawn from; every bound holds for it alone.
        seed: of every draw.
        statistics: counts and extremes, joined over all laps.
    """

    design: Design
    law: SamplingLaw
    seed: int
    statistics: Statistics

    @cached_property
    def summary(self) -> dict[str, Any]:
        """Shares with intervals, quantiles and extremes, with units in the keys."""
        return summarise(self.design, self.law, self.statistics)

    @property
    def laps(self) -> int:
        """How many laps were run."""
        return int(self.statistics["laps"])

    def share(self, event: str) -> Share:
        """Return how often an event was seen: a name of `jaxtube.statistics.events`.

        Raises:
            ValueError: for an unknown event, or one that a run of this kind cannot have.
        """
        events = self.summary["events"]
        if event not in events:
            known = "is unknown" if event not in EVENT_NAMES else "cannot occur in this run"
            raise ValueError(f"event = {event!r}: {known}; choose one of {list(events)}")
        low, high = events[event]["share_of_laps_interval"]
        return Share(events[event]["laps"], self.laps, low, high)

    def plot(self) -> Figure:
        """Draw the shares of what must not happen, with their intervals; return the figure."""
        from jaxtube.figures.shares import violations

        return violations(self.summary)

    def save(self, folder: str | Path) -> Path:
        """Save the run in a folder, for `jaxtube.read`, in place of a run that was saved there;
        return the folder."""
        facts = {"law": self.law._asdict(), "seed": self.seed}
        scenario = self.design.problem.scenario
        return write_result(folder, StoredResult("montecarlo", scenario, facts, self.statistics))

    def to_xarray(self) -> Any:
        """Return the statistics as an xarray Dataset with named dimensions: pip install
        'jaxtube[results]'."""
        attributes = {
            "title": f"statistics of {self.laps:,} laps",
            "source": "jaxtube montecarlo",
            "controller": self.law.controller,
            "plant": self.law.plant,
            "starts": self.law.starts,
            "law": self.summary["law"],
            "seed": self.seed,
            "scenario": to_toml(self.design.problem.scenario),
        }
        judged = limit_true_errors(self.design, self.law.plant)
        return make_dataset(judged, self.statistics, attributes)

    @classmethod
    def restore(cls, design: Design, stored: StoredResult) -> MonteCarlo:
        """Return a run that was saved, of its design made again."""
        law = SamplingLaw(**stored.facts["law"])
        return cls(design, law, stored.facts["seed"], stored.arrays)

    def __repr__(self) -> str:
        left_w = self.share("w_outside_W")
        left_e = self.share("e_outside_E")
        premise = "w stayed in W; " if not left_w.laps else f"w left W in {left_w.laps:,} laps; "
        return (
            f"<MonteCarlo: {left_e.laps:,} of {self.laps:,} laps left E (share at most "
            f"{left_e.high:.3g} at 95 % confidence); {'' if self.law.input_map else premise}"
            f"{describe_error_limits(self.design, self.law.plant)}; law: {self.summary['law']}; "
            f"{describe_certificate(self.design, self.law.controller)}>"
        )


@overload
def montecarlo(
    design: Design,
    controller: ControllerChoice = "tube_mpc",
    plant: PlantChoice | None = None,
    *,
    laps: int = 100_000,
    starts: str = "scenario",
    slip: SlipChoice = None,
    seed: int = 0,
) -> MonteCarlo: ...


@overload
def montecarlo(
    design: LinearDesign,
    controller: ControllerChoice = "tube_mpc",
    plant: PlantChoice | None = None,
    *,
    laps: int = 100_000,
    starts: str = "scenario",
    slip: SlipChoice = None,
    seed: int = 0,
) -> LinearMonteCarlo: ...


@in_64_bits
def montecarlo(
    design: Design | LinearDesign,
    controller: ControllerChoice = "tube_mpc",
    plant: PlantChoice | None = None,
    *,
    laps: int = 100_000,
    starts: str = "scenario",
    slip: SlipChoice = None,
    seed: int = 0,
) -> MonteCarlo | LinearMonteCarlo:
    """Run laps by the million and check every period against the sets of a design.

    Args:
        design: whose sets laps are checked against.
        controller, plant, slip: as for `simulate`.
        laps: how many; whole blocks of 4,096 are computed, and laps beyond the number not counted.
        starts: "scenario", "feasible" or "edge", as for `simulate`.
        seed: of every draw: lap i is a function of seed and i, whatever ran beside it.

    Returns:
        The run, with exact counts and finite-sample bounds.

    Raises:
        ValueError: one line, for an unknown name, or laps that are no whole number.
    """
    require_design(design, or_linear=True)
    count = require_count("laps", laps)
    plant = find_plant(design, plant)
    if isinstance(design, LinearDesign):
        return run_linear(
            design, controller, plant, laps=count, starts=starts, slip=slip, seed=seed
        )
    law = name_law(design, controller, plant, starts, slip)
    task = make_closed_loop_task(design, controller, plant, starts, slip, seed)
    run = Run(task, count, chunk=1, devices=tuple(jax.local_devices()))
    blocks = range(math.ceil(run.realisations / BLOCK))
    with show_progress(count, "simulating", "laps") as bar:
        statistics = functools.reduce(merge, _compute_blocks(run, blocks, bar.update))
    return MonteCarlo(design, law, seed, statistics)


def _compute_blocks(run: Run, blocks: range, show: Callable[[int], object]) -> Iterator[Statistics]:
    """Yield the statistics of blocks, and show how many laps each has."""
    for _, statistics in run.compute(blocks):
        show(int(statistics["laps"]))
        yield statistics


def make_closed_loop_task(
    design: Design,
    controller: ControllerChoice,
    plant: PlantChoice,
    starts: str,
    slip: SlipChoice,
    seed: int,
) -> Task:
    """Return what every block of a run needs, from what `montecarlo` is given."""
    law = choose_starts(design, starts)
    return make_task(
        limit_true_errors(design, name_choice(plant)),
        choose_controller(design, controller, law),
        choose_plant(design, plant, slip),
        law,
        seed,
    )


def name_law(
    design: Design,
    controller: ControllerChoice,
    plant: PlantChoice,
    starts: str,
    slip: SlipChoice = None,
) -> SamplingLaw:
    """Return the names of what laps are drawn from."""
    process = design.problem.scenario.slip.process if slip is None else slip
    acting = choose_controller(design, controller)
    input_map = input_map_of(acting)
    is_of_scenario = input_map in (None, design.problem.scenario.controller.input_map)
    return SamplingLaw(
        controller=name_choice(controller),
        plant=name_choice(plant),
        starts=starts,
        process=name_choice(process),
        solves_qp=solves_qp(acting),
        input_map="" if is_of_scenario else str(input_map),
    )
