"""What the node does, without ROS: poses, a path and ticks in; twists, status and margins out.

The exported controller drives one reference. A path places it: its first pose is where the
reference begins, and from there to the end it has to be the reference, in its order and direction,
to a tolerance; another path is refused.

`poll` is asked often. A period begins with the first pose that comes when it is due, or, when none
comes in time, without one.
"""

import math
from enum import IntEnum
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
MOST_TURN = 0.2
"""By which a path may head off the reference, rad, beside what a stretch of it turns."""
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
        if controller.needs_slip:
            raise ValueError("the controller needs measured slips, which this node does not have")
        self._controller = controller
        self._wheel_separation = wheel_separation
        self._path_tolerance = path_tolerance
        self._origin = None
        self._pose = None
        self._stamp = None
        self._drives = False
        self._due = None
        self._last = Tick(*STILL, Level.OK, "waiting for a start", NO_MARGINS, False)

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
        problem = self._compare([self._see(pose, origin) for pose in poses])
        if not problem:
            self._origin = origin
        return problem and f"path refused: {problem}; export a controller for this path"

    def _compare(self, path) -> str:
        """Return why a path, in the frame of the reference, is not the reference, or nothing."""
        points = self._controller.reference_poses.tolist()
        at = 0
        for pose in path:
            # On from where the last pose was: a path that turns back leaves the reference.
            ahead = range(at, len(points) - 1)
            near = (i for i in ahead if self._is_near(pose, points[i], points[i + 1]))
            at = next(near, None)
            if at is None:
                x, y, heading = pose
                return f"it leaves the reference near ({x:.3g} m, {y:.3g} m, {heading:.3g} rad)"
        if math.dist(path[-1][:2], points[-1][:2]) > self._path_tolerance:
            return "it ends before the reference"
        return ""

    def _is_near(self, pose, begin, end) -> bool:
        """Return whether a pose is on a stretch of the reference, and heads along it."""
        turn = math.remainder(pose[2] - begin[2], math.tau)
        slack = abs(end[2] - begin[2]) + MOST_TURN
        return measure_distance(pose, begin, end) <= self._path_tolerance and abs(turn) <= slack

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
        self._due = None
        self._pose = None
        self._last = Tick(*STILL, Level.OK, "waiting for a pose", NO_MARGINS, False)
        return ""

    def stop(self) -> None:
        """Stand still."""
        self._drives = False
        self._last = Tick(*STILL, Level.OK, "waiting for a start", NO_MARGINS, False)

    def poll(self, now: float) -> Tick:
        """Return what to do now, s: the command of the period, a new one where it begins."""
        if self._drives and self._begins(now):
            self._last = self._tick(now)
        return self._last

    def _begins(self, now: float) -> bool:
        """Return whether a period begins: the first one with the first pose, the others when they
        are due and a pose is there, or is late."""
        has_pose = self._pose is not None
        if self._due is None:
            return has_pose
        jitter = self._controller.most_jitter
        return now >= self._due + jitter or (has_pose and now >= self._due - jitter)

    def _tick(self, now: float) -> Tick:
        """Return what the period is to do that begins now."""
        self._due = (now if self._due is None else self._due) + self._controller.dt
        pose = None if self._pose is None else self._see(self._pose, self._origin)
        self._pose = None
        output = self._controller.step(pose, self._stamp, now)
        right, left = output.wheels.tolist()
        if STATUS[output.status] in ("halted", "finished"):
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
        if status == "finished":
            return Level.OK
        return Level.OK if status == "solved" and output.in_time else Level.WARN

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


def measure_distance(point, begin, end) -> float:
    """Return the distance of a point from the line between two others."""
    along = (end[0] - begin[0], end[1] - begin[1])
    length = along[0] ** 2 + along[1] ** 2
    ahead = (point[0] - begin[0]) * along[0] + (point[1] - begin[1]) * along[1]
    share = min(max(ahead / length, 0.0), 1.0) if length > 0 else 0.0
    nearest = (begin[0] + share * along[0], begin[1] + share * along[1])
    return math.hypot(point[0] - nearest[0], point[1] - nearest[1])
