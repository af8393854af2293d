"""Laws of bags: one drive reads alike from ROS 1, ROS 2 and MCAP, topics are told by types and
names, and what cannot be told is refused with the option that tells it."""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from jaxtube.recordings.bag import is_bag
from jaxtube.recordings.hints import Hints
from jaxtube.recordings.reading import read_log, read_path

rosbag1 = pytest.importorskip("rosbags.rosbag1")
rosbag2 = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")

RADIUS = 0.15
START = 1_700_000_000_123_456_789
PERIOD = 20_000_000
COUNT = 12
KINDS = ("bag", "db3", "mcap")

TIME = PERIOD * 1e-9 * np.arange(COUNT)
WHEELS = np.column_stack([1.0 + TIME, 0.8 - TIME])  # right, left, m/s
HEADINGS = 3.0 + 2.0 * TIME
POSES = np.column_stack([np.sin(HEADINGS), -np.cos(HEADINGS), HEADINGS])


@dataclass(frozen=True)
class Maker:
    """Makes messages of one ROS."""

    store: object
    has_seq: bool

    def make(self, name, *fields):
        return self.store.types[name](*fields)

    def header(self, stamp, frame="map"):
        time = self.make("builtin_interfaces/msg/Time", stamp // 10**9, stamp % 10**9)
        return self.make("std_msgs/msg/Header", *([0] if self.has_seq else []), time, frame)

    def vector(self, x=0.0, y=0.0, z=0.0, name="Vector3"):
        return self.make(f"geometry_msgs/msg/{name}", x, y, z)

    def turn(self, heading):
        half = heading / 2.0
        return self.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, np.sin(half), np.cos(half))

    def pose(self, x, y, heading):
        return self.make(
            "geometry_msgs/msg/Pose", self.vector(x, y, 0.5, "Point"), self.turn(heading)
        )

    def joints(self, stamp, names, positions, velocities):
        arrays = [np.array(values, dtype=float) for values in (positions, velocities, [])]
        return self.make("sensor_msgs/msg/JointState", self.header(stamp), list(names), *arrays)

    def odometry(self, stamp, pose):
        twist = self.make("geometry_msgs/msg/Twist", self.vector(), self.vector())
        free = np.zeros(36)
        return self.make(
            "nav_msgs/msg/Odometry",
            self.header(stamp),
            "base_link",
            self.make("geometry_msgs/msg/PoseWithCovariance", self.pose(*pose), free),
            self.make("geometry_msgs/msg/TwistWithCovariance", twist, free),
        )

    def pose_stamped(self, stamp, pose):
        return self.make("geometry_msgs/msg/PoseStamped", self.header(stamp), self.pose(*pose))

    def transform(self, stamp, pose, frame="map", child="base_link"):
        moved = self.make(
            "geometry_msgs/msg/Transform", self.vector(pose[0], pose[1]), self.turn(pose[2])
        )
        header = self.header(stamp, frame)
        return self.make("geometry_msgs/msg/TransformStamped", header, child, moved)

    def tree(self, *transforms):
        return self.make("tf2_msgs/msg/TFMessage", list(transforms))

    def twist(self, speed, yaw_rate):
        turn = self.vector(0.0, 0.0, yaw_rate)
        return self.make("geometry_msgs/msg/Twist", self.vector(speed), turn)


def get_ros1_store():
    """Return the types of ROS 1 with those of transforms, which the library has for ROS 2 alone."""
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    tree = "geometry_msgs/TransformStamped[] transforms"
    store.register(typesys.get_types_from_msg(tree, "tf2_msgs/msg/TFMessage"))
    return store


ROS1 = Maker(get_ros1_store(), has_seq=True)
ROS2 = Maker(typesys.get_typestore(typesys.Stores.ROS2_HUMBLE), has_seq=False)


def write_bag(folder, kind, make_messages):
    """Write messages, each (topic, time of reception in ns, content)."""
    maker = ROS1 if kind == "bag" else ROS2
    if kind == "bag":
        path = folder / "log.bag"
        writer = rosbag1.Writer(path)
        serialize = maker.store.serialize_ros1
    else:
        path = folder / f"log_{kind}"
        plugin = rosbag2.StoragePlugin.MCAP if kind == "mcap" else rosbag2.StoragePlugin.SQLITE3
        writer = rosbag2.Writer(path, version=9, storage_plugin=plugin)
        serialize = maker.store.serialize_cdr
    connections = {}
    with writer:
        for topic, received, content in make_messages(maker):
            kind_of = content.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind_of, typestore=maker.store)
            writer.write(connections[topic], received, bytes(serialize(content, kind_of)))
    return path


JOINTS = (
    "front_left_wheel",
    "front_right_wheel",
    "rear_left_wheel",
    "rear_right_wheel",
    "left_arm",
)


def drive(maker, pose_topic="/icp_odom", delay=7_000_000):
    """Yield a drive: joints in rad/s, their stamps earlier than their reception; the wheels of a
    side differ and their mean is what counts."""
    for k in range(COUNT):
        stamp = START + k * PERIOD
        right, left = WHEELS[k] / RADIUS
        speeds = [left - 0.1, right + 0.2, left + 0.1, right - 0.2, 9.0]
        positions = [0.0] * 5
        yield "/joint_states", stamp + delay, maker.joints(stamp, JOINTS, positions, speeds)
        yield "/joint_states", stamp + delay, maker.joints(stamp, ["gripper"], [1.0], [2.0])
        yield pose_topic, stamp + 2 * delay, maker.odometry(stamp + 1_000_000, POSES[k])
        if k in (3, 8):
            yield "/cmd_vel", stamp - 1, maker.twist(0.1 * k, -0.2 * k)


@pytest.mark.parametrize("kind", KINDS)
def test_a_drive_reads_alike_from_every_kind_of_bag(tmp_path, kind):
    path = write_bag(tmp_path, kind, drive)
    assert is_bag(path)
    log = read_log(path, Hints(wheel_radius_m=RADIUS))
    np.testing.assert_allclose(log.time, TIME, rtol=0, atol=1e-15)
    np.testing.assert_allclose(log.pose_time, TIME + 1e-3, rtol=0, atol=1e-15)
    np.testing.assert_allclose(log.wheels, WHEELS, atol=1e-12)
    np.testing.assert_allclose(log.poses, POSES, atol=1e-12)
    held = np.where(np.arange(COUNT) < 3, 0.0, np.where(np.arange(COUNT) < 8, 3.0, 8.0))
    np.testing.assert_allclose(log.commands, np.outer(held, [0.1, -0.2]), atol=1e-12)
    assert "left = front_left_wheel+rear_left_wheel of /joint_states in rad/s" in log.guesses
    assert any("tell no slip if they are integrated" in clause for clause in log.guesses)


@pytest.mark.parametrize("suffix", ["mcap", "db3"])
def test_a_storage_file_is_read_without_its_folder(tmp_path, suffix):
    folder = write_bag(tmp_path, suffix, drive)
    (file,) = folder.glob(f"*.{suffix}")
    alone = file.rename(tmp_path / file.name)
    np.testing.assert_allclose(
        read_log(alone, Hints(wheel_radius_m=RADIUS)).wheels, WHEELS, atol=1e-12
    )


def test_joints_need_the_radius_of_the_wheels(tmp_path):
    with pytest.raises(ValueError, match=r"wheels are in rad/s: .* give --wheel-radius 0.165"):
        read_log(write_bag(tmp_path, "mcap", drive))


def test_joints_are_taken_as_the_user_says(tmp_path):
    path = write_bag(tmp_path, "mcap", drive)
    columns = {"left": "front_left_wheel", "right": "rear_right_wheel"}
    log = read_log(path, Hints(columns=columns, wheel_radius_m=RADIUS))
    shift = RADIUS * np.array([-0.2, -0.1])
    np.testing.assert_allclose(log.wheels, WHEELS + shift, atol=1e-12)
    metres = read_log(path, Hints(units={"left": "m/s", "right": "m/s"}))
    np.testing.assert_allclose(metres.wheels, WHEELS / RADIUS, atol=1e-12)
    with pytest.raises(
        ValueError, match=r"has no joint wl among front_left_wheel, .*--columns left="
    ):
        read_log(path, Hints(columns={"left": "wl"}, wheel_radius_m=RADIUS))


def test_angles_of_joints_are_differenced_where_they_have_no_speeds(tmp_path):
    angles = np.cumsum(WHEELS, axis=0) * PERIOD * 1e-9 / RADIUS

    def messages(maker):
        for k in range(COUNT):
            stamp = START + k * PERIOD
            names = ["wheel_right_joint", "wheel_left_joint"]
            yield "/joint_states", stamp, maker.joints(stamp, names, angles[k], [])
            yield "/pose", stamp, maker.pose_stamped(stamp, POSES[k])

    log = read_log(write_bag(tmp_path, "bag", messages), Hints(wheel_radius_m=RADIUS))
    np.testing.assert_allclose(log.wheels, WHEELS[1:], atol=1e-9)
    np.testing.assert_allclose(log.pose_time, TIME - 0.5e-9 * PERIOD, rtol=0, atol=1e-15)


def numbers(maker):
    for k in range(COUNT):
        stamp = START + k * PERIOD
        right, left = WHEELS[k]
        yield "/left_drive/speed", stamp, maker.make("std_msgs/msg/Float64", left)
        # Received half a period later, and as much along its line.
        right += (WHEELS[1, 0] - WHEELS[0, 0]) / 2.0
        yield "/right_drive/speed", stamp + PERIOD // 2, maker.make("std_msgs/msg/Float64", right)
        yield "/pose", stamp, maker.pose_stamped(stamp, POSES[k])


def test_wheels_come_from_two_topics_of_numbers(tmp_path):
    path = write_bag(tmp_path, "mcap", numbers)
    topics = {"left": "/left_drive/speed", "right": "/right_drive/speed:data"}
    log = read_log(path, Hints(topics=topics, units={"left": "m/s", "right": "m/s"}))
    np.testing.assert_allclose(log.wheels, WHEELS[1:], atol=1e-12)
    np.testing.assert_allclose(log.pose_time, TIME - TIME[1], rtol=0, atol=1e-12)
    with pytest.raises(ValueError, match=r"numbers in topics have no unit; give one"):
        read_log(path, Hints(topics=topics))
    wrong = {**topics, "left": "/pose:pose.position"}
    with pytest.raises(ValueError, match=r"/pose have no number pose.position; name the field"):
        read_log(path, Hints(topics=wrong, units={"left": "m/s"}))
    with pytest.raises(
        ValueError, match=r"no topic holds wheel speeds \(JointState\), among /left"
    ):
        read_log(path)


def trees(maker, pairs=(("map", "odom"), ("odom", "base_link"), ("base_link", "laser"))):
    for k in range(COUNT):
        stamp = START + k * PERIOD
        parts = [maker.transform(stamp, POSES[k] + len(pair[1]), *pair) for pair in pairs]
        yield "/tf", stamp + 5, maker.tree(*parts)


@pytest.mark.parametrize("kind", KINDS)
def test_a_path_comes_from_transforms_of_the_robot(tmp_path, kind):
    path = read_path(write_bag(tmp_path, kind, trees))
    np.testing.assert_allclose(path.positions, POSES[:, :2] + len("base_link"), atol=1e-12)
    np.testing.assert_allclose(path.time, TIME, rtol=0, atol=1e-15)
    assert path.word == "message" and path.lines.tolist() == list(range(1, COUNT + 1))
    assert path.guesses[0] == "poses = /tf (TFMessage) from odom to base_link"


def test_frames_are_named_where_several_may_be_the_robot(tmp_path):
    pairs = (("map", "base_link"), ("odom", "base_link"))
    file = write_bag(tmp_path, "mcap", lambda maker: trees(maker, pairs))
    with pytest.raises(
        ValueError, match=r"map:base_link, odom:base_link; .*poses=/tf:map:base_link"
    ):
        read_path(file)
    path = read_path(file, Hints(topics={"poses": "/tf:odom:base_link"}))
    assert path.guesses[0].endswith("from odom to base_link")
    with pytest.raises(ValueError, match="/tf has no odom:laser among map:base_link"):
        read_path(file, Hints(topics={"poses": "/tf:odom:laser"}))


def test_measured_poses_are_told_from_wishes_and_odometry(tmp_path):
    def messages(maker):
        yield from drive(maker)
        for k in range(COUNT):
            stamp = START + k * PERIOD
            yield "/goal_pose", stamp, maker.pose_stamped(stamp, [9.0, 9.0, 0.0])
            yield "/vrpn/robot/pose", stamp, maker.pose_stamped(stamp, POSES[k])

    path = write_bag(tmp_path, "mcap", messages)
    log = read_log(path, Hints(wheel_radius_m=RADIUS))
    assert "poses = /vrpn/robot/pose (PoseStamped)" in log.guesses
    chosen = read_log(path, Hints(wheel_radius_m=RADIUS, topics={"poses": "icp_odom"}))
    np.testing.assert_allclose(chosen.pose_time, TIME + 1e-3, rtol=0, atol=1e-15)
    with pytest.raises(
        ValueError, match=r"poses=/cmd_vel: is of Twist; name one of PoseStamped or"
    ):
        read_log(path, Hints(wheel_radius_m=RADIUS, topics={"poses": "/cmd_vel"}))
    with pytest.raises(
        ValueError, match=r"poses=/none: there is no such topic .* of /cmd_vel \(Tw"
    ):
        read_log(path, Hints(wheel_radius_m=RADIUS, topics={"poses": "/none"}))


def test_topics_of_one_type_are_not_guessed_among(tmp_path):
    def messages(maker):
        yield from drive(maker)
        for topic, stamp, content in drive(maker, "/wheel_odom"):
            if topic in ("/wheel_odom", "/cmd_vel"):
                yield topic.replace("/cmd_vel", "/joy/cmd_vel"), stamp, content

    path = write_bag(tmp_path, "bag", messages)
    with pytest.raises(ValueError, match=r"2 topics may hold poses: /icp_odom .*poses=/icp_odom"):
        read_log(path, Hints(wheel_radius_m=RADIUS))
    hints = Hints(wheel_radius_m=RADIUS, topics={"poses": "/icp_odom"})
    log = read_log(path, hints)
    assert log.commands is None
    assert any("commands: none read, /cmd_vel (Twist), /joy/cmd_vel" in x for x in log.guesses)


def test_the_longest_plan_is_a_path_without_time(tmp_path):
    def messages(maker):
        for count in (2, COUNT, 3):
            poses = [maker.pose_stamped(0, [x, y, 0.0]) for x, y, _ in POSES[:count]]
            yield "/plan", START, maker.make("nav_msgs/msg/Path", maker.header(START), poses)

    path = read_path(write_bag(tmp_path, "mcap", messages))
    np.testing.assert_allclose(path.positions, POSES[:, :2], atol=1e-12)
    assert path.time is None and path.headings is None and path.word == "pose"


def test_poses_come_from_a_pose_file_beside_a_bag(tmp_path):
    path = write_bag(tmp_path, "mcap", drive)
    lines = []
    for k, (x, y, heading) in enumerate(POSES):
        stamp = f"{START // 10**9}.{START % 10**9 + k * PERIOD:09d}"
        turn = f"0 0 {np.sin(heading / 2.0)} {np.cos(heading / 2.0)}"
        lines.append(f"{stamp} {x} {y} 0 {turn}")
    (tmp_path / "poses.txt").write_text("\n".join(lines))
    log = read_log(path, Hints(wheel_radius_m=RADIUS, pose_file=tmp_path / "poses.txt"))
    np.testing.assert_allclose(log.pose_time, TIME, rtol=0, atol=1e-15)
    np.testing.assert_allclose(log.poses, POSES, atol=1e-12)


def test_broken_bags_are_refused_in_one_line(tmp_path):
    whole = write_bag(tmp_path, "bag", drive).read_bytes()
    (tmp_path / "half.bag").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "text.mcap").write_text("time,x,y\n0,1,2\n")
    (tmp_path / "folder").mkdir()
    for name in ("half.bag", "text.mcap", "folder"):
        with pytest.raises(ValueError, match=r"cannot be read as a bag .*; mend it with") as error:
            read_log(tmp_path / name)
        assert "\n" not in str(error.value)
    with pytest.raises(ValueError, match=r"none.bag: there is no such file; name a bag"):
        read_log(tmp_path / "none.bag")


def test_a_missing_library_is_refused_with_the_cure(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(ValueError, match=r"pip install 'jaxtube\[rosbag\]'"):
        read_log(Path(tmp_path) / "log.bag")
