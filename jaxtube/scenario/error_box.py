"""Half widths of boxes of tracking errors, from the tables of a scenario that give them.

Source: new.
"""

import numpy as np
from jaxtyping import Float

from jaxtube.scenario.tree import Constraints, DisturbanceTable, Noise, Scenario


def error_vector(section: Constraints | DisturbanceTable | Noise) -> Float[np.ndarray, "3"]:
    """Return (m, m, rad) of a scenario section with longitudinal_m, lateral_m and heading_deg."""
    return np.array([section.longitudinal_m, section.lateral_m, np.deg2rad(section.heading_deg)])


def noise_bounds(scenario: Scenario) -> Float[np.ndarray, "3"]:
    """Return half widths of the error of the measured tracking error, (m, m, rad).

    Of wheels that lag, or commands that come late, that is the error of the committed pose.
    """
    noise = bound_pose_noise(scenario)
    return noise if scenario.robot.obeys_at_once else _commit(scenario, noise)


def _commit(scenario: Scenario, noise: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Return half widths of what noise of the pose makes of the committed one."""
    # Only scenarios of such robots need `sets` so early.
    from sets.robot.actuation import Actuation
    from sets.robot.latency import bound_committed_noise

    robot = scenario.robot
    section = scenario.reference
    nominal = Actuation(robot.wheel_lag_s, robot.command_delay_s).nominal(scenario.controller.dt_s)
    deficit = scenario.operating.yaw_rate_deficit_radps
    span = section.wheel_speed_max_mps - section.wheel_speed_min_mps
    yaw_rate = np.inf if deficit is None else deficit + span / robot.turning_track_m
    fastest = max(abs(section.wheel_speed_max_mps), abs(section.wheel_speed_min_mps))
    return bound_committed_noise(noise, nominal.latency, fastest, yaw_rate)


def bound_pose_noise(scenario: Scenario) -> Float[np.ndarray, "3"]:
    """Return half widths of the noise of a measured pose in the robot's frame, (m, m, rad).

    Noise (n_p, n_phi) of the pose in the world makes Rot(-n_phi) (e - Rot(-phi) n_p) of the
    position part of the error e, which lies in E: |n_p| in any direction, and e turned by n_phi.
    """
    noise = error_vector(scenario.noise)
    if scenario.noise.frame == "robot":
        return noise
    reach = np.hypot(noise[0], noise[1])
    longitudinal, lateral, _ = error_vector(scenario.constraints)
    shrunk = 1 - np.cos(noise[2])
    turned = np.sin(noise[2])
    return np.array(
        [
            reach + shrunk * longitudinal + turned * lateral,
            reach + turned * longitudinal + shrunk * lateral,
            noise[2],
        ]
    )
