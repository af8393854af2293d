"""Natural units of a problem: lengths by the lateral limit, times by the period, angles in radians.

A search in these units takes the same steps for a robot of any size, and at any speed: the numbers
are rounded to `DIGITS`, so that not even what rounding leaves of a change of units is seen.

Source: new.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxtube.plant.robot import Robot
from jaxtube.scenario.tree import Scenario
from jaxtube.scenario.units import (
    NONE,
    TRACKING_GAINS,
    find_powers,
    rescale,
    round_significant,
)
from jaxtube.synthesis.limits import input_constraints, operating_bounds
from jaxtube.synthesis.problem import Problem
from sets.polytope import Polytope

DIGITS = 12
"""Significant digits of what is given, in natural units."""
DECIMALS = 9
"""Decimals of the logarithms that a search starts from."""


class NaturalUnits(NamedTuple):
    """What is 1: a length in m and a time in s."""

    length: float
    time: float

    @classmethod
    def of(cls, scenario: Scenario) -> NaturalUnits:
        """Return the natural units of a scenario."""
        return cls(scenario.constraints.lateral_m, scenario.controller.dt_s)

    def logarithms(self, names: Sequence[str]) -> Float[np.ndarray, " k"]:
        """Return the logarithms of the units of caps, by their keys in [operating], then of three
        tracking gains and of an observer's gain."""
        powers = [find_powers(f"operating.{name}") for name in names]
        powers += [*TRACKING_GAINS, NONE, NONE, NONE]
        return np.array(powers) @ np.log([self.length, self.time])

    def express(self, problem: Problem) -> Problem:
        """Return the problem in these units, except its reference, W and weights."""
        scenario = rescale(problem.scenario, 1 / self.length, 1 / self.time, DIGITS)
        speed = self.length / self.time
        robot = Robot(
            scenario.robot.turning_track_m,
            scenario.robot.wheel_speed_min_mps,
            scenario.robot.wheel_speed_max_mps,
            scenario.robot.lever_arm_m,
        )
        lower, upper = problem.model.box
        model = replace(
            problem.model,
            dt=scenario.controller.dt_s,
            track_width=robot.track_width,
            box=(_round(lower / speed), _round(upper / speed)),
        )
        caps = operating_bounds(scenario)
        input_set, input_rows = input_constraints(scenario, robot)
        lengths = np.array([self.length, self.length, 1.0])
        return replace(
            problem,
            scenario=scenario,
            robot=robot,
            model=model,
            operating_set=Polytope.box(-caps, caps),
            input_set=input_set,
            input_rows=input_rows,
            initial_error=_round(problem.initial_error / lengths),
            regions=_round(problem.regions / speed),
            estimate_error=problem.estimate_error / lengths,
        )


def _round(values: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Return numbers of `DIGITS` significant digits."""
    rounded = [round_significant(value, DIGITS) for value in values.ravel().tolist()]
    return np.reshape(rounded, values.shape)
