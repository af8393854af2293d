"""Laps as a run folder keeps them, `laps.npz`: enough to play and to draw them without a design.

    period_s                length of a period, s
    reference_poses         (steps+1, 3) poses of the reference in the world, m, m, rad
    track_m                 distance between the wheels, m
    controllers             names of the controllers
    NAME_errors             (steps+1, laps, 3) true tracking errors, m, m, rad
    NAME_inputs             (steps, laps, 2) virtual inputs, m/s and rad/s
    NAME_wheels             (steps, laps, 2) wheel speeds (right, left), m/s; NaN for a model that
                            has no wheels
    NAME_numbers            (laps,) numbers of the laps in their run
    NAME_total              laps of the run that these were taken from
    NAME_limits             (3,) half widths of the E that they are judged by, m, m, rad
    NAME_section            (corners, 2) corners of the last section of the tube, e_x and e_y, m

The pose of the robot follows from an error e and a pose (x, y, phi) of the reference: its heading
is phi - e_theta, its position (x, y) less (e_x, e_y) turned by that heading.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxtube.figures.style import outline
from jaxtube.numpy_archive import read_archive

if TYPE_CHECKING:
    from jaxtube.simulation.rollout import Trajectory
    from jaxtube.synthesis.parts import Design

FILE = "laps.npz"


class LapSet(NamedTuple):
    """The laps of one controller that were kept."""

    errors: Float[np.ndarray, "steps+1 laps 3"]  # m, m, rad
    inputs: Float[np.ndarray, "steps laps 2"]  # m/s, rad/s
    wheels: Float[np.ndarray, "steps laps 2"]  # right, left, m/s
    numbers: Int[np.ndarray, " laps"]
    total: int
    limits: Float[np.ndarray, "3"]  # half widths of E, m, m, rad
    section: Float[np.ndarray, "corners 2"]  # of the tube: e_x, e_y, m

    def in_double_precision(self) -> LapSet:
        """Return the same laps as computations want them, in double precision."""
        return self._replace(errors=self.errors.astype(float), wheels=self.wheels.astype(float))

    @property
    def usage(self) -> Float[np.ndarray, " laps"]:
        """The largest share of a limit that each lap used; inf for a lap that is no finite number
        somewhere."""
        largest = (np.abs(self.errors) / self.limits).max(axis=(0, 2))
        return np.where(np.isfinite(largest), largest, np.inf)

    def find(self, which: str) -> int:
        """Return the place of a lap among those kept: "median" or "worst" by `usage`, or its
        number in the run.

        Raises:
            ValueError: one line, where no such lap was kept.
        """
        order = np.argsort(self.usage, kind="stable")
        if which == "worst":
            return int(order[-1])
        if which == "median":
            return int(order[(len(order) - 1) // 2])
        places = np.flatnonzero(self.numbers == _read_number(which))
        if not len(places):
            kept = ", ".join(map(str, self.numbers[:8]))
            more = ", .." if len(self.numbers) > 8 else ""
            raise ValueError(f"is none of the laps that were kept; give one of {kept}{more}")
        return int(places[0])


class StoredLaps(NamedTuple):
    """All laps that were kept of a run, and what they are measured against (see the module)."""

    period_s: float
    reference_poses: Float[np.ndarray, "steps+1 3"]
    track_m: float
    laps: dict[str, LapSet]

    def poses(self, name: str) -> Float[np.ndarray, "steps+1 laps 3"]:
        """Return the poses of the robot in the world, m, m, rad."""
        return find_poses(self.laps[name].errors, self.reference_poses[:, None])

    def arrays(self) -> dict[str, np.ndarray]:
        """Return what `laps.npz` holds."""
        arrays: dict[str, Any] = {
            "period_s": self.period_s,
            "reference_poses": self.reference_poses,
            "track_m": self.track_m,
            "controllers": np.array(list(self.laps)),
        }
        for name, kept in self.laps.items():
            arrays |= {f"{name}_{field}": value for field, value in kept._asdict().items()}
        return {name: np.asarray(value) for name, value in arrays.items()}


def collect(
    design: Design,
    laps: Mapping[str, Trajectory],
    numbers: Mapping[str, Int[np.ndarray, " laps"]] | None = None,
    total: int | None = None,
) -> StoredLaps:
    """Return laps of a design as they are kept, in single precision.

    Args:
        design: whose E, tube and reference they are shown with.
        laps: by controller's name.
        numbers: of the laps in their run, by controller's name; None where all laps are there.
        total: laps of the run; None where all are there.
    """
    problem = design.problem
    limits = problem.error_set.support(np.eye(3))
    section = outline(design.tube[-1].vertices()[:, :2])
    kept = {}
    for name, lap in laps.items():
        errors = np.asarray(lap.errors, np.float32)
        count = errors.shape[1]
        kept[name] = LapSet(
            errors,
            np.asarray(lap.inputs, np.float32),
            np.asarray(lap.wheels, np.float32),
            np.arange(count) if numbers is None else np.asarray(numbers[name]),
            count if total is None else total,
            limits,
            section,
        )
    return StoredLaps(
        problem.reference.dt,
        np.asarray(problem.reference.poses[: problem.reference.steps + 1]),
        problem.robot.track_width,
        kept,
    )


def read(folder: Path) -> StoredLaps:
    """Return the laps of a run folder.

    Raises:
        FileNotFoundError: where it holds none.
        ValueError: where they are damaged.
        KeyError: where a part of them is missing.
    """
    arrays: dict[str, Any] = dict(read_archive((folder / FILE).read_bytes()))
    laps = {
        str(name): LapSet(*(arrays[f"{name}_{field}"] for field in LapSet._fields))
        for name in arrays["controllers"]
    }
    return StoredLaps(
        float(arrays["period_s"]), arrays["reference_poses"], float(arrays["track_m"]), laps
    )


def find_poses(
    errors: Float[np.ndarray, "... 3"], reference: Float[np.ndarray, "... 3"]
) -> Float[np.ndarray, "... 3"]:
    """Return the poses of robots, in float64, from tracking errors and poses of the reference."""
    ahead, aside, turn = np.moveaxis(np.asarray(errors, float), -1, 0)
    x, y, heading = np.moveaxis(np.asarray(reference, float), -1, 0)
    heading = heading - turn
    cosine = np.cos(heading)
    sine = np.sin(heading)
    return np.stack(
        [x - cosine * ahead + sine * aside, y - sine * ahead - cosine * aside, heading], axis=-1
    )


def _read_number(word: str) -> int:
    return int(word) if word.isdecimal() else -1
