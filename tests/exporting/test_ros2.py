"""The ROS 2 packages without ROS: the node on a stub of its interface drives what the exported
controller commands, says what happens, and refuses what it cannot drive; the plugin is C++."""

import importlib
import math
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import ros_stub
from c_controller import needs_compiler

from jaxtube.exporting.replay import load_controller

ROS = Path(__file__).parents[2] / "docs" / "ros2"
SEPARATION = 0.8
PLACE = np.array([5.0, -3.0, 1.0])
"""Where the path lies in the frame of the robot's poses."""


@pytest.fixture
def node(exported, monkeypatch):
    """The node, started with its parameters."""
    ros_stub.install(monkeypatch)
    monkeypatch.syspath_prepend(str(ROS / "jaxtube_tracker"))
    for name in [name for name in sys.modules if name.startswith("jaxtube_tracker")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(
        ros_stub.Node,
        "parameters",
        {"controller_folder": str(exported.folder), "wheel_separation_m": SEPARATION},
    )
    return importlib.import_module("jaxtube_tracker.node").TrackerNode()


def find_path(design):
    """Return the poses of the reference, without its preview."""
    return design.problem.reference.poses[: design.problem.reference.steps + 1]


def place(pose):
    """Return a pose of the reference's frame where the path lies."""
    turn = np.array(
        [[math.cos(PLACE[2]), -math.sin(PLACE[2])], [math.sin(PLACE[2]), math.cos(PLACE[2])]]
    )
    return np.append(PLACE[:2] + turn @ pose[:2], pose[2] + PLACE[2])


def as_message(pose) -> SimpleNamespace:
    rotation = SimpleNamespace(x=0.0, y=0.0, z=math.sin(pose[2] / 2), w=math.cos(pose[2] / 2))
    position = SimpleNamespace(x=pose[0], y=pose[1], z=0.0)
    return SimpleNamespace(position=position, orientation=rotation)


def send_path(node, poses) -> None:
    posed = [SimpleNamespace(pose=as_message(place(pose))) for pose in poses]
    node.subscriptions["path"](SimpleNamespace(poses=posed))


def send_pose(node, pose, stamp: float) -> None:
    header = SimpleNamespace(stamp=ros_stub.Stamp(round(stamp * ros_stub.NANO)))
    node.subscriptions["pose"](SimpleNamespace(header=header, pose=as_message(place(pose))))


def call(node, service: str) -> SimpleNamespace:
    return node.services[service](SimpleNamespace(), SimpleNamespace(success=None, message=""))


def tick(node, now: float):
    """Run the timer once; return what was published."""
    node.now = round(now * ros_stub.NANO)
    ((_, callback),) = node.timers
    callback()
    return tuple(node.publishers[topic].messages[-1] for topic in ("cmd_vel", "status", "margins"))


def test_twists_make_the_base_turn_its_wheels_as_commanded(node, exported, certified):
    controller = load_controller(exported.folder).Controller(exported.folder / "controller.npz")
    dt = certified.problem.reference.dt
    poses = find_path(certified)
    assert node.timers[0][0] == pytest.approx(dt / 20)
    send_path(node, poses)
    assert call(node, "~/start").success
    generator = np.random.default_rng(8)
    for period in range(20):
        pose = poses[period] + generator.normal(0.0, 0.01, 3)
        now = 100.0 + period * dt
        send_pose(node, pose, now)
        twist, status, margins = tick(node, now)
        expected = controller.step(pose, now, now)
        speed = twist.twist.linear.x
        turning = twist.twist.angular.z * SEPARATION / 2.0
        np.testing.assert_allclose([speed + turning, speed - turning], expected.wheels, atol=1e-6)
        np.testing.assert_allclose(margins.data, expected.margins, atol=1e-6)
        assert status.level == b"\x00"
        assert status.message.startswith("solved, pose used")
        assert (status.values[0].key, status.values[0].value) == ("guaranteed", "true")
    assert node.errors == []


def test_before_a_start_and_after_a_stop_the_robot_stands_still(node, certified):
    poses = find_path(certified)
    assert not call(node, "~/start").success, "without a path"
    send_path(node, poses)
    twist, status, _ = tick(node, 0.0)
    assert (twist.twist.linear.x, twist.twist.angular.z) == (0.0, 0.0)
    assert status.message == "waiting for a start"
    call(node, "~/start")
    assert tick(node, 0.0)[1].message == "waiting for a pose"
    send_pose(node, poses[0], 0.0)
    assert tick(node, 0.0)[0].twist.linear.x != 0.0
    call(node, "~/stop")
    assert tick(node, 0.1)[0].twist.linear.x == 0.0


def test_another_path_is_refused(node, certified):
    poses = find_path(certified)
    send_path(node, [*poses[:10], poses[10] + [0.0, 0.2, 0.0]])
    assert "leaves the reference near" in node.errors[-1]
    assert not call(node, "~/start").success
    send_path(node, [])
    assert "no poses" in node.errors[-1]


def test_a_part_of_the_path_or_the_path_backwards_is_refused(node, certified):
    poses = find_path(certified)
    turned = poses.copy()
    turned[:, 2] += np.append(0.0, np.full(len(poses) - 1, np.pi))
    there_and_back = [*poses[:30], *poses[:30][::-1]]
    refused = {"ends before": [poses[:1], poses[:-10]], "leaves": [turned, there_and_back]}
    for words, paths in refused.items():
        for path in paths:
            send_path(node, path)
            assert words in node.errors[-1]
            assert not call(node, "~/start").success


def test_poses_that_do_not_come_are_told_and_then_halt(node, certified):
    dt = certified.problem.reference.dt
    horizon = certified.problem.horizon
    poses = find_path(certified)
    send_path(node, poses)
    call(node, "~/start")
    send_pose(node, poses[0], 0.0)
    tick(node, 0.0)
    # A twentieth of a period after a pose is due there is still time for it.
    assert tick(node, 1.05 * dt)[1].message.startswith("solved")
    for period in range(1, horizon + 1):
        _, status, _ = tick(node, (period + 0.1001) * dt)
        assert status.level == b"\x01"
        assert status.message.startswith("blind, pose missing")
        assert "no guarantee" in status.message
    for moment in (horizon + 1.1001, horizon + 3):
        twist, status, _ = tick(node, moment * dt)
        assert status.level == b"\x02", "until it is started or stopped"
        assert (twist.twist.linear.x, twist.twist.angular.z) == (0.0, 0.0)
    call(node, "~/stop")
    assert tick(node, (horizon + 4) * dt)[1].level == b"\x00"


def test_a_damaged_controller_does_not_start_the_node(node, exported, tmp_path, monkeypatch):
    folder = tmp_path / "damaged"
    shutil.copytree(exported.folder, folder)
    content = bytearray((folder / "controller.npz").read_bytes())
    content[100] ^= 1
    (folder / "controller.npz").write_bytes(bytes(content))
    monkeypatch.setitem(ros_stub.Node.parameters, "controller_folder", str(folder))
    with pytest.raises(ValueError, match="SHA256SUMS"):
        type(node)()


def test_packages_are_python_that_parses():
    for path in ROS.rglob("*.py"):
        compile(path.read_text(), str(path), "exec")


STUBS = {
    "nav2_core/controller.hpp": """
#pragma once
#include <memory>
#include <string>
#include <vector>
#include "rclcpp/rclcpp.hpp"
namespace tf2_ros { class Buffer {}; }
namespace nav2_costmap_2d { class Costmap2DROS {}; }
namespace std_msgs::msg {
struct Header { builtin_interfaces::msg::Time stamp; std::string frame_id; };
}
namespace geometry_msgs::msg {
struct Vector { double x, y, z; };
struct Quaternion { double x, y, z, w; };
struct Pose { Vector position; Quaternion orientation; };
struct PoseStamped { std_msgs::msg::Header header; Pose pose; };
struct Twist { Vector linear; Vector angular; };
struct TwistStamped { std_msgs::msg::Header header; Twist twist; };
}
namespace nav_msgs::msg {
struct Path { std_msgs::msg::Header header; std::vector<geometry_msgs::msg::PoseStamped> poses; };
}
namespace nav2_core {
class GoalChecker {};
class Controller {
public:
  virtual ~Controller() = default;
  virtual void configure(
    const rclcpp_lifecycle::LifecycleNode::WeakPtr &, std::string,
    std::shared_ptr<tf2_ros::Buffer>, std::shared_ptr<nav2_costmap_2d::Costmap2DROS>) = 0;
  virtual void cleanup() = 0;
  virtual void activate() = 0;
  virtual void deactivate() = 0;
  virtual void setPlan(const nav_msgs::msg::Path &) = 0;
  virtual geometry_msgs::msg::TwistStamped computeVelocityCommands(
    const geometry_msgs::msg::PoseStamped &, const geometry_msgs::msg::Twist &, GoalChecker *) = 0;
  virtual void setSpeedLimit(const double &, const bool &) = 0;
};
}
""",
    "nav2_core/controller_exceptions.hpp": """
#pragma once
#include <stdexcept>
namespace nav2_core {
struct ControllerException : std::runtime_error { using std::runtime_error::runtime_error; };
struct InvalidController : ControllerException { using ControllerException::ControllerException; };
struct NoValidControl : ControllerException { using ControllerException::ControllerException; };
}
""",
    "nav2_util/node_utils.hpp": """
#pragma once
namespace nav2_util {
template<typename N, typename V>
void declare_parameter_if_not_declared(N, const std::string &, V) {}
}
""",
    "pluginlib/class_list_macros.hpp": "#define PLUGINLIB_EXPORT_CLASS(derived, base)\n",
    "rclcpp/rclcpp.hpp": """
#pragma once
#include <cstdio>
#include <memory>
#include <string>
namespace builtin_interfaces::msg { struct Time { int sec; unsigned nanosec; }; }
namespace rclcpp {
struct Logger {};
inline Logger get_logger(const char *) { return {}; }
struct Time {
  Time() = default;
  Time(const builtin_interfaces::msg::Time &) {}
  operator builtin_interfaces::msg::Time() const { return {}; }
  double seconds() const { return 0.0; }
};
struct Clock { using SharedPtr = std::shared_ptr<Clock>; Time now() { return {}; } };
struct ParameterValue { explicit ParameterValue(double) {} };
}
namespace rclcpp_lifecycle {
struct LifecycleNode {
  using WeakPtr = std::weak_ptr<LifecycleNode>;
  rclcpp::Logger get_logger() { return {}; }
  rclcpp::Clock::SharedPtr get_clock() { return {}; }
  bool get_parameter(const std::string &, double &) { return true; }
};
}
#define RCLCPP_ERROR(logger, ...) (static_cast<void>(logger), std::printf(__VA_ARGS__))
#define RCLCPP_WARN(logger, ...) (static_cast<void>(logger), std::printf(__VA_ARGS__))
""",
}


@needs_compiler
@pytest.mark.skipif(shutil.which("c++") is None, reason="there is no C++ compiler here")
def test_the_plugin_is_written_for_the_interface_of_nav2(exported, tmp_path):
    for name, text in STUBS.items():
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    package = ROS / "jaxtube_nav2_controller"
    includes = [tmp_path, package / "include", exported.folder / "c"]
    flags = ["-std=c++17", "-Wall", "-Wextra", "-Werror", "-fsyntax-only"]
    source = package / "src" / "tube_mpc_controller.cpp"
    command = ["c++", *flags, *(f"-I{path}" for path in includes), str(source)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
