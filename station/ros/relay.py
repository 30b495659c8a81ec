"""Publishes, records and hears what tactile sensors see; recordings are a bag of ROS 1, or one of ROS 2 as MCAP."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from itertools import islice
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from vitac.errors import VitacError

from ..description import StationDescription
from ..eyes import Eyes, Finger, SensorReading, open_cameras
from ..perception.markers import MarkerTracker
from .messages import NODE, RosVersion, TopicMessage, messages, read_flow
from .ros1 import Ros1Node, ros1_node
from .ros2 import Ros2Node, ros2_node

Record = Callable[[TopicMessage, int], None]


class RecordingExists(VitacError):
    """The place of a recording is taken; name a new file or folder."""


@contextmanager
def recording(path: Path) -> Iterator[Record]:
    """Give a function that records a message and its time [ns since 1970].

    Args:
        path: a file `NAME.bag` is a bag of ROS 1; any other name is a new folder, a bag of ROS 2 with an MCAP file.

    Raises:
        RecordingExists: something is there.
        RosMissing: `rosbags` is not installed.
    """
    if path.exists():
        raise RecordingExists(f"{path} exists. Expected the name of a new recording.")
    version = RosVersion.ROS_1 if path.suffix == ".bag" else RosVersion.ROS_2
    types = version.types()
    with _writer(path, version) as writer:
        connections = {
            topic: writer.add_connection(f"/{topic}", type_, typestore=types)
            for topic, type_ in version.topics().items()
        }
        encode = types.serialize_ros1 if version is RosVersion.ROS_1 else types.serialize_cdr
        numbers = dict.fromkeys(connections, 0)

        def record(message: TopicMessage, time_ns: int) -> None:
            type_ = connections[message.topic].msgtype
            header = _header(version, message.frame, numbers[message.topic], time_ns)
            numbers[message.topic] += 1
            made = types.types[type_](header=header, **message.fields)
            writer.write(connections[message.topic], time_ns, encode(made, type_))

        yield record


def _writer(path: Path, version: RosVersion) -> Any:
    from rosbags import rosbag1, rosbag2

    if version is RosVersion.ROS_1:
        return rosbag1.Writer(path)
    return rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin.MCAP)


def _header(version: RosVersion, frame: str, number: int, time_ns: int) -> Any:
    types = version.types().types
    stamp = types["builtin_interfaces/msg/Time"](sec=time_ns // 10**9, nanosec=time_ns % 10**9)
    count = {"seq": number} if version is RosVersion.ROS_1 else {}
    return types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame, **count)


def publish(
    description: StationDescription,
    version: RosVersion | None,
    record_to: Path | None = None,
    readings: int | None = None,
) -> Iterator[SensorReading]:
    """Yield what both sensors of a station show, by the challenge's tracker, after it was published and recorded.

    Args:
        description: the station.
        version: where to publish; None publishes nothing.
        record_to: see `recording`; None records nothing.
        readings: how many; None publishes until it is closed.

    Raises:
        DeviceNotFound, DeviceFault: a camera is missing or stopped.
        RosMissing, RecordingExists: as named.
    """
    with ExitStack() as stack:
        record = stack.enter_context(recording(record_to)) if record_to else None
        left, right = open_cameras(description, stack)
        eyes = stack.enter_context(Eyes(left=left, right=right, make_tracker=MarkerTracker))
        node = stack.enter_context(_node(version, NODE)) if version else None
        if node:
            node.advertise()
            node.serve_resets(eyes.restart_trackers)
        for sight in islice(eyes.sights(), readings):
            for message in messages(sight):
                if node:
                    node.publish(message, sight.time_ns)
                if record:
                    record(message, sight.time_ns)
            yield sight


def listen(version: RosVersion, reset: Finger | None = None) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield topic and fields of each message, whoever publishes it.

    Args:
        version: where to listen.
        reset: tracker to start again first.

    Raises:
        RosMissing: as named.
        TimeoutError: nobody offers the service of `reset`.
    """
    received: SimpleQueue[tuple[str, dict[str, Any]]] = SimpleQueue()
    with _node(version, "vitac_listener") as node:
        if reset is not None:
            node.call_reset(reset)
        node.listen(lambda topic, fields: received.put((topic, fields)))
        while True:
            yield received.get()


def summarize(fields: dict[str, Any]) -> dict[str, Any]:
    """Return in few words what a message holds: its markers without their places, its picture without pixels."""
    if "marker_x" in fields:
        flow = read_flow(fields)
        return {"markers": len(flow.current), "largest_movement_px": round(flow.largest_movement_px(), 3)}
    return {name: value for name, value in fields.items() if name != "data"}


def _node(version: RosVersion, name: str) -> AbstractContextManager[Ros1Node | Ros2Node]:
    return ros1_node(name) if version is RosVersion.ROS_1 else ros2_node()
