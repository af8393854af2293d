"""What the node does, without ROS: poses, a path and ticks in; twists, status and margins out.

The exported controller drives one reference. A path places it: its first pose is where the
reference begins, and the rest has to be the reference, to a tolerance; another path is refused.
"""

import math
from enum import IntEnum
from itertools import pairwise
from typing import NamedTuple

STATUS = ("solved", "infeasible", "unsolved", "blind", "halted", "finished")
POSE = ("used", "missing", "late", "invalid")


class Level(IntEnum):
    """Of a diagnostic status, as ROS numbers them."""

    OK = 0
    WARN = 1
    ERROR = 2


class Tick(NamedTuple):
    """What is published after a period."""

    speed: float  # m/s
    yaw_rate: float  # rad/s
    level: Level
    message: str
    margins: tuple[float, float, float]  # share of each cap that is left
    is_guaranteed: bool


STILL = (0.0, 0.0)
NO_MARGINS = (math.nan, math.nan, math.nan)


class Tracker:
    """Drives an exported controller.

    Args:
        controller: an exported `Controller`.
        wheel_separation: by which the driver of the base turns a twist into wheel speeds, m.
        path_tolerance: by which a path may leave the reference, m.
    """

    def __init__(self, controller, wheel_separation: float, path_tolerance: float):
        if not wheel_separation > 0:
            raise ValueError(f"wheel_separation = {wheel_separation}: give metres, such as 0.5")
        self._controller = controller
        self._wheel_separation = wheel_separation
        self._path_tolerance = path_tolerance
        self._origin = None
        self._pose = None
        self._stamp = None
        self._drives = False

    @property
    def period(self) -> float:
        """Length of a period, s."""
        return self._controller.dt

    def take_path(self, poses) -> str:
        """Place the reference at the first pose (x m, y m, heading rad) of a path; return why it is
        refused, or nothing."""
        if self._drives:
            return "path refused: stop the robot first"
        if not poses or not all(math.isfinite(number) for pose in poses for number in pose):
            return "path refused: it has no poses, or one that is not finite"
        origin = self._find_origin(poses[0])
        farthest = max(self._find_distance(self._see(pose, origin)) for pose in poses)
        if farthest > self._path_tolerance:
            return (
                f"path refused: it leaves the reference of the controller by {farthest:.3g} m; "
                "export a controller for this path"
            )
        self._origin = origin
        return ""

    def take_pose(self, pose, stamp: float) -> None:
        """Take a measured pose (x m, y m, heading rad) of a time, s."""
        self._pose = tuple(pose)
        self._stamp = stamp

    def start(self) -> str:
        """Begin the reference with the next tick; return why not, or nothing."""
        if self._origin is None:
            return "not started: no path was accepted"
        self._controller.restart()
        self._drives = True
        return ""

    def stop(self) -> None:
        """Stand still from the next tick on."""
        self._drives = False

    def tick(self, now: float) -> Tick:
        """Return what the period is to do that begins now, s."""
        if not self._drives:
            return Tick(*STILL, Level.OK, "waiting for a start", NO_MARGINS, False)
        pose = None if self._pose is None else self._see(self._pose, self._origin)
        output = self._controller.step(pose, self._stamp, now)
        right, left = output.wheels.tolist()
        status = STATUS[output.status]
        if status in ("halted", "finished"):
            self._drives = False
        return Tick(
            speed=(right + left) / 2.0,
            yaw_rate=(right - left) / self._wheel_separation,
            level=self._judge(output),
            message=self._describe(output),
            margins=tuple(output.margins.tolist()),
            is_guaranteed=output.guaranteed,
        )

    def _judge(self, output) -> Level:
        status = STATUS[output.status]
        if status == "halted":
            return Level.ERROR
        is_usual = status in ("solved", "finished") and output.in_time
        return Level.OK if is_usual and min(output.margins) >= 0 else Level.WARN

    def _describe(self, output) -> str:
        words = f"{STATUS[output.status]}, pose {POSE[output.pose]}"
        if not output.in_time:
            words += ", called early or late"
        if not output.guaranteed:
            words += ", no guarantee"
        return f"{words}, plan for {output.plan_left} more periods"

    def _find_origin(self, pose):
        """Return the pose in the world of the frame in which the reference begins where it does."""
        x, y, heading = self._controller.reference_poses[0].tolist()
        turn = pose[2] - heading
        cosine = math.cos(turn)
        sine = math.sin(turn)
        return pose[0] - cosine * x + sine * y, pose[1] - sine * x - cosine * y, turn

    @staticmethod
    def _see(pose, origin):
        """Return a pose as it is seen from the origin."""
        cosine = math.cos(origin[2])
        sine = math.sin(origin[2])
        x = pose[0] - origin[0]
        y = pose[1] - origin[1]
        return cosine * x + sine * y, cosine * y - sine * x, pose[2] - origin[2]

    def _find_distance(self, pose) -> float:
        """Return the distance of a pose in the frame of the reference from the line through the
        poses of the reference, m."""
        points = self._controller.reference_poses[:, :2]
        return min(measure_distance(pose, a, b) for a, b in pairwise(points.tolist()))


def measure_distance(point, begin, end) -> float:
    """Return the distance of a point from the line between two others."""
    along = (end[0] - begin[0], end[1] - begin[1])
    length = along[0] ** 2 + along[1] ** 2
    ahead = (point[0] - begin[0]) * along[0] + (point[1] - begin[1]) * along[1]
    share = min(max(ahead / length, 0.0), 1.0) if length > 0 else 0.0
    nearest = (begin[0] + share * along[0], begin[1] + share * along[1])
    return math.hypot(point[0] - nearest[0], point[1] - nearest[1])
