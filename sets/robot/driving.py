"""The speeds that a controller may ask for over an operating set, and what lag and delay make of
them.

Commands are found by interval arithmetic, as W is (`sets.robot.disturbance`): those given before
come from the same operation, so that all that wheels with lag and delay still follow lies in these
ranges, too.

Source: new.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from sets.robot.actuation import NO_LAG
from sets.robot.committed import Commitment, bound_commitment
from sets.robot.late_ways import Driving
from sets.robot.operation import FINE, Operation
from sets.robot.plant import Kinematics, Late, split_disturbance
from sets.supremum import suprema

BOTH_ENDS = list(product((-1, 1), range(3)))
"""Signs and numbers of three outputs."""
TOLERANCE = 0.003
"""Relative gap between bounds and values found at which a bound is good enough."""


class CommittedOperation(NamedTuple):
    """An operation of the committed pose, and what is not in it.

    Attributes:
        operation: its wheels lose speed, its body speed and yaw rate, its kicks have the lever of
            the latency, and it does not slide.
        commitment: what lag and delay do.
    """

    operation: Operation
    commitment: Commitment


def commit_operation(operation: Operation, kinematics: Kinematics) -> CommittedOperation:
    """Return an operation whose wheels lag as one whose wheels obey at once, but lose more.

    Raises:
        ValueError: where an angle may leave a quarter turn, or the wheels lose too much.
    """
    driving = find_driving(operation, kinematics)
    commitment = bound_commitment(
        operation.actuation,
        operation.dt,
        operation.track_width,
        driving,
        operation.ground,
        2 * operation.period.lateral_per_yaw / operation.dt,
    )
    committed = replace(
        operation,
        wheel_errors=commitment.loss,
        stale_errors=None,
        sideslip=0.0,
        lever_arm=0.0,
        actuation=NO_LAG,
        late=Late(commitment.lever, *commitment.unknown),
    )
    return CommittedOperation(committed, commitment)


def find_driving(operation: Operation, kinematics: Kinematics) -> Driving:
    """Return the speeds that may be asked for, proved by intervals."""
    period = operation.period

    def outputs(piece):
        parts = split_disturbance(kinematics, period, operation.variables(piece))
        return parts.right, parts.left, (parts.right + parts.left) * 0.5

    lower, upper = operation.without_disturbances().pieces()
    ends = [(output, sign, group) for group, (sign, output) in enumerate(BOTH_ENDS)]
    proved, _ = suprema(outputs, lower, upper, ends, TOLERANCE, FINE * operation.speed)
    least = -proved[:3]
    most = proved[3:]
    return Driving(
        wheels=np.stack([least[:2], most[:2]]),
        speed=np.array([least[2], most[2]]),
        yaw_rate=_find_yaw_rates(operation),
        change=operation.body_change,
        wheel_change=operation.wheel_change,
    )


def _find_yaw_rates(operation: Operation) -> Float[np.ndarray, "2"]:
    """Return the least and the greatest yaw rate commanded, rad/s."""
    lower, upper = np.moveaxis(operation.schedules, 1, 0)
    slowest = (lower[:, 0] - upper[:, 1]).min() / operation.track_width
    fastest = (upper[:, 0] - lower[:, 1]).max() / operation.track_width
    least_deficit, most_deficit = operation.inputs[:, 1]
    rates = np.array([slowest - most_deficit, fastest - least_deficit])
    return rates + np.array([-1.0, 1.0]) * 1e-12 * np.abs(rates)
