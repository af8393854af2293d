"""Slips that are learnt on line: how many periods count, and what is proved of their intervals."""

from __future__ import annotations

import pickle
from functools import lru_cache

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxtube.plant.slip_bounds import slip_bounds
from jaxtube.plant.slip_observer import SlipObserver
from jaxtube.scenario.tree import Scenario
from jaxtube.synthesis.problem import Problem
from sets.robot.driving import find_driving
from sets.robot.operation import Operation
from sets.robot.plant import Kinematics
from sets.robot.slip_learning import Learning, LearntSlips, bound_learnt_slips

MOST_PERIODS = 6
"""Periods that an observer looks back at; what is older has drifted, and costs time."""


def count_learnt_periods(scenario: Scenario) -> int:
    """Return how many periods an observer of the slips looks back at.

    The horizon at most: disturbances at the end of a plan are then those of slips that are learnt.
    """
    return min(scenario.controller.horizon, MOST_PERIODS)


def make_slip_observer(problem: Problem) -> SlipObserver:
    """Return the observer of the slips of a scenario that has them learnt.

    Raises:
        ValueError: where it does not.
    """
    slip = problem.scenario.slip
    if slip.change_per_s is None:
        raise ValueError("slip.change_per_s: is not given, so that no slip is learnt; give it")
    bounds = slip_bounds(slip)
    dt = problem.reference.dt
    return SlipObserver(
        least=jnp.asarray(bounds.middle - bounds.half_width),
        greatest=jnp.asarray(bounds.middle + bounds.half_width),
        change=slip.change_per_s * dt,
        noise=jnp.asarray(problem.noise),
        track_width=problem.robot.track_width,
        dt=dt,
        periods=count_learnt_periods(problem.scenario),
    )


def prove_learnt_slips(scenario: Scenario, where: Operation, how: Kinematics) -> LearntSlips:
    """Return proved bounds on the intervals of learnt slips, by the periods since the first
    measurement; `wheel_errors` of the operation are not read.

    Raises:
        ValueError: where an angle may leave a quarter turn.
    """
    return pickle.loads(_answer(pickle.dumps((scenario, where, how))))


@lru_cache(maxsize=16)
def _answer(question: bytes) -> bytes:
    scenario, where, how = pickle.loads(question)
    driving = find_driving(where, how)
    yaw_rate = float(np.abs(driving.yaw_rate).max())
    caps = np.abs(where.errors).max(axis=0)
    return pickle.dumps(bound_slips(scenario, where, caps, driving.wheels, yaw_rate))


def bound_slips(
    scenario: Scenario,
    where: Operation,
    caps: Float[np.ndarray, "3"],
    speeds: Float[np.ndarray, "2 2"],
    yaw_rate: float,
) -> LearntSlips:
    """Return bounds on the intervals of learnt slips.

    Args:
        scenario: gives the slips.
        where: gives noise, period, track width and reference.
        caps: of the measured errors, (m, m, rad).
        speeds: ground speeds commanded (least, greatest) by (right, left), m/s.
        yaw_rate: greatest one commanded, rad/s.
    """
    bounds = slip_bounds(scenario.slip)
    change = scenario.slip.change_per_s
    assert change is not None
    lower, upper = where.box[:, 5:7]
    learning = Learning(
        slips=np.stack([bounds.middle - bounds.half_width, bounds.middle + bounds.half_width]),
        change=change * where.dt,
        periods=count_learnt_periods(scenario),
        errors=caps,
        noise=where.noise,
        speeds=speeds,
        yaw_rate=yaw_rate,
        reference_speed=float(np.maximum(np.abs(lower), np.abs(upper)).max()),
        dt=where.dt,
        track_width=where.track_width,
    )
    return bound_learnt_slips(learning)
