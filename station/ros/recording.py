"""Recordings of the topics: a bag of ROS 1, or one of ROS 2 as MCAP."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from vitac.envs.errors import VitacError

from .messages import Message, RosVersion

Record = Callable[[Message, int], None]


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

        def record(message: Message, time_ns: int) -> None:
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
