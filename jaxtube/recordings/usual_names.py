"""The usual names of columns, and the units that names carry.

Names are compared in lower case with single underscores between words, so that
`pose.position.x`, `/pose/position/x` and `posePositionX` are one name.

Source: new; ROS message fields as `rostopic echo -p`, `ros2 topic echo --csv` and PlotJuggler name
them, TUM and EuRoC pose files, and logs of robots that are public.
"""

from __future__ import annotations

from typing import NamedTuple

UNIT_SUFFIXES: dict[str, dict[str, tuple[str, ...]]] = {
    "time": {
        "s": ("s", "sec", "secs", "second", "seconds"),
        "ms": ("ms", "msec", "millis", "milliseconds"),
        "us": ("us", "usec", "micros", "microseconds"),
        "ns": ("ns", "nsec", "nanos", "nanosec", "nanoseconds"),
    },
    "length": {
        "m": ("m", "metre", "metres", "meter", "meters"),
        "cm": ("cm",),
        "mm": ("mm",),
    },
    "angle": {
        "rad": ("rad", "radian", "radians"),
        "deg": ("deg", "degree", "degrees"),
    },
    "wheel": {
        "m/s": ("mps", "m_s", "m_per_s"),
        "rad/s": ("radps", "rad_s", "rads", "rad_per_s"),
        "rpm": ("rpm",),
        "ticks": ("ticks", "tick", "counts", "count", "encoder", "enc"),
        "rad": ("rad",),
    },
    "speed": {
        "m/s": ("mps", "m_s", "m_per_s"),
    },
    "rate": {
        "rad/s": ("radps", "rad_s", "rads", "rad_per_s"),
        "deg/s": ("degps", "deg_s", "deg_per_s"),
    },
    "number": {},
}
"""How names end by unit, the unit that is assumed first, for each kind of quantity."""


class Role(NamedTuple):
    """What a column can hold.

    Attributes:
        name: as `--columns` says it.
        kind: of its quantity, a key of `UNIT_SUFFIXES`.
        words: for messages.
        names: that are usual, the likeliest first, without unit.
        units: of those names that mean a unit without saying it.
    """

    name: str
    kind: str
    words: str
    names: tuple[str, ...]
    units: dict[str, str]


def _name_wheels(side: str) -> Role:
    """Return the role of the wheels of one side."""
    speeds = (
        "{side}_wheel", "wheel_{side}", "{side}_vel", "vel_{side}", "{side}_velocity",
        "velocity_{side}", "{side}_speed", "speed_{side}", "{side}_wheel_vel", "wheel_vel_{side}",
        "{side}_wheel_velocity", "wheel_{side}_velocity", "{side}_wheel_speed",
        "wheel_speed_{side}", "wheel_{side}_speed", "wheel_{side}_vel", "{side}_track",
        "track_{side}", "{side}", "v_{side}", "v_{letter}", "{letter}_vel", "vel_{letter}",
        "v{letter}", "wheel_{letter}", "{letter}_wheel", "speed_{letter}",
    )  # fmt: skip
    rates = ("omega_{side}", "omega_{letter}", "w_{side}", "w_{letter}", "w{letter}")
    rates = (*rates, "{side}_omega", "{side}_wheel_joint_velocity", "{side}_joint_velocity")
    ticks = ("{side}_encoder", "encoder_{side}", "enc_{side}", "{side}_enc", "enc_{letter}")
    ticks = (*ticks, "ticks_{side}", "ticks_{letter}", "{side}_ticks", "encoder_{letter}")
    units = {name: "rad/s" for name in rates} | {name: "ticks" for name in ticks}
    letter = side[0]
    return Role(
        side,
        "wheel",
        f"the speed of the {side} wheels",
        tuple(name.format(side=side, letter=letter) for name in (*speeds, *rates, *ticks)),
        {name.format(side=side, letter=letter): unit for name, unit in units.items()},
    )


def _name_quaternion(part: str) -> Role:
    """Return the role of one part of the quaternion from body to world."""
    names = (
        f"q{part}", f"q_{part}", f"quat_{part}", f"quaternion_{part}", f"rot_{part}",
        f"orientation_{part}", f"pose_orientation_{part}", f"pose_pose_orientation_{part}",
        f"rotation_{part}", f"transform_rotation_{part}",
    )  # fmt: skip
    words = f"the part {part} of the quaternion"
    return Role(f"q{part}", "number", words, names, {})


def _name_coordinate(axis: str, utm: str) -> Role:
    """Return the role of one coordinate of the position."""
    names = (
        axis, f"pos_{axis}", f"position_{axis}", f"pose_{axis}", f"p_{axis}", f"p{axis}",
        f"pose_position_{axis}", f"pose_pose_position_{axis}", f"t{axis}", f"t_{axis}",
        f"translation_{axis}", f"transform_translation_{axis}", f"p_rs_r_{axis}",
        f"{axis}_pos", f"{axis}_position", f"{utm}ing", utm, f"utm_{axis}", f"{axis}_utm",
        f"utm_{utm}ing", f"utm_{utm}", f"{utm}ing_utm",
    )  # fmt: skip
    return Role(axis, "length", f"the coordinate {axis}", names, {})


TIME = Role(
    "time",
    "time",
    "the time",
    (
        "header_stamp", "time", "t", "stamp", "timestamp", "time_stamp", "elapsed", "elapsed_time",
        "rosbag_timestamp", "rosbagtimestamp", "clock", "sec", "secs", "seconds",
    ),
    {"sec": "s", "secs": "s", "seconds": "s"},
)  # fmt: skip

STAMP_PAIRS = (
    ("header_stamp_sec", "header_stamp_nanosec"),
    ("header_stamp_secs", "header_stamp_nsecs"),
    ("header_stamp_sec", "header_stamp_nsec"),
    ("stamp_sec", "stamp_nanosec"),
    ("stamp_sec", "stamp_nsec"),
    ("stamp_secs", "stamp_nsecs"),
    ("sec", "nanosec"),
    ("sec", "nsec"),
    ("secs", "nsecs"),
    ("seconds", "nanoseconds"),
)
"""Columns of seconds and of nanoseconds that make up one stamp."""

LEFT = _name_wheels("left")
RIGHT = _name_wheels("right")
X = _name_coordinate("x", "east")
Y = _name_coordinate("y", "north")
HEADING = Role(
    "heading",
    "angle",
    "the heading",
    (
        "heading", "yaw", "theta", "psi", "heading_angle", "yaw_angle", "pose_theta", "pose_yaw",
        "pose_heading", "orientation_yaw",
    ),
    {},
)  # fmt: skip
QUATERNION = tuple(_name_quaternion(part) for part in "xyzw")
SPEED = Role(
    "cmd_v",
    "speed",
    "the commanded speed",
    (
        "cmd_v", "cmd_vel", "v_cmd", "cmd_speed", "cmd_lin", "cmd_linear", "command_v",
        "cmd_linear_x", "cmd_vel_linear_x", "command_linear_x", "linear_x",
    ),
    {},
)  # fmt: skip
YAW_RATE = Role(
    "cmd_w",
    "rate",
    "the commanded yaw rate",
    (
        "cmd_w", "w_cmd", "cmd_omega", "omega_cmd", "cmd_yaw_rate", "cmd_ang", "cmd_angular",
        "command_w", "cmd_angular_z", "cmd_vel_angular_z", "command_angular_z", "angular_z",
    ),
    {},
)  # fmt: skip
STEP = Role(
    "step",
    "number",
    "the number of the command",
    ("step", "command", "command_number", "command_index", "cmd_index", "cmd_step"),
    {},
)

BODY_SPEED = Role(
    "v", "speed", "the speed of the body", ("v", "v_x", "vx", "speed", "body_v", "body_vx"), {}
)
BODY_RATE = Role(
    "w", "rate", "the yaw rate of the body", ("w", "omega", "yaw_rate", "w_z", "wz", "body_w"), {}
)
BODY_LATERAL = Role(
    "vy", "speed", "the lateral speed of the body", ("vy", "v_y", "body_vy", "lateral_speed"), {}
)
STEADY = Role("steady", "number", "whether a window is steady", ("steady", "is_steady"), {})
LARGEST_STEP = Role(
    "largest_step",
    "length",
    "the largest step between two poses",
    ("largest_pose_step", "largest_step", "max_pose_step"),
    {},
)

WHOLE_NAMES = ("linear_x", "angular_z")
"""Usual names that are whole ones: `twist.twist.linear.x` of an odometry is measured, and commands
nothing."""

LOG_ROLES = (TIME, LEFT, RIGHT, X, Y, HEADING, *QUATERNION, SPEED, YAW_RATE, STEP)
WINDOW_ROLES = (STEP, LEFT, RIGHT, BODY_SPEED, BODY_RATE, BODY_LATERAL, STEADY, LARGEST_STEP)
PATH_ROLES = (TIME, X, Y, HEADING, *QUATERNION)
