"""The node: topics, parameters and services around `tracker.Tracker`.

in     pose      geometry_msgs/PoseStamped     measured, in the frame of the path
       path      nav_msgs/Path                 where the reference lies
out    cmd_vel   geometry_msgs/TwistStamped    every period
       status    diagnostic_msgs/DiagnosticStatus
       margins   std_msgs/Float64MultiArray    share of each cap that is left; below 0 outside
services  ~/start, ~/stop  std_srvs/Trigger
"""

import importlib.util
import math
from pathlib import Path

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped, TwistStamped
from nav_msgs.msg import Path as PathMessage
from rclpy.node import Node
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from jaxtube_tracker.tracker import Tracker

NANOSECONDS = 1e-9


def load_controller(folder):
    """Return the exported controller of a folder, whose files are checked."""
    path = Path(folder) / "controller.py"
    spec = importlib.util.spec_from_file_location("exported_controller", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.Controller(Path(folder) / "controller.npz")


def read_time(stamp):
    """Return a stamp in seconds."""
    return stamp.sec + NANOSECONDS * stamp.nanosec


def read_pose(pose):
    """Return (x m, y m, heading rad) of a pose whose rotation is about z."""
    q = pose.orientation
    heading = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
    return pose.position.x, pose.position.y, heading


class TrackerNode(Node):
    """Drives an exported controller."""

    def __init__(self):
        super().__init__("jaxtube_tracker")
        self.declare_parameter("controller_folder", "")
        self.declare_parameter("wheel_separation_m", 0.0)
        self.declare_parameter("path_tolerance_m", 0.05)
        self.declare_parameter("base_frame", "base_link")
        self._tracker = Tracker(
            load_controller(self._read("controller_folder")),
            self._read("wheel_separation_m"),
            self._read("path_tolerance_m"),
        )
        self._twists = self.create_publisher(TwistStamped, "cmd_vel", 1)
        self._statuses = self.create_publisher(DiagnosticStatus, "status", 1)
        self._margins = self.create_publisher(Float64MultiArray, "margins", 1)
        self.create_subscription(PoseStamped, "pose", self._take_pose, 1)
        self.create_subscription(PathMessage, "path", self._take_path, 1)
        self.create_service(Trigger, "~/start", self._start)
        self.create_service(Trigger, "~/stop", self._stop)
        self.create_timer(self._tracker.period, self._tick)

    def _read(self, name):
        return self.get_parameter(name).value

    def _take_pose(self, message):
        self._tracker.take_pose(read_pose(message.pose), read_time(message.header.stamp))

    def _take_path(self, message):
        problem = self._tracker.take_path([read_pose(posed.pose) for posed in message.poses])
        if problem:
            self.get_logger().error(problem)

    def _start(self, request, response):
        response.message = self._tracker.start()
        response.success = not response.message
        return response

    def _stop(self, request, response):
        self._tracker.stop()
        response.success = True
        return response

    def _tick(self):
        now = self.get_clock().now()
        tick = self._tracker.tick(NANOSECONDS * now.nanoseconds)
        twist = TwistStamped()
        twist.header.stamp = now.to_msg()
        twist.header.frame_id = self._read("base_frame")
        twist.twist.linear.x = tick.speed
        twist.twist.angular.z = tick.yaw_rate
        self._twists.publish(twist)
        guaranteed = KeyValue(key="guaranteed", value=str(tick.is_guaranteed).lower())
        status = DiagnosticStatus(name="jaxtube_tracker", message=tick.message, values=[guaranteed])
        status.level = bytes([tick.level])
        self._statuses.publish(status)
        self._margins.publish(Float64MultiArray(data=list(tick.margins)))


def main():
    """Run the node until it is told to stop."""
    rclpy.init()
    node = TrackerNode()
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
