"""What a certificate says of the robot itself: its true errors, its disturbances, its wheels, and
what is assumed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from jaxtube.coordinates import COORDINATES
from jaxtube.synthesis.certificate.acceleration import check_acceleration
from jaxtube.synthesis.certificate.between import check_between_periods
from jaxtube.synthesis.certificate.learning import check_learnt_slips
from jaxtube.synthesis.certificate.noise import changes_noise, find_noise
from jaxtube.synthesis.certificate.period import (
    extreme_cases,
    find_disturbances,
    find_estimate_errors,
    find_wheel_commands,
    noise_reach,
)
from jaxtube.synthesis.certificate.true_error import check_true_error
from jaxtube.synthesis.disturbance import (
    ground_speed_limits,
    prove_bound,
    prove_next_error,
)
from jaxtube.synthesis.problem import Problem
from sets.certificate import ROUNDING, Condition, judge
from sets.robot.disturbance import DisturbanceBound

PREMISE = "disturbance_bound_proved"
"""The condition that makes a guarantee for the linear model one for the robot."""


def check_robot(problem: Problem) -> Iterator[Condition]:
    """Yield the conditions that make a guarantee for the linear model one for the robot: of several
    regimes the one with the least room in each."""
    if not problem.regimes:
        yield from _check_regime(problem)
        return
    checked = [_check_regime(regime) for regime in problem.regimes]
    by_regime = [{condition.name: condition for condition in each} for each in checked]
    for name in by_regime[0]:
        # What is for information alone may be without a bound in some regimes.
        if not all(name in each for each in by_regime):
            continue
        conditions = [each[name] for each in by_regime]
        tightest = min(range(len(conditions)), key=lambda number: conditions[number].margin)
        condition = conditions[tightest]
        of_which = f"Of {len(conditions)} regimes number {tightest + 1} has the least room."
        yield replace(condition, sentence=f"{condition.sentence} {of_which}")
    if problem.scenario.slip.is_learnt:
        yield check_learnt_slips(problem)


def _check_regime(problem: Problem) -> Iterator[Condition]:
    """Yield the conditions on the robot in one regime."""
    yield check_true_error(problem)
    yield from check_between_periods(problem)
    if problem.scenario.controller.has_observer:
        yield check_estimate_error(problem)
    yield check_disturbance_set(problem)
    if not _is_limited_by_wheels(problem):
        yield _check_wheels(problem)
    if problem.scenario.robot.wheel_acceleration_max_mps2 is not None:
        yield check_acceleration(problem)


def check_estimate_error(problem: Problem) -> Condition:
    """Check that the error of the estimate stays in its set S: an error that is possible from
    within S can refute it, a bound on all of them can prove it."""
    size = problem.estimate_error
    met = np.abs(find_estimate_errors(problem)).max(axis=0) + noise_reach(problem, np.eye(3))
    try:
        proved = prove_next_error(problem)
    except ValueError:
        proved = np.full(3, np.inf)
    # The first estimate is a measurement.
    room = size - np.maximum(np.maximum(met, proved), problem.noise)
    worst = int(np.argmin(room))
    shown = ", ".join(COORDINATES[i].say(width) for i, width in enumerate(size))
    return judge(
        "estimate_error_invariant",
        float(room[worst]),
        f"The estimate that the controller acts on is never off by more than {shown}: from within, "
        "every slip, sideslip and noise leaves it there, proved by interval arithmetic, and the "
        f"first one is a measurement; errors found reach {np.max(met / size):.1%} of that.",
        f"The {COORDINATES[worst].name} error of the estimate may leave its set S = ({shown}).",
        "robot",
    )


def check_disturbance_set(problem: Problem) -> Condition:
    """Check that W, computed or assumed, holds every disturbance of the robot: one that is possible
    within the certified errors and inputs can refute it, or noise beyond what it counts on; a bound
    on them can prove it."""
    return (
        _refute_noise(problem)
        or _refute_disturbance_set(problem)
        or _prove_disturbance_set(problem)
    )


def _refute_noise(problem: Problem) -> Condition | None:
    """Return that W counts on less noise of the measured error than that of the pose may make."""
    if not changes_noise(problem):
        return None
    found = find_noise(problem)
    room = problem.noise - found
    worst = int(np.argmin(room))
    if room[worst] + ROUNDING >= 0:
        return None
    shown = COORDINATES[worst]
    late = "" if problem.scenario.robot.obeys_at_once else " of the committed pose"
    sentence = (
        f"The noise that W counts on is refuted: the measured {shown.name} error{late} may be off "
        f"by {shown.say(found[worst])}, where {shown.say(problem.noise[worst])} is counted on."
    )
    return Condition(PREMISE, float(room[worst]), sentence, "robot")


def _find_bound(problem: Problem) -> DisturbanceBound | None:
    """Return the proved bound on w, worked out anew for what is certified whatever bound the
    problem carries; None where errors and inputs are so wide that angles leave a quarter turn."""
    try:
        return prove_bound(problem)
    except ValueError:
        return None


def _is_limited_by_wheels(problem: Problem) -> bool:
    """Whether U is what the wheel limits leave, so that an input in U never asks for more.

    The wheels of the input map `x_exact` depend on more than U, and a computed W brings the ground
    speeds with it.
    """
    has_caps = problem.scenario.operating.yaw_rate_deficit_radps is not None
    is_direct = problem.scenario.controller.input_map != "x_exact"
    return problem.disturbance_bound is None and is_direct and not has_caps


def _refute_disturbance_set(problem: Problem) -> Condition | None:
    """Return that W is refuted where a disturbance that is possible within the certified errors and
    inputs lies outside.

    W may be computed or assumed; the disturbances come from the exact plant in the world frame.
    """
    W = problem.disturbance_set
    met = find_disturbances(problem)
    # The noise of the next measurement is added to each, where it takes w furthest.
    reach = np.max(met @ W.normals.T, axis=0) + noise_reach(problem, W.normals)
    room = float(np.min(W.offsets - reach))
    if room + ROUNDING >= 0:
        return None
    sentence = f"W is refuted: {_say_what_leaves(problem, met, room)}."
    return Condition(PREMISE, room, sentence, "robot")


def _prove_disturbance_set(problem: Problem) -> Condition:
    """Compare W, computed or assumed, with the bound that interval arithmetic proves."""
    bound = _find_bound(problem)
    if bound is None:
        sentence = (
            "W is the scenario's assumption: errors and inputs are too wide for a bound on w, so "
            "the guarantee is one for the linear model with w in W; narrow [operating]."
        )
        return Condition(PREMISE, -np.inf, sentence, "robot")
    W = problem.disturbance_set
    margin = float(np.min(W.offsets - bound.support(W.normals)))
    shares = _found_shares(bound)
    return judge(
        PREMISE,
        margin + ROUNDING,
        "W holds every disturbance of the slipping robot over everything certified, proved by "
        f"interval arithmetic; disturbances found reach {shares.min():.1%} to {shares.max():.1%} "
        f"of the bound{_say_noise(problem)}.",
        f"W is narrower than the proved bound by {-margin:.3g}, though no disturbance outside it "
        "was found.",
        "robot",
    )


def _say_noise(problem: Problem) -> str:
    """Return what share of the noise that W counts on was found, in words; nothing where it is that
    of the scenario."""
    counted = problem.noise
    noisy = counted > 0
    if not (changes_noise(problem) and noisy.any()):
        return ""
    shares = find_noise(problem)[noisy] / counted[noisy]
    return f", noise {shares.min():.1%} to {shares.max():.1%} of what is counted on"


def _found_shares(bound: DisturbanceBound) -> Float[np.ndarray, " k"]:
    """Return what share of each width of a bound was really found."""
    widths = np.array([bound.yaw, *bound.box])
    found = np.array([bound.found_yaw, *bound.found_box])
    wide = widths > np.finfo(float).tiny
    return np.clip(found[wide] / widths[wide], 0, 1)


def _say_what_leaves(problem: Problem, met: Float[np.ndarray, "n 3"], room: float) -> str:
    """Say which coordinate of w leaves W furthest, by how much and where; a facet if none does."""
    W = problem.disturbance_set
    heights = met @ W.normals.T + noise_reach(problem, W.normals)
    found = np.abs(met).max(axis=0) + noise_reach(problem, np.eye(3))
    allowed = problem.disturbance_set.support(np.eye(3))
    worst = int(np.argmax(found / np.maximum(allowed, np.finfo(float).tiny)))
    if found[worst] <= allowed[worst]:
        facet = int(np.argmin(problem.disturbance_set.offsets - np.max(heights, axis=0)))
        place = _say_place(problem, int(np.argmax(heights[:, facet])))
        return f"a disturbance passes a facet of W by {-room:.3g} {place}"
    place = _say_place(problem, int(np.argmax(np.abs(met[:, worst]))))
    shown = COORDINATES[worst]
    return (
        f"a {shown.name} disturbance of {shown.say(found[worst])}, where W allows "
        f"{shown.say(allowed[worst])}, is possible {place}"
    )


def _say_place(problem: Problem, index: int) -> str:
    """Return one of the cases in which disturbances are looked for, in words."""
    cases = extreme_cases(problem)
    index = index % len(cases.errors)
    error = ", ".join(COORDINATES[i].say(size) for i, size in enumerate(cases.errors[index]))
    speed, turn = cases.inputs[index]
    return (
        "somewhere within everything that the limits allow, where laps need not come, at "
        f"e = ({error}), u = ({speed:.3g} m/s, {turn:.3g} rad/s)"
    )


def _check_wheels(problem: Problem) -> Condition:
    """Check that the wheels can do all that may be asked of them."""
    bound = _find_bound(problem)
    if bound is None:
        sentence = (
            "Errors and inputs are too wide for a bound on the wheel speeds; narrow [operating]."
        )
        return Condition("wheel_limits", -np.inf, sentence, "robot")
    return refute_wheel_limits(problem) or judge_wheel_limits(
        problem,
        bound.ground_speeds,
        "under every slip the wheels have {:.3g} m/s to spare",
        "{:.3g} m/s more than the wheels can do under the greatest slip",
    )


def refute_wheel_limits(problem: Problem) -> Condition | None:
    """Return that the wheels cannot do what the controller may ask of them, where it may."""
    commands = find_wheel_commands(problem)
    robot = problem.robot
    room = min(
        float(np.min(robot.wheel_speed_max - commands)),
        float(np.min(commands - robot.wheel_speed_min)),
    )
    if room + ROUNDING >= 0:
        return None
    sentence = (
        f"Wheel speeds of {commands.min():.3f} to {commands.max():.3f} m/s may be asked for; the "
        f"wheels have {robot.wheel_speed_min:g} to {robot.wheel_speed_max:g} m/s."
    )
    return Condition("wheel_limits", room, sentence, "robot")


def judge_wheel_limits(
    problem: Problem, ground_speeds: Float[np.ndarray, "2 2"], if_spare: str, if_short: str
) -> Condition:
    """Return the condition that the wheels can do the ground speeds that may be asked of them.

    Args:
        problem: with the robot's wheels and their slip.
        ground_speeds: (lower, upper) by (right, left), m/s.
        if_spare: what is said where they can, with the speed to spare in place of `{}`.
        if_short: what is said where they cannot, with the missing speed in place of `{}`.
    """
    least, greatest = ground_speeds
    slowest, fastest = ground_speed_limits(problem)
    room = float(min(np.min(fastest - greatest), np.min(least - slowest)))
    asked = f"Ground speeds of {least.min():.3f} to {greatest.max():.3f} m/s may be asked for"
    return judge(
        "wheel_limits",
        room,
        f"{asked}; {if_spare.format(room)}.",
        f"{asked}: {if_short.format(-room)}.",
        "robot",
    )
