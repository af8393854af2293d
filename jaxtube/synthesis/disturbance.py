"""The disturbance bound of a problem: what the slipping robot adds to its model over everything
that is certified."""

from __future__ import annotations

import itertools
import pickle
from dataclasses import replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from jaxtube.coordinates import KEYS, TO_DISPLAY
from jaxtube.plant.slip_bounds import compensated_slips, slip_bounds
from jaxtube.scenario.error_box import error_vector
from jaxtube.scenario.refusal import ScenarioError
from jaxtube.scenario.rules import CAP_ROUNDING
from jaxtube.scenario.tree import Scenario, Slip
from jaxtube.synthesis.acceleration import find_command_steps, limit_acceleration
from jaxtube.synthesis.bands import join_bands, split_bands
from jaxtube.synthesis.learnt_slips import count_learnt_periods, prove_learnt_slips
from jaxtube.synthesis.problem import Problem, make_problem, with_regimes
from jaxtube.synthesis.regimes import RegimesByAge
from sets.polytope import Polytope
from sets.robot.actuation import Actuation
from sets.robot.between import bound_excursion
from sets.robot.disturbance import (
    DisturbanceBound,
    disturbance_bound,
    wheel_error_bound,
    wheel_error_range,
)
from sets.robot.driving import find_driving
from sets.robot.latency import bound_late_pose_errors
from sets.robot.observer import bound_next_error, find_estimate_error
from sets.robot.operation import Operation
from sets.robot.plant import Kinematics
from sets.robot.slip_learning import LearntSlips

FLAT = 1e-12
"""Half width below which W is flat, as a share of the limits of the error."""


def operation(problem: Problem) -> Operation:
    """Return where the robot works: measured or estimated errors, inputs, certified wheel speeds,
    slip errors and noise. Inputs are those that the rows of the QPs allow."""
    where = find_place(problem)
    if not problem.scenario.slip.is_learnt:
        return where
    greatest = find_wheel_error_sizes(problem)
    return replace(where, wheel_errors=np.stack([-greatest, greatest]))


def find_learnt_slips(problem: Problem) -> LearntSlips:
    """Return what is proved of slips that are learnt.

    Raises:
        ValueError: as `prove_bound`.
    """
    where = find_place(problem)
    return prove_learnt_slips(problem.scenario, where, kinematics(problem))


def find_wheel_error_sizes(problem: Problem) -> Float[np.ndarray, "2"]:
    """Return the greatest relative errors of the ground speeds (right, left) of slips that are
    learnt, by the periods that they have been."""
    by_age = find_learnt_slips(problem).wheel_errors
    return by_age[-1 if problem.periods_learnt is None else problem.periods_learnt]


def find_place(problem: Problem) -> Operation:
    """Return the operation; of slips that are learnt that of a controller that knows nothing of
    them."""
    slip = problem.scenario.slip
    rows = problem.cap_rows
    is_coupled = rows.is_coupled
    input_set = Polytope(rows.inputs[~is_coupled], rows.offsets[~is_coupled])
    coupling = None
    if is_coupled.any():
        offsets = rows.offsets[is_coupled]
        of_error = np.max(offsets / np.abs(rows.errors[is_coupled, 0]))
        of_turning = np.max(offsets / np.abs(rows.inputs[is_coupled, 1]))
        # Outwards: the operation holds all that the rows allow.
        coupling = (float(np.nextafter(of_error, np.inf)), float(np.nextafter(of_turning, np.inf)))
    return Operation(
        errors=problem.operating_set.offsets[:3] * np.array([[-1.0], [1.0]]),
        inputs=_box_ends(input_set),
        schedules=problem.regions,
        wheel_errors=_find_wheel_errors(slip),
        noise=problem.noise,
        dt=problem.model.dt,
        track_width=problem.model.track_width,
        sideslip=slip.sideslip,
        lever_arm=problem.robot.lever_arm,
        coupling=coupling,
        gain=problem.scenario.controller.observer_gain,
        estimate_error=problem.estimate_error,
        actuation=find_actuation(problem.scenario),
        stale_errors=_find_stale_errors(problem.scenario),
        command_steps=find_command_steps(problem),
    )


def find_actuation(scenario: Scenario) -> Actuation:
    """Return lag and delay of the wheels."""
    return Actuation(scenario.robot.wheel_lag_s, scenario.robot.command_delay_s)


def _find_wheel_errors(slip: Slip) -> Float[np.ndarray, "2 2"]:
    """Return the box of the relative errors of the ground speeds (right, left)."""
    if slip.has_intervals:
        return wheel_error_range(slip_bounds(slip).extremes())
    # The measured slip's error is the larger of the two single ones, so either may vary.
    reading = "both" if slip.random == "both" else "measured"
    greatest = wheel_error_bound(np.array(slip.nominal), slip.relative_error, reading)
    return np.stack([-greatest, greatest])


def _find_stale_errors(scenario: Scenario) -> Float[np.ndarray, "2 2"] | None:
    """Return the same box where a wheel that lags slips now, under commands that compensated the
    slip of another time; None where they all compensate the same."""
    slip = scenario.slip
    if scenario.robot.obeys_at_once or not (slip.is_measured or slip.random != "true"):
        return None
    slips = slip_bounds(slip).extremes()
    stale = wheel_error_range(np.array(list(itertools.product(slips[:, 0], slips[:, 1]))))
    fresh = _find_wheel_errors(slip)
    return np.stack([np.minimum(stale[0], fresh[0]), np.maximum(stale[1], fresh[1])])


def kinematics(problem: Problem) -> Kinematics:
    """Return the input map and the model of a problem."""
    settings = problem.scenario.controller
    right, left = problem.model.slip_factors
    return Kinematics(
        settings.input_map,
        settings.model,
        settings.discretisation,
        (float(right), float(left)),
    )


def prove_bound(problem: Problem) -> DisturbanceBound:
    """Return the bound on w that interval arithmetic proves over everything certified, whatever
    bound the problem carries.

    A process works out each answer once: the certificate asks what the design asked before.

    Raises:
        ValueError: where errors and inputs are so wide that angles leave a quarter turn.
    """
    return pickle.loads(_answer(pickle.dumps((operation(problem), kinematics(problem)))))


@lru_cache(maxsize=16)
def _answer(question: bytes) -> bytes:
    """Return the bound for an operation and kinematics; bytes, so that nobody can change it."""
    where, how = pickle.loads(question)
    return pickle.dumps(disturbance_bound(where, how))


def prove_next_error(problem: Problem) -> Float[np.ndarray, "3"]:
    """Return a proved bound (m, m, rad) of the estimate's error a period later, where the problem's
    `estimate_error` bounds it now.

    Raises:
        ValueError: as `prove_bound`.
    """
    return pickle.loads(_answer_next_error(pickle.dumps((operation(problem), kinematics(problem)))))


@lru_cache(maxsize=16)
def _answer_next_error(question: bytes) -> bytes:
    where, how = pickle.loads(question)
    return pickle.dumps(bound_next_error(where, how))


@lru_cache(maxsize=16)
def _answer_estimate_error(question: bytes) -> bytes:
    where, how = pickle.loads(question)
    return pickle.dumps(find_estimate_error(where, how))


def bound_committed_errors(problem: Problem) -> Float[np.ndarray, "3"]:
    """Return the greatest true errors, (m, m, rad), that the caps leave: of wheels that lag those
    of the committed pose."""
    limits = problem.operating_set.support(np.eye(3)) + problem.estimate_error
    return np.maximum(limits, problem.error_set.support(np.eye(3)))


def bound_pose_errors(problem: Problem) -> Float[np.ndarray, "3"]:
    """Return the greatest true errors, (m, m, rad): of wheels that lag those of the pose itself, at
    each instant and a latency after it.

    Raises:
        ValueError: as `prove_bound`.
    """
    promised = bound_committed_errors(problem)
    where = operation(problem)
    if where.actuation.is_ideal:
        return promised
    driving = find_driving(where, kinematics(problem))
    return bound_late_pose_errors(
        promised,
        where.actuation,
        where.dt,
        where.track_width,
        driving,
        where.ground,
        where.schedules,
    )


def bound_error_between_periods(problem: Problem) -> Float[np.ndarray, "3"]:
    """Return how far true errors, (m, m, rad), leave the box of those at the ends of periods in
    between.

    Raises:
        ValueError: where wheels lag, or errors are so wide that angles leave a quarter turn.
    """
    limits = bound_committed_errors(problem)
    question = pickle.dumps((operation(problem), kinematics(problem), limits))
    return pickle.loads(_answer_excursion(question))


@lru_cache(maxsize=16)
def _answer_excursion(question: bytes) -> bytes:
    return pickle.dumps(bound_excursion(*pickle.loads(question)))


def ground_speed_limits(problem: Problem) -> Float[np.ndarray, "2 2"]:
    """Return the (least, greatest) ground speeds (right, left), m/s, that the wheels can be asked
    for under every slip that is compensated."""
    robot = problem.robot
    least_slip, greatest_slip = compensated_slips(problem.scenario.slip)
    most_grip = 1 - least_slip
    least_grip = 1 - greatest_slip
    slowest = np.maximum(most_grip * robot.wheel_speed_min, least_grip * robot.wheel_speed_min)
    return np.stack([slowest, least_grip * robot.wheel_speed_max])


def complete_problem(scenario: Scenario) -> Problem:
    """Build the problem of a scenario, the error of an estimate bounded, and W computed for the
    robot itself and rows that keep the acceleration of the wheels where the scenario asks for them.

    Raises:
        ScenarioError: as `make_problem`; where the operating set is so wide that angles leave a
            quarter turn, or W is flat; where the error of the estimate has no bound, or leaves too
            little of the constraints; where the wheels must accelerate by more than their limit.
    """
    problem = make_problem(scenario)
    if scenario.controller.has_observer:
        problem = _with_estimate_error(problem)
    if scenario.disturbance.bound == "computed":
        problem = with_computed_bounds(problem)
    if scenario.slip.is_learnt:
        problem = _with_learnt_slips(problem)
    if scenario.robot.wheel_acceleration_max_mps2 is None:
        return problem
    return limit_acceleration(problem, operation(problem), kinematics(problem))


def _with_learnt_slips(problem: Problem) -> Problem:
    """Return the problem with a regime for each of the first periods, in which less is known of the
    slips than later."""
    is_computed = problem.scenario.disturbance.bound == "computed"
    ages = range(count_learnt_periods(problem.scenario))
    younger = [replace(problem, periods_learnt=age) for age in ages]
    if is_computed:
        younger = [with_computed_bound(regime) for regime in younger]
    return with_regimes(problem, [*younger, problem], RegimesByAge(len(younger) + 1))


def _with_estimate_error(problem: Problem) -> Problem:
    """Return the problem with S, the bound of the estimate's error, and with caps that leave room
    for it.

    S is that of all errors which the noise leaves of the constraints where no cap is given, hence
    of narrower ones.
    """
    scenario = problem.scenario
    try:
        question = pickle.dumps((operation(problem), kinematics(problem)))
        size = pickle.loads(_answer_estimate_error(question))
    except ValueError as error:
        raise ScenarioError(
            f"scenario: controller.observer_gain = {list(scenario.controller.observer_gain)}: "
            f"{error}; narrow [operating], or raise it"
        ) from None
    _refuse_wide_estimate(scenario, size)
    left = error_vector(scenario.constraints) - size
    caps = np.minimum(problem.operating_set.offsets[:3], left)
    return replace(
        problem,
        operating_set=Polytope.box(-caps, caps),
        error_set=Polytope.box(-caps - size, caps + size),
        estimate_error=size,
    )


def _refuse_wide_estimate(scenario: Scenario, size: Float[np.ndarray, "3"]) -> None:
    """Refuse an estimate whose error, (m, m, rad), takes more of the constraints than the caps
    leave."""
    limits = error_vector(scenario.constraints) * TO_DISPLAY
    shown = size * TO_DISPLAY
    for name, limit, error in zip(KEYS, limits.tolist(), shown.tolist(), strict=True):
        cap = getattr(scenario.operating, name)
        if error >= limit or (cap or 0.0) > (limit - error) * (1 + CAP_ROUNDING):
            wanted = "" if cap is None else f", less than operating.{name} = {cap:g}"
            raise ScenarioError(
                f"scenario: controller.observer_gain = {list(scenario.controller.observer_gain)}: "
                f"the estimate may be wrong by {error:.4g}, which leaves {limit - error:.4g} of "
                f"constraints.{name} = {limit:g}{wanted}; raise the gain, or lower the cap"
            )


def with_computed_bounds(problem: Problem) -> Problem:
    """Return the problem with W computed for the robot itself, by speed where it has bands; raises
    as `with_computed_bound`."""
    bands = problem.scenario.operating.bands
    if not bands:
        return with_computed_bound(problem)
    if any(band.list_missing() for band in bands):
        raise ScenarioError(
            "scenario: operating.bands: have no caps and gains; give them, or let "
            "`design --optimise` find them"
        )
    return join_bands(problem, [with_computed_bound(band) for band in split_bands(problem)])


def with_computed_bound(problem: Problem) -> Problem:
    """Return the problem with W computed for the robot itself, over all that is certified.

    Raises:
        ScenarioError: where the operating set is so wide that angles leave a quarter turn, or W is
            flat.
    """
    try:
        bound = prove_bound(problem)
    except ValueError as error:
        raise ScenarioError(
            f'scenario: disturbance.bound = "computed": {error}; narrow [operating]'
        ) from None
    if np.any(bound.support(np.eye(3)) < FLAT * error_vector(problem.scenario.constraints)):
        raise ScenarioError(
            'scenario: disturbance.bound = "computed": without slip error and noise W is flat; '
            "give slip.relative_error, slip intervals or the three numbers of [noise]"
        )
    return replace(problem, disturbance_bound=bound, disturbance_set=bound.polytope())


def _box_ends(polytope: Polytope) -> Float[np.ndarray, "2 n"]:
    """Return the ends of the box around a set, the lower ones first."""
    identity = np.eye(polytope.dimension)
    return np.stack([-polytope.support(-identity), polytope.support(identity)])
