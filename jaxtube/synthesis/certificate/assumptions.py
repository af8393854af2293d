"""What a guarantee takes for granted, in words."""

from __future__ import annotations

import numpy as np

from jaxtube.coordinates import describe_excursion
from jaxtube.scenario.tree import Slip
from jaxtube.synthesis.acceleration import find_reference_steps
from jaxtube.synthesis.disturbance import bound_error_between_periods, find_actuation
from jaxtube.synthesis.problem import Problem


def assumptions(problem: Problem, any_order: bool, has_proved_w: bool = False) -> tuple[str, ...]:
    """Return what the guarantee takes for granted, in words.

    Args:
        problem: of the design.
        any_order: whether the reference may take the certified wheel speeds in any order.
        has_proved_w: whether W is proved to hold every disturbance, so that nothing is assumed of
            it.
    """
    return (
        _assume_slip(problem),
        _assume_measurement(problem),
        _assume_reference(problem, any_order),
        _assume_period(problem),
        _assume_instants(problem),
        _assume_start(problem, has_proved_w),
    )


def _assume_slip(problem: Problem) -> str:
    slip = problem.scenario.slip
    if slip.has_intervals:
        return _assume_slip_intervals(slip)
    right, left = slip.nominal
    within = (
        f"within {slip.relative_error:.0%} of its constant nominal value "
        f"({right:g} right, {left:g} left), in any sequence"
    )
    nothing = ""
    if slip.relative_error > 0 and 0 in slip.nominal:
        nothing = "; of a nominal slip of 0 that is no error at all"
    if slip.random == "both":
        return f"true and, on its own, measured slip {within}{nothing}"
    if not problem.scenario.robot.obeys_at_once:
        # Commands that act together compensate one slip if it is the true one that varies, and
        # different ones if it is the measured one: one proof is not that of the other.
        other = (
            "the nominal one is compensated" if slip.random == "true" else "the true one nominal"
        )
        return f"{slip.random} slip {within}; {other}{nothing}"
    return f"true or measured slip {within}; the other one nominal{nothing}"


def _assume_slip_intervals(slip: Slip) -> str:
    if slip.is_learnt:
        return (
            f"true slip anywhere in {slip.say_intervals()}, of either wheel changing by at most "
            f"{slip.change_per_s:g} a second from one period to the next; learnt on line from "
            "measured errors and from the wheel speeds, which are known"
        )
    anywhere = f"true slip anywhere in {slip.say_intervals()}, in any sequence"
    if slip.is_measured:
        return f"{anywhere}; measured within {slip.say_measurement_error()} of it"
    right, left = slip.nominal
    return f"{anywhere}; not measured: {right:g} right, {left:g} left are compensated"


def _assume_measurement(problem: Problem) -> str:
    measured = _assume_noise(problem)
    if not problem.scenario.controller.has_observer:
        return measured
    shares = ", ".join(f"{share:g}" for share in problem.scenario.controller.observer_gain)
    return (
        f"{measured}; the controller acts on an estimate, at first what is measured, that takes "
        f"over {shares} of what measurements differ from the motion under the slip compensated"
    )


def _assume_noise(problem: Problem) -> str:
    noise = problem.scenario.noise
    if not problem.noise.any():
        return "tracking error measured exactly, without delay"
    if noise.frame == "world":
        return (
            f"pose measured within {noise.longitudinal_m:g} m, {noise.lateral_m:g} m, "
            f"{noise.heading_deg:g} deg in the world's frame, without delay"
        )
    return (
        f"tracking error measured within {noise.longitudinal_m:g} m, {noise.lateral_m:g} m, "
        f"{noise.heading_deg:g} deg in the robot's frame, not the world's, without delay"
    )


def _assume_instants(problem: Problem) -> str:
    """Return when the promise holds, in words."""
    if problem.scenario.robot.obeys_at_once:
        when = f"at the ends of periods, {_say_between(problem)}"
    else:
        latency = find_actuation(problem.scenario).nominal(problem.model.dt).latency
        when = (
            "at the ends of periods for the error of the committed pose, to which the commands "
            f"given will take the robot, and for that of the pose itself, then and {latency:.3g} s "
            "later, against where the reference was or is by then as late; nothing in between"
        )
    return f"what is promised holds {when}; controllers in 64 bits"


def _say_between(problem: Problem) -> str:
    """Return what holds between the ends of periods, in words."""
    try:
        excursions = [bound_error_between_periods(regime) for regime in problem.every_regime]
    except ValueError:
        return "nothing between them"
    by = describe_excursion(np.max(excursions, axis=0))
    return f"and the true error leaves the limits that it has there {by} in between"


def _assume_period(problem: Problem) -> str:
    at_once = problem.scenario.robot.obeys_at_once
    speeds = "wheel speeds" if at_once else "commands"
    wheels = "wheels obey at once" if at_once else _say_actuation(problem)
    constant = f"slip, {speeds} and reference constant over each period; {wheels}"
    slip = problem.scenario.slip
    robot = problem.scenario.robot
    sideways = []
    if slip.sideslip:
        sideways.append(f"up to {slip.sideslip:g} times the forward speed")
    if robot.lever_arm_m:
        sideways.append(f"{-robot.lever_arm_m:g} m times the yaw rate")
    if not sideways:
        return f"{constant}; no sideways slip"
    return f"{constant}; the body slips sideways by {' plus '.join(sideways)}"


def _say_actuation(problem: Problem) -> str:
    """Return what is assumed of wheels that do not obey at once, in words."""
    robot = problem.scenario.robot
    nominal = find_actuation(problem.scenario).nominal(problem.model.dt)
    parts = []
    if robot.wheel_lag_s[1] > 0:
        lag = _say_times(robot.wheel_lag_s)
        parts.append(
            f"both wheels lag by the same constant time of {lag}, linearly, without limits"
        )
    if robot.command_delay_s[1] > 0:
        parts.append(f"each command arrives {_say_times(robot.command_delay_s)} late")
    return (
        f"{'; '.join(parts)}; before the start the wheels run as the reference begins, under "
        f"nominal slip; the robot follows the reference {nominal.latency:.3g} s late"
    )


def _say_times(interval: tuple[float, float]) -> str:
    low, high = interval
    return f"{low:g} s" if low == high else f"{low:g} to {high:g} s"


def _assume_reference(problem: Problem, any_order: bool) -> str:
    low, high = problem.model.box
    order = ", in any order" if any_order else ", in the order of this path alone"
    if problem.scenario.reference.certified_for == "box":
        speeds = f"wheel speeds between {low[0]:g} and {high[0]:g} m/s{order}"
    else:
        speeds = f"the {len(problem.regions)} pairs of wheel speeds of the path{order}"
    if problem.scenario.robot.wheel_acceleration_max_mps2 is not None:
        steps = " and ".join(f"{step:.4g}" for step in find_reference_steps(problem))
        speeds += f", changing by at most {steps} m/s (right, left) from one period to the next"
    return f"reference of {speeds}, known {problem.horizon} periods of {problem.model.dt:g} s ahead"


def _assume_start(problem: Problem, has_proved_w: bool) -> str:
    start = "the first measured error lies within its caps and has a plan"
    if problem.scenario.robot.wheel_acceleration_max_mps2 is not None:
        start += (
            "; the wheels' acceleration is promised from the second command on"
            if problem.scenario.robot.obeys_at_once
            else ", whose first command keeps the wheels' acceleration from where the reference "
            "begins"
        )
    if problem.scenario.disturbance.bound == "assumed" and not has_proved_w:
        return f"{start}, and no disturbance leaves W"
    return start
