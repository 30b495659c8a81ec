"""ROS 1 by Debian's `rospy`, imported from the packages of the system's Python."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from hashlib import md5
from importlib import import_module
from pathlib import Path
from typing import Any, Final

from ..eyes import Finger
from .messages import NODE, PACKAGE, QUEUE, RESET_FIELDS, RESET_SERVICES, RosMissing, RosVersion, TopicMessage

_SYSTEM_PACKAGES: Final = Path("/usr/lib/python3/dist-packages")
_DEBIAN_PACKAGES: Final = "python3-rospy python3-sensor-msgs"


class Ros1Node:
    """A node of this process at a running core; make one with `ros1_node`."""

    def __init__(self, rospy: Any) -> None:
        """Take the imported `rospy`, whose node is there."""
        self._rospy = rospy
        self._types = {topic: _class(name) for topic, name in RosVersion.ROS_1.topics().items()}
        self._publishers: dict[str, Any] = {}

    def advertise(self) -> None:
        """Announce all topics."""
        for topic, type_ in self._types.items():
            self._publishers[topic] = self._rospy.Publisher(topic, type_, queue_size=QUEUE)

    def publish(self, message: TopicMessage, time_ns: int) -> None:
        """Publish a message of a topic that `advertise` announced."""
        made = self._types[message.topic](**message.plain_fields())
        made.header.stamp = self._rospy.Time(time_ns // 10**9, time_ns % 10**9)
        made.header.frame_id = message.frame
        self._publishers[message.topic].publish(made)

    def serve_resets(self, reset: Callable[[Finger], None]) -> None:
        """Offer the service that starts a tracker again, for each side."""
        type_ = _reset_service()

        def answer(side: Finger, _: Any) -> Any:
            reset(side)
            return type_._response_class(success=True)

        for side, name in RESET_SERVICES.items():
            self._rospy.Service(name, type_, partial(answer, side))

    def call_reset(self, side: Finger) -> bool:
        """Start the tracker of a side again, wherever it runs; return what it answers."""
        self._rospy.wait_for_service(RESET_SERVICES[side])
        answer = self._rospy.ServiceProxy(RESET_SERVICES[side], _reset_service())(flag=True)
        return bool(answer.success)

    def listen(self, receive: Callable[[str, dict[str, Any]], None]) -> None:
        """Call a function in threads of rospy with topic and fields of each message that arrives."""
        for topic, type_ in self._types.items():
            self._rospy.Subscriber(topic, type_, partial(_deliver, receive, topic), queue_size=QUEUE)


@contextmanager
def ros1_node(name: str = NODE) -> Iterator[Ros1Node]:
    """Join the core at ROS_MASTER_URI; a process can do so once.

    Raises:
        RosMissing: `rospy` is not installed, or no core answers.
    """
    rospy = _import_system("rospy")
    master = _import_system("rosgraph").Master(name)
    try:
        master.getPid()
    except OSError as error:
        raise RosMissing(f"Expected a core of ROS 1 at {master.master_uri}, got none. Start one: roscore") from error
    rospy.init_node(name, anonymous=False, disable_signals=True)
    try:
        yield Ros1Node(rospy)
    finally:
        rospy.signal_shutdown("ended")


def _import_system(name: str) -> Any:
    """Import a package of the system's Python, behind all packages of this one."""
    if str(_SYSTEM_PACKAGES) not in sys.path:
        sys.path.append(str(_SYSTEM_PACKAGES))
    try:
        return import_module(name)
    except ImportError as error:
        raise RosMissing(f"Expected ROS 1. Install Debian's packages: apt-get install {_DEBIAN_PACKAGES}") from error


def _class(name: str) -> Any:
    """Return rospy's class of a type."""
    text, _ = RosVersion.ROS_1.types().generate_msgdef(name, ros_version=1)
    short = name.replace("/msg/", "/")
    return _import_system("genpy.dynamic").generate_dynamic(short, text)[short]


def _reset_service() -> Any:
    request, answer = RESET_FIELDS
    classes = {
        kind: _import_system("genpy.dynamic").generate_dynamic(f"{PACKAGE}/ResetMarkerTracker{kind}", text)
        for kind, text in {"Request": request, "Response": answer}.items()
    }
    (request_class,), (answer_class,) = classes["Request"].values(), classes["Response"].values()
    names = {
        "_type": f"{PACKAGE}/ResetMarkerTracker",
        "_md5sum": md5((request + answer).encode(), usedforsecurity=False).hexdigest(),
        "_request_class": request_class,
        "_response_class": answer_class,
    }
    return type("ResetMarkerTracker", (_import_system("rospy").service._Service,), names)


def _deliver(receive: Callable[[str, dict[str, Any]], None], topic: str, message: Any) -> None:
    names = (name for name in message.__slots__ if name != "header")
    receive(topic, {name: getattr(message, name) for name in names})
