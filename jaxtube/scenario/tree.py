"""The keys of a scenario, their types, bounds and defaults.

Every key carries its unit and every default is the value of the paper's experiment: an empty file
is that experiment. Lengths in metres, speeds in metres a second, angles in degrees; a slip is a
fraction of the wheel speed.

Source: Gonzalez, Fiacchini, Guzman, Alamo 2009, section IV; radius, speed and duration are read off
its figures.
"""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from jaxtyping import Float

from jaxtube.arguments import describe_type
from jaxtube.scenario.refusal import ScenarioError, literal

Positive = Annotated[float, msgspec.Meta(gt=0)]
Negative = Annotated[float, msgspec.Meta(lt=0)]
NonNegative = Annotated[float, msgspec.Meta(ge=0)]
Fraction = Annotated[float, msgspec.Meta(ge=0, lt=1)]
Share = Annotated[float, msgspec.Meta(gt=0, le=1)]
SlipValue = Annotated[float, msgspec.Meta(gt=-1, lt=1)]
HeadingBound = Annotated[float, msgspec.Meta(gt=0, lt=90)]
HeadingSpread = Annotated[float, msgspec.Meta(ge=0, lt=90)]

NOMINAL_SLIP = 0.2
"""Slip of a wheel whose scenario gives none: the paper's."""

DURATION_S = 30.0
"""Duration of a run whose scenario gives none, s: the time axis of the paper's figures."""

Weight = tuple[float | tuple[float, ...], ...]


class Table(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A table of the scenario file."""


class RobotTable(Table, frozen=True):
    """The robot: its wheels, how far they stand apart and how fast they can run.

    A robot that skids as it turns turns as if its wheels stood further apart: by
    `effective_track_m`, which takes the place of the track width in all kinematics. Its body then
    also moves sideways, at -`lever_arm_m` times the yaw rate: the lever arm is how far the point of
    the body that does not move sideways lies ahead of the point that is tracked.

    The wheels follow what they are told with a lag of first order, a time constant anywhere in
    `wheel_lag_s` = [least, greatest] that is the same for both and constant over a run, and each
    command arrives after a delay anywhere in `command_delay_s`. The controller counts on values in
    between and steers the pose to which its commands will take the robot, which the robot itself
    follows by that much later.

    From one period to the next a wheel's command changes by at most `wheel_acceleration_max_mps2`
    times the period, where that is given: the plans keep it, and so does the speed along a path
    that is cleaned. Of the first command nothing is said, except of wheels that lag.
    """

    track_width_m: Positive = 0.5
    effective_track_m: Positive | None = None
    lever_arm_m: float = 0.0
    wheel_lag_s: tuple[NonNegative, NonNegative] = (0.0, 0.0)
    command_delay_s: tuple[NonNegative, NonNegative] = (0.0, 0.0)
    wheel_speed_min_mps: float = -3.0
    wheel_speed_max_mps: float = 3.0
    wheel_acceleration_max_mps2: Positive | None = None

    @property
    def turning_track_m(self) -> float:
        """The track width that turns are computed with, m."""
        return self.track_width_m if self.effective_track_m is None else self.effective_track_m

    @property
    def obeys_at_once(self) -> bool:
        """Whether wheels have no lag and commands no delay."""
        return self.wheel_lag_s[1] == 0 and self.command_delay_s[1] == 0


class ReferenceTable(Table, frozen=True):
    """The reference path and the box that its wheel speeds keep.

    `file` goes with the shape "file" only. A clean recording there keeps its own timing where that
    keeps the wheels in the box; any other path is cleaned, and driven at `speed_mps` where it has
    no time (`jaxtube.paths`). Without `duration_s` it runs once from end to end, any other shape
    for 30 s. The wheel speeds of "jumps" jump anywhere in the box, drawn by `jump_seed`; radius and
    speed play no part. `certified_for` says over which wheel speeds sets and certificate hold: the
    whole "box", under arbitrary changes, or those that occur on the "path", in any order.
    """

    shape: Literal["two_circles", "lemniscate", "jumps", "file"] = "two_circles"
    file: str = ""
    jump_seed: Annotated[int, msgspec.Meta(ge=0)] = 0
    radius_m: Positive = 2.5
    speed_mps: Positive = 1.36
    duration_s: Positive | None = None
    wheel_speed_min_mps: float = 0.2
    wheel_speed_max_mps: float = 1.5
    certified_for: Literal["box", "path"] = "box"

    def __post_init__(self) -> None:
        """Fill in the duration, except that of a recording, which only the recording knows."""
        if self.duration_s is None and self.shape != "file":
            msgspec.structs.force_setattr(self, "duration_s", DURATION_S)


class Slip(Table, frozen=True):
    """Slip of the wheels and of the body: ground speed = wheel speed (1 - slip).

    The true slip of a wheel may be anywhere in `right` or `left`, an interval [least, greatest], in
    any sequence. The controller compensates the constant `nominal_right`, `nominal_left`, by
    default the middle of the interval; or, where a measurement error is given, a measured slip
    within `measurement_error` + `measurement_error_relative` |true slip| of the true one.

    Where the slip of a wheel changes by at most `change_per_s` a second, from one period to the
    next, the controller learns it on line: it compensates the centre of an interval, made from
    measured poses, that always holds the true slip (`jaxtube.plant.slip_observer`).

    Without intervals a slip that varies stays within `relative_error` times the nominal one of it,
    on either side. `random` says which slip varies: the "true" one while the measured one is the
    nominal, the "measured" one while the true one is the nominal, or "both", each on its own. Sets
    and certificate cover what is said and no more.

    The body moves sideways by up to `sideslip` times its forward speed, either way, unknown.
    `process` says how deviations evolve (`jaxtube.plant.slip_processes`); "recorded" takes slips
    and sideslip from the file `recording` (`jaxtube.plant.recorded_slips`), which no other process
    reads.
    """

    right: tuple[SlipValue, SlipValue] | None = None
    left: tuple[SlipValue, SlipValue] | None = None
    nominal_right: SlipValue | None = None
    nominal_left: SlipValue | None = None
    measurement_error: NonNegative | None = None
    measurement_error_relative: Fraction | None = None
    change_per_s: Positive | None = None
    relative_error: Fraction = 0.1
    sideslip: Fraction = 0.0
    process: Literal["iid", "constant", "walk", "patches", "vertex", "adversarial", "recorded"] = (
        "iid"
    )
    recording: str = ""
    random: Literal["true", "measured", "both"] = "true"

    def __post_init__(self) -> None:
        """Fill in the nominal slips."""
        for side in ("right", "left"):
            interval = getattr(self, side)
            if getattr(self, f"nominal_{side}") is None:
                nominal = NOMINAL_SLIP if interval is None else sum(interval) / 2
                msgspec.structs.force_setattr(self, f"nominal_{side}", nominal)

    @property
    def nominal(self) -> tuple[float, float]:
        """The nominal slips (right, left)."""
        assert self.nominal_right is not None
        assert self.nominal_left is not None
        return self.nominal_right, self.nominal_left

    @property
    def has_intervals(self) -> bool:
        """Whether true slips are bounded by intervals, not by an error relative to the nominal."""
        return self.right is not None

    @property
    def is_measured(self) -> bool:
        """Whether the controller compensates a slip that follows the true one."""
        return self.measurement_error is not None or self.measurement_error_relative is not None

    @property
    def is_learnt(self) -> bool:
        """Whether the controller learns the slips on line."""
        return self.change_per_s is not None

    def say_intervals(self) -> str:
        """Return the intervals of the true slips in words."""
        assert self.right is not None
        assert self.left is not None
        right = f"{self.right[0]:g} to {self.right[1]:g}"
        left = f"{self.left[0]:g} to {self.left[1]:g}"
        return f"{right} (right) and {left} (left)"

    def say_measurement_error(self) -> str:
        """Return how far a measured slip may lie from the true one, in words."""
        errors = []
        if self.measurement_error:
            errors.append(f"{self.measurement_error:g}")
        if self.measurement_error_relative:
            errors.append(f"{self.measurement_error_relative:.3g} times its size")
        return " plus ".join(errors) or "0"


class Constraints(Table, frozen=True):
    """Half widths of the error set E, a box in the robot frame."""

    longitudinal_m: Positive = 0.3
    lateral_m: Positive = 0.3
    heading_deg: HeadingBound = 20.0


class BandTable(Table, frozen=True):
    """Caps and tracking gains for mean reference wheel speeds up to `below_mps`, above those of the
    band before; all of them, or none in any band, for `design --optimise` to find."""

    below_mps: Positive
    speed_deficit_min_mps: Negative | None = None
    speed_deficit_max_mps: Positive | None = None
    yaw_rate_deficit_radps: Positive | None = None
    turning_longitudinal_m: Positive | None = None
    turning_yaw_rate_radps: Positive | None = None
    tracking_gains: tuple[Positive, ...] = ()

    def list_missing(self) -> list[str]:
        """Return the names of the caps and gains that are not given."""
        return [name for name in self.__struct_fields__ if not getattr(self, name)]


class Operating(Table, frozen=True):
    """Where the controller may operate, inside constraints and wheel limits; a key left out sets no
    cap of its own.

    Half widths of the measured error, bounds of the inputs u1 (speed deficit) and u2 (yaw rate
    deficit), and |e_x| / turning_longitudinal_m + |u2| / turning_yaw_rate_radps <= 1: to turn hard
    only near the path. `bands` give input caps and tracking gains by the mean reference wheel speed
    instead, each with a W of its own.
    """

    longitudinal_m: Positive | None = None
    lateral_m: Positive | None = None
    heading_deg: HeadingBound | None = None
    speed_deficit_min_mps: Negative | None = None
    speed_deficit_max_mps: Positive | None = None
    yaw_rate_deficit_radps: Positive | None = None
    turning_longitudinal_m: Positive | None = None
    turning_yaw_rate_radps: Positive | None = None
    bands: tuple[BandTable, ...] = ()


class DisturbanceTable(Table, frozen=True):
    """The disturbance set W of one step: `assumed`, a box of these half widths in the robot frame,
    or `computed`."""

    bound: Literal["assumed", "computed"] = "assumed"
    longitudinal_m: NonNegative = 0.005
    lateral_m: NonNegative = 0.005
    heading_deg: HeadingSpread = 0.2


class Noise(Table, frozen=True):
    """Bounds of the error of the measured pose.

    They are half widths of a box: along the axes of the robot's `frame` at that moment, or, with
    `frame = "world"`, of the position in the world (x in the place of longitudinal, y in that of
    lateral) and of the heading.
    """

    frame: Literal["robot", "world"] = "robot"
    longitudinal_m: NonNegative = 0.0
    lateral_m: NonNegative = 0.0
    heading_deg: HeadingSpread = 0.0


class ControllerTable(Table, frozen=True):
    """The predictive controller; a weight is a list of diagonal entries or a symmetric matrix, a
    list of rows.

    A plan costs `tracking`, what errors and inputs weigh, or `deviation`, what the weight of the
    inputs makes of how far they deviate from the terminal gain: then that gain is what runs
    wherever it may, and the error that the closed loop ends within is certified.

    `tracking_gains` (k1 1/s, k2 rad/(m s), k3 1/s) take the place of the gains from
    `lmi_objective`: u1 = -k1 e_x - Om e_y,  u2 = -k2 e_y - k3 e_th. So do `vertex_gains`, of
    u = +K(th) e: K row by row at the vertices (min, max), (min, min), (max, min), (max, max) of the
    box of wheel speeds (right, left), bilinear between them. The terminal set is the maximal
    invariant one where that has at most `terminal_facets` facets, else one of that many. Each facet
    is a row of every QP, so the limit is doubled only if no invariant set with that many facets is
    found.

    `observer_gain` makes the controller act on an estimate of the tracking error: the sampled
    robot's prediction, corrected by this share (longitudinal, lateral, heading) of what the
    measurement differs from it. Less than 1 keeps noise out of the tube, and lets true errors
    differ from the estimate by more than the noise; 1 is the measured error itself.
    """

    dt_s: Positive = 0.1
    horizon: Annotated[int, msgspec.Meta(ge=1, le=200)] = 5
    error_weight: Weight = (1.0, 1.0, 0.01)
    input_weight: Weight = (1.0, 1.0)
    cost: Literal["tracking", "deviation"] = "tracking"
    tube: Literal["paper", "hull", "summed", "sequence"] = "paper"
    model: Literal["paper", "consistent", "exact_jacobian"] = "paper"
    discretisation: Literal["euler", "zoh"] = "euler"
    input_map: Literal["paper", "cosine_free", "x_exact"] = "paper"
    tracking_gains: tuple[Positive, ...] = ()
    vertex_gains: tuple[tuple[float, ...], ...] = ()
    lmi_objective: Literal["trace_s", "trace_p", "logdet"] = "trace_s"
    terminal: Literal["paper", "T-A", "T-B"] = "paper"
    terminal_facets: Annotated[int, msgspec.Meta(ge=8, le=1000)] = 40
    restart: bool = True
    observer_gain: tuple[Share, Share, Share] = (1.0, 1.0, 1.0)

    @property
    def has_observer(self) -> bool:
        """Whether the controller acts on an estimate that is not the measured error itself."""
        return min(self.observer_gain) < 1

    @property
    def tube_has_terminal_gain(self) -> bool:
        """Whether the tube is made with the terminal gain."""
        return self.terminal == "T-A"

    @property
    def terminal_set_holds_reach(self) -> bool:
        """Whether the terminal set is invariant under all that a disturbance has become at the end
        of the horizon, and not under W."""
        return self.terminal == "T-B"


class Initial(Table, frozen=True):
    """Pose of the robot at the start, in the frame of the reference's first pose; a heading counts
    modulo 360 degrees."""

    x_m: float = 0.1
    y_m: float = 0.1
    heading_deg: float = 0.0


class Tuning(Table, frozen=True):
    """The objective of `tune`: the cost of a lap, its tail, the size of the tube, and soft margins.

    A lap costs the sum of squares of RMS errors, once settled, and of the RMS effort, each divided
    by the value given here; a quantity without a value is free. A lap has settled after 10 s; of a
    shorter one the last step alone counts. Effort is the difference between the wheel speeds asked
    for and those of the reference under nominal slip. An RMS effort over all laps above
    `effort_limit_mps` costs steeply. So does a utilisation above `margin`: of every cap by the
    widest tube, and of the error caps and the greatest wheel speed in the laps.
    """

    longitudinal_m: Positive | None = None
    lateral_m: Positive | None = 0.005
    heading_deg: Positive | None = None
    effort_mps: Positive | None = None
    effort_limit_mps: Positive | None = None
    tail_share: Annotated[float, msgspec.Meta(gt=0, le=1)] = 0.1
    tail_weight: NonNegative = 0.1
    tube_weight: NonNegative = 0.1
    margin: Annotated[float, msgspec.Meta(gt=0, le=1)] = 0.9


class Scenario(Table, frozen=True):
    """One experiment: robot, reference, slip, sets, controller, start, and the aim of tuning.

    Change values with `jaxtube.scenario.replace`. It shows the keys that differ from the defaults,
    as TOML; `to_toml` writes all of them.
    """

    robot: RobotTable = RobotTable()
    reference: ReferenceTable = ReferenceTable()
    slip: Slip = Slip()
    constraints: Constraints = Constraints()
    operating: Operating = Operating()
    disturbance: DisturbanceTable = DisturbanceTable()
    noise: Noise = Noise()
    controller: ControllerTable = ControllerTable()
    initial: Initial = Initial()
    tuning: Tuning = Tuning()

    def __repr__(self) -> str:
        return f"# a scenario; keys left out have the defaults\n{_write_differences(self)}".rstrip()


def require_scenario(value: object) -> None:
    """Raise ScenarioError, one line, for anything but a scenario."""
    if isinstance(value, Scenario):
        return
    if isinstance(value, str):
        raise ScenarioError(f"scenario = {value!r}: is a name or a path; give jt.load({value!r})")
    raise ScenarioError(f"scenario: is {describe_type(value)}; give what jt.load returns")


def to_toml(scenario: Scenario) -> str:
    """Write a scenario as TOML with every key that has a value; reading it back gives an equal
    scenario."""
    return _write_tables(msgspec.to_builtins(scenario))


def _write_differences(scenario: Scenario) -> str:
    """Write the keys of a scenario that differ from the defaults; reading them back gives an equal
    scenario."""
    defaults = msgspec.to_builtins(Scenario())
    tables = {}
    for section, table in msgspec.to_builtins(scenario).items():
        default = defaults[section]
        values = {key: value for key, value in table.items() if value != default[key]}
        if values:
            tables[section] = values
    return _write_tables(tables)


def _write_tables(tables: Mapping[str, Mapping[str, Any]]) -> str:
    """Write tables as TOML, without the keys that have no value."""
    texts = []
    for section, table in tables.items():
        lines = [f"[{section}]"]
        for key, value in table.items():
            if value is not None:
                lines.append(f"{key} = {literal(value)}")
        texts.append("\n".join(lines))
    return "\n\n".join(texts) + "\n"


def weight_matrix(weight: Weight) -> Float[np.ndarray, "n n"]:
    """Expand a weight, a list of n diagonal entries or of n rows, to its matrix.

    Raises:
        ValueError: for anything else.
    """
    rows = [row for row in weight if isinstance(row, tuple)]
    if not rows:
        return np.diag(np.array(weight, dtype=float))
    if len(rows) == len(weight) and all(len(row) == len(weight) for row in rows):
        return np.array(weight, dtype=float)
    raise ValueError(
        f"weight = {weight}: neither diagonal entries nor a square matrix; "
        "give n numbers or n rows of n"
    )
