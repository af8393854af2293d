"""From a scenario to the data of a control problem: reference, model, weights, and the sets E, U
and W.

    E: |e_x|, |e_y|, |e_th| bounded, for the true error; the controller keeps the measured one, or
        its estimate, in `operating_set`
    U: what the caps or the wheel limits leave of the inputs (`synthesis.limits`)
    W: a box that is assumed, or a bound computed for the slipping robot over all of these
        (`synthesis.disturbance`)

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, section IV.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from jaxtube.paths.reference import follow_file
from jaxtube.plant.model import VERTEX_SIDES, Model, make_model
from jaxtube.plant.recorded_slips import make_recorded
from jaxtube.plant.reference import Reference, jumps, lemniscate, two_circles
from jaxtube.plant.robot import Robot
from jaxtube.scenario.error_box import error_vector, noise_bounds
from jaxtube.scenario.reference_rules import check_reference_wheels
from jaxtube.scenario.refusal import ScenarioError
from jaxtube.scenario.tree import ControllerTable, Scenario, weight_matrix
from jaxtube.synthesis.control_problem import ControlProblem
from jaxtube.synthesis.limits import (
    FirstCommand,
    InputRows,
    input_constraints,
    make_input_rows,
    operating_bounds,
)
from jaxtube.synthesis.regimes import RegimeRule
from sets.polytope import Polytope
from sets.robot.disturbance import DisturbanceBound

MOST_SPEED_PAIRS = 64
"""Pairs of wheel speeds along a path that are certified one by one: each is a loop of every set."""
SAME_SPEED_DECIMALS = 12
"""Wheel speeds that agree to so many decimals, m/s, are one: they differ by rounding."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Problem(ControlProblem):
    """What a design starts from: the scenario as arrays in SI units and radians.

    `regions` are boxes of wheel speeds, lower and upper (right, left) in m/s, over whose union sets
    and certificate hold under arbitrary changes: the box of the reference, or the points that occur
    on its path. `disturbance_bound` is what W was computed from, None where W is assumed.
    `estimate_error` bounds the error of what the controller acts on, half widths (m, m, rad): the
    noise, or S of the estimate (`synthesis.disturbance: complete_problem`). `first_command`
    bounds the first command where `input_rows` keep the acceleration of the wheels, else it is
    None.

    `regimes` are the problems that would be, did all periods belong to one regime; none where they
    do. `rule` numbers them along a run. `disturbance_set` then holds the W of each.
    `periods_learnt` says for how many periods slips that are learnt on line have been learnt, None
    for as many as it takes (`synthesis.learnt_slips`).
    """

    scenario: Scenario
    robot: Robot
    reference: Reference
    model: Model
    regions: Float[np.ndarray, "m 2 2"]
    estimate_error: Float[np.ndarray, "3"]
    disturbance_bound: DisturbanceBound | None = None
    first_command: FirstCommand | None = None
    periods_learnt: int | None = None

    @property
    def period_regimes(self) -> Int[np.ndarray, " periods"]:
        """The regime of every period, preview included."""
        return self.rule.number(merge_equal_speeds(self.schedule))

    @property
    def ground_speeds(self) -> Float[np.ndarray, "2 2"] | None:
        """The ground speeds that may be commanded, (lower, upper) by (right, left), m/s; None where
        W is assumed."""
        if not self.has_computed_bound:
            return None
        bounds = [regime.disturbance_bound for regime in self.every_regime]
        speeds = np.stack([bound.ground_speeds for bound in bounds if bound is not None])
        return np.stack([speeds[:, 0].min(axis=0), speeds[:, 1].max(axis=0)])

    @property
    def has_computed_bound(self) -> bool:
        """Whether every W was computed."""
        return all(regime.disturbance_bound is not None for regime in self.every_regime)

    @property
    def settings(self) -> ControllerTable:
        """How the controller is designed."""
        return self.scenario.controller

    @property
    def schedule(self) -> Float[np.ndarray, "periods 2"]:
        """Reference wheel speeds (right, left) of every period, preview included, m/s."""
        return self.reference.wheels

    @property
    def noise(self) -> Float[np.ndarray, "3"]:
        """Half widths of the error of the measured pose in the robot's frame (m, m, rad)."""
        return noise_bounds(self.scenario)

    @property
    def cap_rows(self) -> InputRows:
        """The input rows that are caps: those of U and of the coupling."""
        if self.first_command is None:
            return self.input_rows
        return make_input_rows(self.scenario, self.input_set)

    @property
    def given_gains(self) -> Float[np.ndarray, " kappa"]:
        """The numbers of the gains that the scenario gives, none where they come from the terminal
        cost's LMI; of bands three each, one after the other."""
        bands = self.scenario.operating.bands
        if bands:
            return np.ravel([band.tracking_gains for band in bands])
        settings = self.scenario.controller
        return np.ravel(np.array(settings.tracking_gains or settings.vertex_gains, float))

    @property
    def corners(self) -> Float[np.ndarray, "4m 2"]:
        """Schedules at the corners of the regions, m/s; repeated where a region is a point."""
        return region_corners(self.regions)


def region_corners(regions: Float[np.ndarray, "... 2 2"]) -> Float[np.ndarray, "k 2"]:
    """Return the four corners of every region, in the order of `VERTEX_SIDES`."""
    return regions[..., VERTEX_SIDES, [0, 1]].reshape(-1, 2)


def make_problem(scenario: Scenario) -> Problem:
    """Build the problem of a scenario, with the disturbance set it assumes and, for the error of
    what the controller acts on, the noise (`synthesis.disturbance` computes both).

    Raises:
        ScenarioError: one line, where the reference leaves its box, the wheel limits leave no
            input, or recorded slips cannot be used.
    """
    if scenario.slip.process == "recorded":
        make_recorded(scenario)
    settings = scenario.controller
    robot = Robot(
        scenario.robot.turning_track_m,
        scenario.robot.wheel_speed_min_mps,
        scenario.robot.wheel_speed_max_mps,
        scenario.robot.lever_arm_m,
    )
    reference = _make_reference(scenario)
    check_reference_wheels(scenario, float(reference.wheels.min()), float(reference.wheels.max()))
    box = _speed_box(scenario, reference)
    slip = np.array(scenario.slip.nominal)
    model = make_model(
        settings.model,
        settings.discretisation,
        settings.dt_s,
        robot.track_width,
        slip,
        (box[0], box[1]),
    )
    operating = operating_bounds(scenario)
    noise = noise_bounds(scenario)
    disturbance = error_vector(scenario.disturbance)
    input_set, input_rows = input_constraints(scenario, robot)
    return Problem(
        scenario=scenario,
        robot=robot,
        reference=reference,
        model=model,
        horizon=settings.horizon,
        error_weight=weight_matrix(settings.error_weight),
        input_weight=weight_matrix(settings.input_weight),
        error_set=Polytope.box(-operating - noise, operating + noise),
        operating_set=Polytope.box(-operating, operating),
        input_set=input_set,
        input_rows=input_rows,
        disturbance_set=Polytope.box(-disturbance, disturbance),
        initial_error=_initial_error(scenario),
        regions=_make_regions(scenario, reference, box),
        estimate_error=noise,
    )


def with_regimes(problem: Problem, regimes: Sequence[Problem], rule: RegimeRule) -> Problem:
    """Return the problem with several regimes, numbered by the rule in the order given."""
    several = replace(problem, regimes=tuple(regimes), rule=rule)
    return replace(several, disturbance_set=several.disturbances.hull())


def with_controller(problem: Problem, scenario: Scenario) -> Problem:
    """Return the problem with weights and gains of a scenario that has the same sets, model and
    reference."""
    settings = scenario.controller
    return replace(
        problem,
        scenario=scenario,
        error_weight=weight_matrix(settings.error_weight),
        input_weight=weight_matrix(settings.input_weight),
    )


def merge_equal_speeds(wheels: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Return wheel speeds in which those that differ by rounding are one: the first of them, not
    rounded."""
    rounded = wheels.round(SAME_SPEED_DECIMALS).ravel()
    _, first, which = np.unique(rounded, return_index=True, return_inverse=True)
    return wheels.ravel()[first][which].reshape(wheels.shape)


def _speed_box(scenario: Scenario, reference: Reference) -> Float[np.ndarray, "2 2"]:
    """Return the least and the greatest reference wheel speeds, each (right, left), m/s.

    A path on the edge of the scenario's box may leave it by rounding; the box returned holds it.
    """
    section = scenario.reference
    lower = min(section.wheel_speed_min_mps, float(reference.wheels.min()))
    upper = max(section.wheel_speed_max_mps, float(reference.wheels.max()))
    return np.array([[lower, lower], [upper, upper]])


def _make_regions(
    scenario: Scenario, reference: Reference, box: Float[np.ndarray, "2 2"]
) -> Float[np.ndarray, "m 2 2"]:
    if scenario.reference.certified_for == "box":
        return box[None]
    pairs = np.unique(merge_equal_speeds(reference.wheels), axis=0)
    if len(pairs) > MOST_SPEED_PAIRS:
        raise ScenarioError(
            f'scenario: reference.certified_for = "path": the path has {len(pairs)} different '
            f"pairs of wheel speeds, more than {MOST_SPEED_PAIRS}; set reference.certified_for = "
            '"box"'
        )
    return np.stack([pairs, pairs], axis=1)


def _make_reference(scenario: Scenario) -> Reference:
    section = scenario.reference
    settings = scenario.controller
    preview = settings.horizon + 1
    track_width = scenario.robot.turning_track_m
    try:
        if section.shape == "file":
            return follow_file(scenario)
        assert section.duration_s is not None  # which only a recording leaves open
        if section.shape == "jumps":
            return jumps(
                section.wheel_speed_min_mps,
                section.wheel_speed_max_mps,
                section.duration_s,
                settings.dt_s,
                preview,
                track_width,
                section.jump_seed,
            )
        shape = {"two_circles": two_circles, "lemniscate": lemniscate}[section.shape]
        return shape(
            section.radius_m,
            section.speed_mps,
            section.duration_s,
            settings.dt_s,
            preview,
            track_width,
        )
    except ValueError as error:
        raise ScenarioError(f"scenario: {error}") from None


def _initial_error(scenario: Scenario) -> Float[np.ndarray, "3"]:
    """Return the tracking error of the start, eq. (3), the reference being at the origin of its own
    frame; the heading error is in (-180, 180] degrees."""
    start = scenario.initial
    heading = np.deg2rad(start.heading_deg)
    turn = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
    heading_error = -math.remainder(start.heading_deg, 360.0)
    if heading_error == -180.0:
        heading_error = 180.0
    return np.append(turn @ [-start.x_m, -start.y_m], np.deg2rad(heading_error))
