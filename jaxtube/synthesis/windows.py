"""Windows: the distinct stretches of N schedules along the reference, with the loops along each.

On a circle all steps share one window; so do the condensed problems made from them. Stretches whose
periods belong to different regimes are different windows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from jaxtube.synthesis.gains import Gain
from jaxtube.synthesis.problem import SAME_SPEED_DECIMALS, Problem, merge_equal_speeds


@dataclass(frozen=True, eq=False)
class Windows:
    """Distinct stretches of N schedules, and which one each step of the run has ahead."""

    schedules: Float[np.ndarray, "windows horizon 2"]
    index: Int[np.ndarray, " steps"]
    loops: Float[np.ndarray, "windows horizon 3 3"]
    gains: Float[np.ndarray, "windows horizon 2 3"]
    regimes: Int[np.ndarray, "windows horizon"]

    def followers(self, window: int) -> Int[np.ndarray, " k"]:
        """Return the windows that steps along the reference have ahead right after this one."""
        return np.unique(self.index[1:][self.index[:-1] == window])


def make_windows(problem: Problem, gain: Gain) -> Windows:
    """Collect the distinct windows of the reference with their closed loops."""
    horizon = problem.horizon
    steps = problem.reference.steps
    wheels = merge_equal_speeds(problem.schedule)
    regimes = problem.period_regimes
    # The regime of a period stands beside its wheel speeds, so that both tell windows apart.
    periods = np.column_stack([wheels.round(SAME_SPEED_DECIMALS), regimes])
    stretches = np.stack([periods[j : j + steps] for j in range(horizon)], axis=1)
    _, first, index = np.unique(stretches, axis=0, return_index=True, return_inverse=True)
    ahead = first[:, None] + np.arange(horizon)
    schedules = wheels[ahead]
    return Windows(
        schedules=schedules,
        index=index.reshape(-1),
        loops=gain.loops_along(schedules),
        gains=gain.along(schedules),
        regimes=regimes[ahead],
    )
