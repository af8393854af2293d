"""`simulate`: laps of a design's closed loop, with a controller and a slip process of its own or of
the user."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from jaxtyping import Float

from jaxtube import qp
from jaxtube.arguments import describe_type, require_count
from jaxtube.control.laws import solves_qp
from jaxtube.precision import in_64_bits
from jaxtube.progress import show_progress
from jaxtube.simulation import batches
from jaxtube.simulation.choices import (
    ControllerChoice,
    PlantChoice,
    SlipChoice,
    StartChoice,
    choose_controller,
    choose_plant,
    choose_starts,
    find_plant,
    name_choice,
    name_controller,
)
from jaxtube.simulation.dataset import make_dataset
from jaxtube.simulation.linear_laps import LinearLaps
from jaxtube.simulation.memory import refuse_laps_beyond_memory
from jaxtube.simulation.promise import describe_error_limits, limit_true_errors
from jaxtube.simulation.recorded import RecordedLaps
from jaxtube.simulation.rollout import (
    read_trajectory,
    realisation_keys,
)
from jaxtube.storage import StoredResult, write_result
from jaxtube.synthesis.parts import Design, LinearDesign, require_design

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LAPS = 256
"""Laps of a simulation that names no number."""


@dataclass(frozen=True, eq=False, repr=False)
class Laps(RecordedLaps):
    """Simulated laps of a robot: errors are true tracking errors, (m, m, rad), of the committed
    poses where wheels lag, and RMS errors in the same units."""

    design: Design

    @property
    def error_limits(self) -> Float[np.ndarray, "3"]:
        """Half widths of the E that true errors are judged by, (m, m, rad)."""
        return self._judged.problem.error_set.offsets[:3]

    @property
    def _judged(self) -> Design:
        return limit_true_errors(self.design, self.plant)

    @property
    def outside(self) -> int:
        """How many laps leave E, caps and pose noise together (on "linear" the caps alone, which
        [constraints] hold); NaN counts as outside."""
        limits = self.error_limits
        return int(np.sum(~np.all(np.abs(self.errors) <= limits, axis=(0, 2))))

    def plot(self, *others: Laps) -> Figure:
        """Draw the errors against time and limits, beside other laps; return the figure.

        Raises:
            ValueError: one line, for anything but laps, or controllers of one name.
        """
        from jaxtube.figures.laps import errors

        for other in others:
            _require_laps(other)
        runs = {laps.controller: laps for laps in (self, *others)}
        if len(runs) <= len(others):
            raise ValueError(
                "others: two laps have controllers of one name; give each its own by "
                "jt.simulate(..., name=...)"
            )
        return errors(self._judged.problem, {name: laps.trajectory for name, laps in runs.items()})

    def save(self, folder: str | Path) -> Path:
        """Save the laps in a folder, for `jaxtube.read`, in place of laps that were saved there;
        return the folder."""
        facts = {
            "controller": self.controller,
            "plant": self.plant,
            "seed": self.seed,
            "solves_qp": self.solves_qp,
        }
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

    def _describe_errors(self) -> str:
        """Return the RMS errors in words, or which numbers are not finite, and since when."""
        parts = {"inputs": self.trajectory.inputs, "errors": self.errors}
        for name, values in parts.items():
            finite = np.all(np.isfinite(values), axis=2)
            if not finite.all():
                first = int(np.argmin(finite.all(axis=1)))
                count = int(np.sum(~finite.all(axis=0)))
                return f"{name} are not finite from step {first} in {count:,} laps"
        along, across, heading = self.rms
        return (
            f"RMS {1e3 * along:.1f} mm along, {1e3 * across:.1f} mm across, "
            f"{np.rad2deg(heading):.2f} deg"
        )

    def __repr__(self) -> str:
        count = self.errors.shape[1]
        verdict = (
            f"<Laps: {self.outside:,} of {count:,} laps leave E; {self.controller} on the "
            f"{self.plant}; {self._describe_errors()}; "
            f"{describe_error_limits(self.design, self.plant)}"
        )
        if not self.solves_qp:
            return f"{verdict}>"
        verdict += f"; {self.without_plan} QPs without a plan"
        return "\n".join([verdict, *qp.describe_unsolved(self.statuses)]) + ">"


@overload
def simulate(
    design: Design,
    controller: ControllerChoice = "tube_mpc",
    plant: PlantChoice | None = None,
    *,
    laps: int | None = None,
    starts: StartChoice = "scenario",
    slip: SlipChoice = None,
    seed: int = 0,
    name: str = "",
) -> Laps: ...


@overload
def simulate(
    design: LinearDesign,
    controller: ControllerChoice = "tube_mpc",
    plant: PlantChoice | None = None,
    *,
    laps: int | None = None,
    starts: StartChoice = "scenario",
    slip: SlipChoice = None,
    seed: int = 0,
    name: str = "",
) -> LinearLaps: ...


@in_64_bits
def simulate(
    design: Design | LinearDesign,
    controller: ControllerChoice = "tube_mpc",
    plant: PlantChoice | None = None,
    *,
    laps: int | None = None,
    starts: StartChoice = "scenario",
    slip: SlipChoice = None,
    seed: int = 0,
    name: str = "",
) -> Laps | LinearLaps:
    """Run laps of a design's closed loop along its reference.

    Args:
        design: a design.
        controller: "tube_mpc", "plain_mpc", "equal_gain", "local_gain" and, of a robot,
            "compensated" or "uncompensated"; a law u = f(errors, reference_wheels), u in the sense
            of the scenario's controller.input_map (the deficits (V - v, Om - w) for "paper" alone);
            of a linear system a law u = f(x, th); or a `Controller`.
        plant: "robot" (the scenario's), "exact" (its slip known, its pose measured without noise),
            "linear" (the prediction model with w in W), or a `Plant`. Of a linear system "linear",
            "motion", or another `LinearSystem`. Unless given the robot; the motion where a system
            has one, else the model.
        laps: how many; 256, or one a start, unless given. All are kept: `montecarlo` keeps none.
        starts: "scenario" (its start, or the system's), "feasible" (uniform in the hull of 400
            boundary points of the tube-MPC's feasible set, less the pose noise), "edge" (on the
            boundary of that hull), or true initial errors (laps, 3) in (m, m, rad); states (laps,
            n) of a linear system.
        slip: process of the slips of the robot, a name or a `SlipProcess`; the scenario's unless
            given.
        seed: of every draw; lap i is the same whatever `laps` is.
        name: of the controller in figures and texts; of a user's own what Python calls it, unless
            given.

    Returns:
        The laps. A QP without solution does not raise: the diagnostics say so.

    Raises:
        ValueError: one line, for an unknown name, a controller of other shapes, or more laps than
            there is memory for.
    """
    require_design(design, or_linear=True)
    plant = find_plant(design, plant)
    count = _count_laps(laps, starts, design.problem.operating_set.dimension)
    refuse_laps_beyond_memory(count, design.problem.reference.steps)
    law = choose_starts(design, starts) if isinstance(starts, str) else None
    acting_controller = choose_controller(design, controller, law)
    acting_plant = choose_plant(design, plant, slip)
    if law is None:
        errors = np.asarray(starts, float)
    else:
        errors = np.asarray(law.draw(realisation_keys(seed, 0, count)))
    with show_progress(count, "simulating", "laps") as bar:
        trajectory = batches.run_realisations(
            acting_controller, acting_plant, errors, seed, bar.update
        )
    told = (name or name_controller(controller), name_choice(plant), seed)
    plans = solves_qp(acting_controller)
    if isinstance(design, LinearDesign):
        return LinearLaps(design, *told, trajectory, plans)
    return Laps(design, *told, trajectory, plans)


def _count_laps(laps: int | None, starts: StartChoice, states: int) -> int:
    """Return how many laps are asked for, by number or by their starts.

    Raises:
        ValueError: for no whole number, for starts of another shape or number, or not finite.
    """
    count = None if laps is None else require_count("laps", laps)
    if isinstance(starts, str):
        return LAPS if count is None else count
    errors = np.asarray(starts, float)
    if errors.ndim != 2 or errors.shape[1] != states or not len(errors):
        raise ValueError(
            f"starts: shape {errors.shape} is not (laps, {states}); give one initial error a lap"
        )
    if not np.all(np.isfinite(errors)):
        row = int(np.argmin(np.all(np.isfinite(errors), axis=1)))
        raise ValueError(f"starts[{row}] = {errors[row]}: is not finite; give finite errors")
    if count not in (None, len(errors)):
        raise ValueError(f"laps = {count}: starts has {len(errors)} rows; leave laps out")
    return len(errors)


def _require_laps(other: object) -> None:
    """Raise ValueError for anything but laps."""
    if isinstance(other, Laps):
        return
    told = repr(other) if isinstance(other, str) else describe_type(other)
    raise ValueError(f"others: {told} is not Laps; give jt.simulate(design, controller)")
