"""The four tubes of a design: sets R_0 .. R_N that hold the deviation from a plan, j steps ahead.

    Tube           one row of sections, for every order of wheel speeds in the regions
                   (`paper`, `hull`, `summed`)
    FollowingTube  sections along the reference, its own in every window (`sequence`)

Whoever uses a tube asks it: for its support numbers, window by window, for the inputs it takes, and
whether it follows the reference. As a sequence it is its sections R_0 .. R_N; where these differ
from window to window, those of the window with the widest lateral reach whose plan the reference
follows to its end.

Sources: Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (26)-(27) (`paper`); Chisci, Rossiter, Zappa
2001 (restarted tubes).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxtube.synthesis.control_problem import ControlProblem
from jaxtube.synthesis.gain_schedule import GainSchedule
from jaxtube.synthesis.gains import Gain
from jaxtube.synthesis.limits import InputRows
from jaxtube.synthesis.problem import Problem
from jaxtube.synthesis.regimes import Disturbances
from jaxtube.synthesis.windows import Windows
from sets import tubes
from sets.tubes import Section

AFFINE = 1e-12
"""By how much a loop may miss an affine function of the schedule that it is taken for."""
SAME_REACH = 1e-6
"""Relative difference of two reaches that is none: gains of an LMI agree to 1e-8 from one processor
to another, and windows that mirror each other are equally wide."""


@dataclass(frozen=True, eq=False)
class Tube(Sequence[Section]):
    """Sections R_0 .. R_N that hold for every order of wheel speeds in the regions."""

    follows_reference: ClassVar[bool] = False

    name: str
    gain: GainSchedule
    sections: Sequence[Section]

    def __getitem__(self, stage):
        return self.sections[stage]

    def __len__(self) -> int:
        return len(self.sections)

    @property
    def sections_by_window(self) -> list[Sequence[Section]]:
        """R_0 .. R_N of every window, or the one row that all windows share."""
        return [self.sections]

    def shows(self, windows: Int[np.ndarray, " k"]) -> Bool[np.ndarray, " k"]:
        """Return which windows have the sections that are shown."""
        return np.ones(len(windows), bool)

    def support(
        self, stage: int, rows: Float[np.ndarray, "k 3"]
    ) -> Float[np.ndarray, "windows_or_1 k"]:
        """Return the support numbers of R_stage along rows, window by window."""
        return self.sections[stage].support(rows)[None]

    def input_support(self, stage: int, rows: InputRows) -> Float[np.ndarray, "windows_or_1 k"]:
        """Return the support numbers of R_stage along rows on input and error under u = K e, over
        the gains that may act."""
        section = self.sections[stage]
        by_gain = [section.support(row) for row in rows.on_errors(self.gain.corner_gains)]
        return np.max(by_gain, axis=0)[None]

    def margins(
        self, deviations: Float[np.ndarray, "horizon samples 3"]
    ) -> Float[np.ndarray, "horizon samples"]:
        """Return the facet margin of deviations from plans in R_1 .. R_N, those that are shown."""
        sections = zip(self.sections[1:], deviations, strict=True)
        return np.stack([section.polytope().margin(points) for section, points in sections])

    def half_widths(self) -> Float[np.ndarray, "horizon+1 3"]:
        """Return the half widths of R_0 .. R_N, (m, m, rad), the largest over the windows."""
        return np.stack(
            [
                self.support(j, np.eye(self.sections[0].dimension)).max(axis=0)
                for j in range(len(self))
            ]
        )


@dataclass(frozen=True, eq=False)
class FollowingTube(Tube):
    """Sections along the known reference: those of the shown window, and by support numbers those
    of all."""

    follows_reference: ClassVar[bool] = True

    windows: Windows
    disturbances: Disturbances
    shown_window: int

    @cached_property
    def sections_by_window(self) -> list[Sequence[Section]]:
        """R_0 .. R_N of every window."""
        return [
            make_window_sections(self.windows, self.disturbances, window)
            for window in range(len(self.windows.loops))
        ]

    def shows(self, windows: Int[np.ndarray, " k"]) -> Bool[np.ndarray, " k"]:
        """Return which windows have the sections that are shown."""
        return windows == self.shown_window

    def support(self, stage: int, rows: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "windows k"]:
        """Return the support numbers of R_stage along rows, window by window."""
        by_window = np.broadcast_to(rows, (len(self.windows.loops), *rows.shape))
        return self._support(stage, by_window)

    def input_support(self, stage: int, rows: InputRows) -> Float[np.ndarray, "windows k"]:
        """Return the support numbers of R_stage along rows under the gain that acts at the stage,
        after the last one the last gain."""
        last = self.windows.gains.shape[1] - 1
        under = rows.on_errors(self.windows.gains[:, min(stage, last)])
        return self._support(stage, under)

    def _support(
        self, stage: int, rows: Float[np.ndarray, "windows k 3"]
    ) -> Float[np.ndarray, "windows k"]:
        """Return the support numbers of R_stage along rows of every window."""
        return support_windows(self.windows, self.disturbances, rows, stage)


def make_tubes(problem: ControlProblem, gain: GainSchedule, windows: Windows) -> dict[str, Tube]:
    """Return the four tubes by name.

    `paper` is left out where eq. (27) does not apply, that is where the loop is not affine in the
    schedule, and all but the one along the reference where gains go by speed.
    """
    following = make_following_tube(problem, gain, windows)
    if isinstance(problem, Problem) and problem.scenario.operating.bands:
        return {following.name: following}
    W = problem.disturbance_set
    N = problem.horizon
    shared = {
        "hull": tubes.hull_tube(gain.loops, W, N),
        "summed": tubes.summed_tube(gain.loops, W, N),
    }
    slopes = loop_slopes(gain) if isinstance(gain, Gain) else None
    if slopes is not None and isinstance(problem, Problem):
        nominal, right, left = slopes
        ranges = [(-half, half) for half in problem.model.half_widths]
        paper = tubes.paper_tube(nominal, (right, left), ranges, W, N)
        shared = {"paper": paper, **shared}
    made = {name: Tube(name, gain, sections) for name, sections in shared.items()}
    return {**made, following.name: following}


def make_following_tube(
    problem: ControlProblem, gain: GainSchedule, windows: Windows
) -> FollowingTube:
    """Return the tube along the reference, the window of widest lateral reach shown."""
    widest = find_widest_window(problem, windows)
    sections = make_window_sections(windows, problem.disturbances, widest)
    return FollowingTube("sequence", gain, sections, windows, problem.disturbances, widest)


def make_window_sections(
    windows: Windows, disturbances: Disturbances, window: int
) -> list[Section]:
    """Return R_0 .. R_N along the periods of a window."""
    of_periods = disturbances.of_periods(windows.regimes[window])
    return tubes.sequence_tube(windows.loops[window], of_periods)


def support_windows(
    windows: Windows,
    disturbances: Disturbances,
    rows: Float[np.ndarray, "windows k 3"],
    stage: int,
) -> Float[np.ndarray, "windows k"]:
    """Return the support numbers of R_stage along the periods of every window."""
    return tubes.sequence_support(windows.loops, disturbances.sets, rows, stage, windows.regimes)


def find_widest_window(problem: ControlProblem, windows: Windows) -> int:
    """Return the first window whose tube along the reference has the widest lateral reach; of a
    linear system the widest as a share of E.

    Windows that come only within the last horizon of the reference are left out, where there are
    others: no plan of theirs is followed to its end.
    """
    rows = np.array([[0.0, 1.0, 0.0]])
    if not isinstance(problem, Problem):
        E = problem.operating_set
        rows = E.normals / E.offsets[:, None]
    by_window = np.broadcast_to(rows, (len(windows.loops), *rows.shape))
    reach = support_windows(windows, problem.disturbances, by_window, problem.horizon).max(axis=1)
    plans_that_end = max(len(windows.index) - problem.horizon + 1, 0)
    followed = windows.index[:plans_that_end] if plans_that_end else windows.index
    widest = reach[followed].max()
    return int(followed[reach[followed] >= (1 - SAME_REACH) * widest].min())


def loop_slopes(gain: Gain) -> Float[np.ndarray, "3 3 3"] | None:
    """Return (Phi_n, slope in V_r, slope in V_l) where Phi is affine in the schedule, else None."""
    model = gain.model
    if model.discretisation != "euler":
        return None
    loops = gain.loops_along(model.vertices).reshape(4, 9)
    corners = np.column_stack([np.ones(4), model.vertices - model.centre])
    fitted, *_ = np.linalg.lstsq(corners, loops, rcond=None)
    is_affine = np.max(np.abs(corners @ fitted - loops)) <= AFFINE
    return fitted.reshape(3, 3, 3) if is_affine else None
