"""The topics, service and messages of the challenge's tracker, for ROS 1, ROS 2 and recordings.

Each type is stated once, as its ROS 1 file; `rosbags` translates it, with the standard types that it names.
"""

from collections.abc import Iterator
from enum import Enum
from functools import cache
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from vitac.envs.extras import explain_missing
from vitac.errors import VitacError

from ..eyes import Finger, SensorReading
from ..perception.markers import MarkerFlow, Picture, cut_picture

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

PACKAGE: Final = "gelsight_mini_ros"
NODE: Final = "Marker_Tracking"
QUEUE: Final = 50
RESET_FIELDS: Final = ("bool flag", "bool success")
"""Request and answer of the service that starts a tracker again."""
FRAME: Final = {Finger.LEFT: "tactile_left", Finger.RIGHT: "tactile_right"}
CONTACT_TOPIC: Final = "Marker_Tracking_Contact"
TRACKING_TOPICS: Final = {Finger.LEFT: "Marker_Tracking_Left", Finger.RIGHT: "Marker_Tracking_Right"}
PICTURE_TOPICS: Final = {Finger.LEFT: "Tactile_Image_Left", Finger.RIGHT: "Tactile_Image_Right"}
RESET_SERVICES: Final = {Finger.LEFT: "Marker_Tracking_Srv_Left", Finger.RIGHT: "Marker_Tracking_Srv_Right"}
_COLUMNS: Final = ("marker_x", "marker_y", "marker_displacement_x", "marker_displacement_y")
_OURS: Final = {
    "tracking_msg": """std_msgs/Header header
float32[] marker_x
float32[] marker_y
float32[] marker_displacement_x
float32[] marker_displacement_y
""",
    "judging_msg": """std_msgs/Header header
bool is_contact
bool is_overforced
""",
}


class RosMissing(VitacError):
    """A package that speaks ROS is not installed; the message says how to install it."""


class RosVersion(Enum):
    """A generation of ROS: the names of the challenge's types in it, and which standard types it has."""

    ROS_1 = 1
    ROS_2 = 2

    @cache
    def types(self) -> "Typestore":
        """Return all types of the topics, as `rosbags` knows them."""
        try:
            from rosbags.typesys import Stores, get_types_from_msg, get_typestore
        except ImportError as error:
            raise RosMissing(explain_missing("rosbags", "station", "ROS")) from error
        store = get_typestore(Stores.ROS1_NOETIC if self is RosVersion.ROS_1 else Stores.ROS2_HUMBLE)
        for name, text in _OURS.items():
            store.register(get_types_from_msg(text, self._name(name)))
        return store

    def _name(self, name: str) -> str:
        """Return the full name of one of our types. Those of ROS 2 have no underscores."""
        own = name if self is RosVersion.ROS_1 else name.title().replace("_", "")
        return f"{PACKAGE}/msg/{own}"

    def topics(self) -> dict[str, str]:
        """Return the type of each topic."""
        tracking, judging = map(self._name, _OURS)
        return {
            **dict.fromkeys(TRACKING_TOPICS.values(), tracking),
            CONTACT_TOPIC: judging,
            **dict.fromkeys(PICTURE_TOPICS.values(), "sensor_msgs/msg/Image"),
        }


class TopicMessage(NamedTuple):
    """A message of a topic, without its header.

    Attributes:
        frame: what its header names.
        fields: plain numbers, texts and arrays, by the names of the type.
    """

    topic: str
    frame: str
    fields: dict[str, Any]

    def plain_fields(self) -> dict[str, Any]:
        """Return the fields with bytes in place of a picture, and lists in place of other arrays."""
        return {name: _plain(value) for name, value in self.fields.items()}


def messages(sight: SensorReading) -> Iterator[TopicMessage]:
    """Yield what is published of a sight: markers and picture of each side, then whether something is touched."""
    for side, flow, picture in zip(Finger, (sight.left, sight.right), sight.pictures, strict=True):
        yield TopicMessage(TRACKING_TOPICS[side], FRAME[side], _tracking_fields(flow))
        yield TopicMessage(PICTURE_TOPICS[side], FRAME[side], _picture_fields(cut_picture(picture)))
    fields = {"is_contact": sight.is_contact(), "is_overforced": sight.is_over_force()}
    yield TopicMessage(CONTACT_TOPIC, "tactile", fields)


def read_flow(fields: dict[str, Any]) -> MarkerFlow:
    """Return the markers that a message of a tracking topic holds."""
    columns = [np.asarray(fields[name], dtype=np.float64) for name in _COLUMNS]
    reference = np.stack(columns[:2], axis=1)
    return MarkerFlow(reference, reference + np.stack(columns[2:], axis=1))


def _tracking_fields(flow: MarkerFlow) -> dict[str, NDArray[np.float32]]:
    columns = np.concatenate((flow.reference, flow.current - flow.reference), axis=1).T
    return dict(zip(_COLUMNS, np.ascontiguousarray(columns, dtype=np.float32), strict=True))


def _picture_fields(picture: Picture) -> dict[str, Any]:
    height, width, colours = picture.shape
    return {
        "height": height,
        "width": width,
        "encoding": "bgr8",
        "is_bigendian": 0,
        "step": width * colours,
        "data": np.ascontiguousarray(picture).reshape(-1),
    }


def _plain(value: Any) -> Any:
    if not isinstance(value, np.ndarray):
        return value
    return value.tobytes() if value.dtype == np.uint8 else value.tolist()
