"""`simulate`: laps of a design's closed loop, with a controller and a slip process of its own or of
the user."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxtube import qp
from jaxtube.control.own import adapt_controller
from jaxtube.control.protocol import Controller
from jaxtube.plant.protocol import Plant
from jaxtube.plant.slip import SlipProcess
from jaxtube.precision import in_64_bits
from jaxtube.simulation import batches, components
from jaxtube.simulation.dataset import make_dataset
from jaxtube.simulation.rollout import (
    Trajectory,
    read_trajectory,
    realisation_keys,
)
from jaxtube.simulation.starts import FixedStart, Starts, uniform_start
from jaxtube.storage import StoredResult, write_result
from jaxtube.synthesis.feasible import true_starts
from jaxtube.synthesis.parts import Design

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ControllerChoice = str | Controller | Callable[..., Float[Array, "batch 2"]]
PlantChoice = str | Plant
SlipChoice = str | SlipProcess | None
StartChoice = str | Float[np.ndarray, "laps 3"]


@dataclass(frozen=True, eq=False, repr=False)
class Laps:
    """Simulated laps; arrays are numpy, time first, then the laps.

    Attributes:
        design: whose closed loop they are of.
        controller: its name, "own" for a user's.
        plant: its name, "own" for a user's.
        seed: of every draw.
        trajectory: errors (steps + 1, laps, 3), inputs, wheels and diagnostics.
    """

    design: Design
    controller: str
    plant: str
    seed: int
    trajectory: Trajectory

    @property
    def errors(self) -> Float[np.ndarray, "steps+1 laps 3"]:
        """True tracking errors, (m, m, rad)."""
        return np.asarray(self.trajectory.errors)

    @property
    def outside(self) -> int:
        """How many laps leave the error constraints E; NaN counts as outside."""
        limits = self.design.problem.error_set.offsets[:3]
        return int(np.sum(~np.all(np.abs(self.errors) <= limits, axis=(0, 2))))

    @property
    def statuses(self) -> dict[int, int]:
        """How many QPs have each status that occurs (`jaxtube.qp.describe` has the words)."""
        values, counts = np.unique(self.trajectory.diagnostics.status, return_counts=True)
        return dict(zip(values.tolist(), counts.tolist(), strict=True))

    @property
    def without_plan(self) -> int:
        """How many QPs were not solved."""
        return sum(count for status, count in self.statuses.items() if status != qp.SOLVED)

    @property
    def rms(self) -> Float[np.ndarray, "3"]:
        """RMS errors over all laps and the whole reference, (m, m, rad)."""
        return np.sqrt(np.mean(self.errors**2, axis=(0, 1)))

    def plot(self, *others: Laps) -> Figure:
        """Draw the errors against time and limits, beside other laps; return the figure."""
        from jaxtube.figures.laps import errors

        runs = {laps.controller: laps for laps in (self, *others)}
        if len(runs) <= len(others):
            raise ValueError("others: two laps have controllers of one name; draw one at a time")
        return errors(self.design.problem, {name: laps.trajectory for name, laps in runs.items()})

    def save(self, folder: str | Path) -> Path:
        """Save the laps in a folder, for `jaxtube.read`; return the folder."""
        facts = {"controller": self.controller, "plant": self.plant, "seed": self.seed}
        arrays = self.trajectory.arrays()
        scenario = self.design.problem.scenario
        return write_result(folder, StoredResult("laps", scenario, facts, arrays))

    @classmethod
    def restore(cls, design: Design, stored: StoredResult) -> Laps:
        """Return laps that were saved, of their design made again."""
        return cls(design, trajectory=read_trajectory(stored.arrays), **stored.facts)

    def to_xarray(self) -> Any:
        """Return the laps as an xarray Dataset with named dimensions: pip install
        'jaxtube[results]'."""
        attributes = {"controller": self.controller, "plant": self.plant, "seed": self.seed}
        return make_dataset(self.trajectory, self.design.problem.reference.dt, attributes)

    def __repr__(self) -> str:
        count = self.errors.shape[1]
        along, across, heading = self.rms
        left = "no lap leaves E" if not self.outside else f"{self.outside} laps leave E"
        verdict = (
            f"<Laps: {left} in {count}; {self.controller} on the {self.plant}; RMS "
            f"{1e3 * along:.1f} mm along, {1e3 * across:.1f} mm across, "
            f"{np.rad2deg(heading):.2f} deg; {self.without_plan} QPs without a plan"
        )
        return "\n".join([verdict, *qp.describe_unsolved(self.statuses)]) + ">"


@in_64_bits
def simulate(
    design: Design,
    controller: ControllerChoice = "tube_mpc",
    plant: PlantChoice = "robot",
    *,
    laps: int = 256,
    starts: StartChoice = "scenario",
    slip: SlipChoice = None,
    seed: int = 0,
) -> Laps:
    """Run laps of a design's closed loop along its reference.

    Args:
        design: a design.
        controller: "tube_mpc", "plain_mpc", "equal_gain", "local_gain", "compensated" or
            "uncompensated"; a law u = f(errors, reference_wheels); or a `Controller`.
        plant: "robot" (the scenario's), "exact" (its slip known, its pose measured without noise),
            "linear" (the prediction model with w in W), or a `Plant`.
        laps: how many.
        starts: "scenario", "feasible" (uniform in the feasible set of the tube-MPC), "edge" (on its
            boundary), or true initial errors (laps, 3) in (m, m, rad).
        slip: process of the slips of the robot, a name or a `SlipProcess`; the scenario's unless
            given.
        seed: of every draw; lap i is the same whatever `laps` is.

    Returns:
        The laps. A QP without solution does not raise: the diagnostics say so.

    Raises:
        ValueError: one line, for an unknown name, or a controller of other shapes.
    """
    acting_controller = choose_controller(design, controller)
    acting_plant = choose_plant(design, plant, slip)
    if isinstance(starts, str):
        keys = realisation_keys(seed, 0, laps)
        errors = np.asarray(choose_starts(design, starts).draw(keys))
    else:
        errors = np.asarray(starts, float)
        if errors.ndim != 2 or errors.shape[1] != 3:
            raise ValueError(
                f"starts: shape {errors.shape} is not (laps, 3); give one initial error a lap"
            )
    trajectory = batches.run_realisations(acting_controller, acting_plant, errors, seed)
    return Laps(design, name_choice(controller), name_choice(plant), seed, trajectory)


def choose_controller(design: Design, controller: ControllerChoice) -> Controller:
    """Return the controller of a name, or what a closed loop can run of a user's own."""
    if not isinstance(controller, str):
        return adapt_controller(controller, components.make_wheel_map(design.problem))
    named = components.controllers(design)
    if controller not in named:
        raise ValueError(f"controller = {controller!r}: is unknown; choose one of {list(named)}")
    return named[controller]


def choose_plant(design: Design, plant: PlantChoice, slip: SlipChoice = None) -> Plant:
    """Return the plant of a name, or a user's own; `slip` for the robot alone."""
    if not isinstance(plant, str):
        return plant
    if plant == "robot":
        return components.slipping_robot(design, slip)
    if slip is not None:
        raise ValueError(f'slip = {slip!r}: plant = {plant!r} draws no slips; choose "robot"')
    if plant == "exact":
        return components.exact_robot(design)
    if plant == "linear":
        return components.linear_plant(design)
    raise ValueError(f'plant = {plant!r}: is unknown; choose "robot", "exact" or "linear"')


def choose_starts(design: Design, starts: str) -> Starts:
    """Return the law of initial errors: the scenario's start, or uniform in the feasible set of the
    tube-MPC, or on its edge.

    Raises:
        ValueError: for an unknown name, or where no start has a plan.
    """
    if starts == "scenario":
        return FixedStart(jnp.asarray(design.problem.initial_error))
    if starts not in ("feasible", "edge"):
        raise ValueError(
            f'starts = {starts!r}: is unknown; choose "scenario", "feasible" or "edge"'
        )
    # The seed of the set's shape is fixed: the law of the starts is the scenario's alone.
    points = true_starts(design.tube_qps, design.first_window, design.problem, seed=0)
    return uniform_start(points, edge=starts == "edge")


def name_choice(choice: object) -> str:
    """Return the name of what was chosen, "own" for a user's own."""
    return choice if isinstance(choice, str) else "own"
