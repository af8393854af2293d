"""The disturbance bound of a problem: what the slipping robot adds to its model over everything that is certified."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sets.disturbance import DisturbanceBound, Operation, disturbance_bound, wheel_error_bound
from sets.plant import Kinematics

if TYPE_CHECKING:
    from jaxtube.design.problem import Problem


def operations(problem: Problem) -> list[Operation]:
    """Return where the robot works, one operation a region: measured errors, inputs, slip errors and noise."""
    slip = problem.scenario.slip
    nominal = np.array([slip.nominal_right, slip.nominal_left])
    return [
        Operation(
            errors=_ends(problem.operating_set),
            inputs=_ends(problem.input_set),
            schedule=region,
            wheel_error=wheel_error_bound(nominal, slip.relative_error, slip.random),
            noise=problem.error_set.support(np.eye(3)) - problem.operating_set.support(np.eye(3)),
            dt=problem.model.dt,
            track_width=problem.model.track_width,
        )
        for region in problem.regions
    ]


def kinematics(problem: Problem) -> Kinematics:
    """Return the input map and the model of a problem."""
    settings = problem.scenario.controller
    factors = tuple(float(factor) for factor in problem.model.slip_factors)
    return Kinematics(settings.input_map, settings.model, settings.discretisation, (factors[0], factors[1]))


def residual_bound(problem: Problem) -> DisturbanceBound:
    """Return W for the robot itself, over the regions, the operating set, the inputs and the slip errors."""
    (operation,) = operations(problem)
    return disturbance_bound(operation, kinematics(problem))


def _ends(polytope) -> np.ndarray:
    identity = np.eye(polytope.dimension)
    return np.stack([-polytope.support(-identity), polytope.support(identity)])
