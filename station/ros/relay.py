"""Publishes and records what a station's tactile sensors see, and listens to what others publish."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack
from itertools import islice
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from ..description import StationDescription
from ..eyes import Eyes, Side, Sight, open_cameras
from ..perception.tracker import MarkerTracker
from .messages import NODE, RosVersion, messages, read_flow
from .recording import recording
from .ros1 import Ros1Node, ros1_node
from .ros2 import Ros2Node, ros2_node


def publish(
    description: StationDescription,
    version: RosVersion | None,
    record_to: Path | None = None,
    readings: int | None = None,
) -> Iterator[Sight]:
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


def listen(version: RosVersion, reset: Side | None = None) -> Iterator[tuple[str, dict[str, Any]]]:
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
