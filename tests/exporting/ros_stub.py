"""A stub of what the node uses of rclpy and its messages: enough to run it without ROS."""

import sys
from types import ModuleType, SimpleNamespace
from typing import ClassVar

NANO = 1_000_000_000


class Stamp(SimpleNamespace):
    def __init__(self, nanoseconds: int = 0):
        super().__init__(sec=nanoseconds // NANO, nanosec=nanoseconds % NANO)


class Time:
    def __init__(self, nanoseconds: int):
        self.nanoseconds = nanoseconds

    def to_msg(self) -> Stamp:
        return Stamp(self.nanoseconds)


class Publisher:
    def __init__(self):
        self.messages = []

    def publish(self, message) -> None:
        self.messages.append(message)


class Node:
    """The base class of nodes; what it was asked for is kept for the test."""

    parameters: ClassVar[dict] = {}

    def __init__(self, name: str):
        self.name = name
        self.now = 0
        self.publishers = {}
        self.subscriptions = {}
        self.services = {}
        self.timers = []
        self.errors = []
        self._declared = {}

    def declare_parameter(self, name: str, default) -> None:
        self._declared[name] = self.parameters.get(name, default)

    def get_parameter(self, name: str) -> SimpleNamespace:
        return SimpleNamespace(value=self._declared[name])

    def create_publisher(self, kind, topic: str, depth: int) -> Publisher:
        self.publishers[topic] = Publisher()
        return self.publishers[topic]

    def create_subscription(self, kind, topic: str, callback, depth: int) -> None:
        self.subscriptions[topic] = callback

    def create_service(self, kind, name: str, callback) -> None:
        self.services[name] = callback

    def create_timer(self, period: float, callback) -> None:
        self.timers.append((period, callback))

    def get_clock(self) -> SimpleNamespace:
        return SimpleNamespace(now=lambda: Time(self.now))

    def get_logger(self) -> SimpleNamespace:
        return SimpleNamespace(error=self.errors.append)


def _twist() -> SimpleNamespace:
    def vector() -> SimpleNamespace:
        return SimpleNamespace(x=0.0, y=0.0, z=0.0)

    header = SimpleNamespace(stamp=None, frame_id="")
    return SimpleNamespace(header=header, twist=SimpleNamespace(linear=vector(), angular=vector()))


MODULES = {
    "rclpy": {},
    "rclpy.node": {"Node": Node},
    "geometry_msgs": {},
    "geometry_msgs.msg": {"PoseStamped": SimpleNamespace, "TwistStamped": _twist},
    "nav_msgs": {},
    "nav_msgs.msg": {"Path": SimpleNamespace},
    "std_msgs": {},
    "std_msgs.msg": {"Float64MultiArray": SimpleNamespace},
    "std_srvs": {},
    "std_srvs.srv": {"Trigger": SimpleNamespace},
    "diagnostic_msgs": {},
    "diagnostic_msgs.msg": {"DiagnosticStatus": SimpleNamespace, "KeyValue": SimpleNamespace},
}


def install(monkeypatch) -> None:
    """Put the stub where the node imports from."""
    for name, content in MODULES.items():
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)
