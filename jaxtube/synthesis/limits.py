"""Limits on errors and inputs: E from the caps, and U from the caps or from the wheel limits.

    U: caps on u1, u2, or a parallelogram in p = u1 + (b/2) u2, q = u1 - (b/2) u2, per wheel
       V - (1 - i) v_max <= p, q <= V - (1 - i) v_min
       for every reference speed V and slip i it may meet

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, eqs. (7)-(8), (11).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from jaxtube.plant.robot import Robot
from jaxtube.plant.slip_bounds import compensated_slips
from jaxtube.scenario.error_box import error_vector, noise_bounds
from jaxtube.scenario.refusal import ScenarioError
from jaxtube.scenario.tree import Scenario
from sets.polytope import Polytope


@dataclass(frozen=True, eq=False)
class InputRows:
    """Constraints  inputs u + errors e <= offsets  of one period; the second half of the rows is
    minus the first.

    The rows of U, where e does not count, with a coupling |e_x| / a + |u2| / b <= 1 its four, and
    with a limit on the acceleration of the wheels those that keep it (`synthesis.acceleration`).
    Those of several periods may be stacked (`Problem.rows_of`).
    """

    inputs: Float[np.ndarray, "*stack k 2"]
    errors: Float[np.ndarray, "*stack k 3"]
    offsets: Float[np.ndarray, "*stack k"]

    @property
    def is_coupled(self) -> Bool[np.ndarray, " k"]:
        """Which rows bound inputs and error together."""
        return np.any(self.errors != 0, axis=1)

    def on_errors(self, gains: Float[np.ndarray, "... 2 3"]) -> Float[np.ndarray, "... k 3"]:
        """Return the rows on the error under u = K e."""
        return self.inputs @ gains + self.errors

    def with_pairs(self, pairs: InputRows) -> InputRows:
        """Return these rows and further ones, each of which stands for its opposite, too."""
        half = len(self.offsets) // 2
        first = (self.inputs[:half], pairs.inputs, self.inputs[half:], -pairs.inputs)
        errors = (self.errors[:half], pairs.errors, self.errors[half:], -pairs.errors)
        offsets = (self.offsets[:half], pairs.offsets, self.offsets[half:], pairs.offsets)
        return InputRows(*(np.concatenate(parts) for parts in (first, errors, offsets)))

    @classmethod
    def from_set(cls, input_set: Polytope) -> InputRows:
        """Return the rows of a set of inputs."""
        count = len(input_set.offsets)
        return cls(input_set.normals, np.zeros((count, 3)), input_set.offsets)


@dataclass(frozen=True, eq=False)
class FirstCommand:
    """What bounds how far the first command is from the speed at which the reference begins: over
    ground |m u| <= kept + |feedback e| for both m of `synthesis.acceleration`, and the input map.

    Attributes:
        feedback: rows m K.
        kept: m/s.
        map_slopes: what the input map adds by the size of each error.
        mapped: what it adds besides, m/s.
        most: that a command may change by, m/s over ground.
    """

    feedback: Float[np.ndarray, "2 3"]
    kept: Float[np.ndarray, "2"]
    map_slopes: Float[np.ndarray, "3"]
    mapped: float
    most: float

    def use(self, errors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Return what share of `most` the first command may take from measured errors: convex."""
        of_law = np.max(np.abs(errors @ self.feedback.T) + self.kept, axis=1)
        return (of_law + np.abs(errors) @ self.map_slopes + self.mapped) / self.most

    def shrink(self, errors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Return errors as far out as they are and keep the limit."""
        at_origin = self.use(np.zeros((1, 3)))
        if at_origin[0] >= 1:
            return 0 * errors
        # Along a ray the bound is convex, so this share of the way is enough.
        share = np.minimum((1 - at_origin) / np.maximum(self.use(errors) - at_origin, 1e-300), 1)
        return share[:, None] * errors


def wheel_rows(track_width: float) -> Float[np.ndarray, "2 2"]:
    """Return the matrix that takes (u1, u2) to (p, q), the deficits of the right and the left
    wheel, m/s."""
    return np.array([[1.0, track_width / 2], [1.0, -track_width / 2]])


def find_command_step(scenario: Scenario) -> float | None:
    """Return by how much a wheel's command may change from one period to the next, m/s; None for
    any."""
    most = scenario.robot.wheel_acceleration_max_mps2
    return None if most is None else most * scenario.controller.dt_s


def wheel_deficit_bounds(
    robot: Robot,
    slowest: float,
    fastest: float,
    slip_range: tuple[float, float],
    heading_range: float = 0.0,
) -> tuple[float, float]:
    """Return (least, greatest) p that the wheel limits allow for every reference speed and slip in
    the ranges.

    Args:
        robot: the limits.
        slowest, fastest: reference wheel speeds, m/s; equal ones follow a known reference.
        slip_range: least and greatest slip.
        heading_range: bound of the heading error, rad, where the input map is cosine-free and adds
            V (cos e_th - 1).
    """
    lost = fastest * (1 - np.cos(heading_range))
    grips = [1 - slip for slip in slip_range]
    least = fastest - min(grip * robot.wheel_speed_max for grip in grips)
    greatest = slowest - lost - max(grip * robot.wheel_speed_min for grip in grips)
    return float(least), float(greatest)


def operating_bounds(scenario: Scenario) -> Float[np.ndarray, "3"]:
    """Return half widths of the measured error: the caps, where none is given what the noise leaves
    of E."""
    left = error_vector(scenario.constraints) - noise_bounds(scenario)
    operating = scenario.operating
    caps = left.copy()
    if operating.longitudinal_m is not None:
        caps[0] = operating.longitudinal_m
    if operating.lateral_m is not None:
        caps[1] = operating.lateral_m
    if operating.heading_deg is not None:
        caps[2] = np.deg2rad(operating.heading_deg)
    return np.minimum(caps, left)


def input_constraints(scenario: Scenario, robot: Robot) -> tuple[Polytope, InputRows]:
    """Return U, and the rows on input and error that are U and the coupling."""
    input_set = _make_input_set(scenario, robot)
    return input_set, make_input_rows(scenario, input_set)


def _make_input_set(scenario: Scenario, robot: Robot) -> Polytope:
    """Return U: the caps on u1 and u2 where they are given, else what the wheel limits allow of p
    and q."""
    operating = scenario.operating
    if operating.yaw_rate_deficit_radps is None:
        return _wheel_limited_inputs(robot, _wheel_deficits(scenario, robot))
    assert operating.speed_deficit_min_mps is not None
    assert operating.speed_deficit_max_mps is not None
    turning = operating.yaw_rate_deficit_radps
    return Polytope.box(
        np.array([operating.speed_deficit_min_mps, -turning]),
        np.array([operating.speed_deficit_max_mps, turning]),
    )


def _wheel_limited_inputs(robot: Robot, bounds: Float[np.ndarray, "2 2"]) -> Polytope:
    """Return U from [[p_min, p_max], [q_min, q_max]]: rows p, q, -p, -q."""
    rows = wheel_rows(robot.track_width)
    return Polytope(np.vstack([rows, -rows]), np.concatenate([bounds[:, 1], -bounds[:, 0]]))


def make_input_rows(scenario: Scenario, input_set: Polytope) -> InputRows:
    """Return the rows of U and of the coupling, each half in the same order."""
    operating = scenario.operating
    rows = InputRows.from_set(input_set)
    if operating.turning_longitudinal_m is None or operating.turning_yaw_rate_radps is None:
        return rows
    turning = np.array([0.0, 1 / operating.turning_yaw_rate_radps])
    along = np.array([1 / operating.turning_longitudinal_m, 0.0, 0.0])
    coupled = InputRows(np.stack([turning, -turning]), np.stack([along, along]), np.ones(2))
    return rows.with_pairs(coupled)


def _wheel_deficits(scenario: Scenario, robot: Robot) -> Float[np.ndarray, "2 2"]:
    """Return [[p_min, p_max], [q_min, q_max]] over the box of reference speeds and every slip, in
    m/s."""
    section = scenario.reference
    heading = _heading_range(scenario)
    bounds = np.array(
        [
            wheel_deficit_bounds(
                robot,
                section.wheel_speed_min_mps,
                section.wheel_speed_max_mps,
                slip_range,
                heading,
            )
            for slip_range in _slip_ranges(scenario)
        ]
    )
    if np.any(bounds[:, 0] >= 0):
        raise _refuse_slow_wheels(scenario)
    if np.any(bounds[:, 1] <= 0):
        raise _refuse_fast_wheels(scenario)
    return bounds


def _heading_range(scenario: Scenario) -> float:
    """Return the bound of the heading error, rad, where the input map is cosine-free, else 0."""
    maps_speed = scenario.controller.input_map != "paper"
    return float(np.deg2rad(scenario.constraints.heading_deg)) if maps_speed else 0.0


def _slip_ranges(scenario: Scenario) -> list[tuple[float, float]]:
    """Return the least and the greatest compensated slip of the right and the left wheel."""
    least, greatest = compensated_slips(scenario.slip)
    return list(zip(least.tolist(), greatest.tolist(), strict=True))


def _refuse_slow_wheels(scenario: Scenario) -> ScenarioError:
    """Return the refusal of wheels that cannot follow the fastest reference, with the speeds from
    which on they can."""
    limit = scenario.robot.wheel_speed_max_mps
    fastest = scenario.reference.wheel_speed_max_mps
    grip = 1 - max(most for _, most in _slip_ranges(scenario))
    slowest_cure = ""
    if limit > 0:
        speed = _round_below(grip * limit)
        slowest_cure = (
            f", or reference.wheel_speed_max_mps <= {speed} with a reference.speed_mps that fits"
        )
    return ScenarioError(
        f"scenario: robot.wheel_speed_max_mps = {limit}: the wheels cannot follow every reference "
        f"speed under the greatest slip, which leaves {grip:.4g} of their speed; the reference "
        f"needs robot.wheel_speed_max_mps >= {_round_above(fastest / grip)}, and more to correct "
        f"errors{slowest_cure}"
    )


def _refuse_fast_wheels(scenario: Scenario) -> ScenarioError:
    """Return the refusal of wheels that cannot follow the slowest reference, with the speeds from
    which on they can."""
    limit = scenario.robot.wheel_speed_min_mps
    section = scenario.reference
    lost = section.wheel_speed_max_mps * (1 - np.cos(_heading_range(scenario)))
    room = section.wheel_speed_min_mps - lost
    grips = [1 - slip for ends in _slip_ranges(scenario) for slip in ends]
    # The limit counts as the fastest that it may drive the robot.
    at_limit = max(grip * limit for grip in grips)
    wanted = min(room / grip for grip in grips)
    return ScenarioError(
        f"scenario: robot.wheel_speed_min_mps = {limit}: the wheels cannot turn as slowly as the "
        "reference under the least slip; the reference needs robot.wheel_speed_min_mps <= "
        f"{_round_below(wanted)}, and less to correct errors, or reference.wheel_speed_min_mps >= "
        f"{_round_above(at_limit + lost)}"
    )


def _round_above(value: float) -> float:
    """Return a number of four significant digits above a value."""
    unit = _last_digit(value)
    return float(f"{unit * (np.floor(value / unit) + 1):.12g}")


def _round_below(value: float) -> float:
    """Return a number of four significant digits below a value."""
    return -_round_above(-value)


def _last_digit(value: float) -> float:
    """Return the unit of the fourth significant digit."""
    return float(10.0 ** (np.floor(np.log10(max(abs(value), 1e-3))) - 3))
