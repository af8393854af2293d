"""Wheels that lag at corners of the operating set, fast enough for a search: what
`sets.robot.driving` does by intervals, at n points.

Source: new.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxtube.synthesis.estimated_error import FAR, CornerErrors
from sets.robot.committed import Commitment, bound_commitment
from sets.robot.late_ways import Driving
from sets.robot.latency import bound_late_pose_errors
from sets.robot.operation import Operation

HOPELESS = Commitment(
    loss=np.zeros((2, 2)),
    unknown=np.zeros(2),
    kick=0.0,
    lever=0.0,
    box=np.full(2, FAR),
    slide=np.zeros(2),
)
"""Of wheels that lose so much that nothing is bounded."""


class LatePoints(NamedTuple):
    """What is asked for at n points, and what lag and delay do there."""

    drivings: list[Driving]
    commitments: list[Commitment]

    @property
    def loss(self) -> Float[np.ndarray, "2 2 n"]:
        """Ends of what slip takes from the wheels (right, left), m/s."""
        return np.stack([each.loss for each in self.commitments], axis=-1)

    @property
    def unknown(self) -> Float[np.ndarray, "2 n"]:
        """What unknown lag and delay take at most from (speed m/s, yaw rate rad/s)."""
        return np.stack([each.unknown for each in self.commitments], axis=-1)


def commit_points(
    operation: Operation, speeds: Float[np.ndarray, "2 n corners"], turning: Float[np.ndarray, " n"]
) -> LatePoints:
    """Return what lag and delay do at points.

    Args:
        operation: with lag and delay.
        speeds: asked for at corners (right, left), m/s.
        turning: greatest yaw rate deficits, rad/s.
    """
    drivings = []
    commitments = []
    for wheels, deficit in zip(np.moveaxis(speeds, 1, 0), turning, strict=True):
        driving = _find_driving(operation, wheels, deficit)
        drivings.append(driving)
        commitments.append(_commit(operation, driving))
    return LatePoints(drivings, commitments)


def _find_driving(
    operation: Operation, wheels: Float[np.ndarray, "2 corners"], deficit: float
) -> Driving:
    speed = wheels.mean(axis=0)
    slow, fast = np.moveaxis(operation.schedules, 1, 0)
    turns = np.array([(slow[:, 0] - fast[:, 1]).min(), (fast[:, 0] - slow[:, 1]).max()])
    return Driving(
        wheels=np.stack([wheels.min(axis=1), wheels.max(axis=1)]),
        speed=np.array([speed.min(), speed.max()]),
        yaw_rate=turns / operation.track_width + deficit * np.array([-1.0, 1.0]),
        change=operation.body_change,
        wheel_change=operation.wheel_change,
    )


def _commit(operation: Operation, driving: Driving) -> Commitment:
    middle_speed = 2 * operation.period.lateral_per_yaw / operation.dt
    try:
        return bound_commitment(
            operation.actuation,
            operation.dt,
            operation.track_width,
            driving,
            operation.ground,
            middle_speed,
        )
    except ValueError:
        return HOPELESS


def find_speed_extremes(speeds: Float[np.ndarray, "2 1 corners"]) -> Int[np.ndarray, " extremes"]:
    """Return the corners at which what is asked for is extreme."""
    of_wheels = speeds[:, 0]
    levels = [*of_wheels, of_wheels.mean(axis=0)]
    return np.array([level.argmax() for level in (*levels, *(-each for each in levels))])


def add_lag(corners: CornerErrors, late: LatePoints) -> CornerErrors:
    """Return what may happen at corners with what lag and delay add, the way it adds most."""
    added = np.stack([each.box + each.slide for each in late.commitments], axis=-1)
    most = np.array([each.kick for each in late.commitments])[:, None]
    sliding = corners.sliding + np.copysign(added[:, :, None], corners.model + corners.sliding)
    return corners._replace(sliding=sliding, yaw=np.clip(corners.yaw, -most, most))


def find_pose_errors(
    operation: Operation, late: LatePoints, errors: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """Return the greatest errors of the pose itself, (m, m, rad), from those that are kept."""
    return np.stack(
        [
            bound_late_pose_errors(
                kept,
                operation.actuation,
                operation.dt,
                operation.track_width,
                driving,
                operation.ground,
                operation.schedules,
            )
            for kept, driving in zip(errors, late.drivings, strict=True)
        ]
    )
