"""What both tactile sensors see: the pictures, and the markers that a tracker follows in them."""

from collections.abc import Iterator
from contextlib import ExitStack
from enum import StrEnum
from time import time_ns
from typing import NamedTuple

from ..description import StationDescription
from ..devices.tactile_camera import TactileCamera
from ..perception.markers import Picture, cut_picture
from ..perception.tracker import MarkerFlow, MarkerTracker


class Side(StrEnum):
    """A tactile sensor, by its finger."""

    LEFT = "left"
    RIGHT = "right"


class Touch(NamedTuple):
    """What one sensor sees.

    Attributes:
        picture: cut as the tracker cuts it, shape [240, 320, 3], blue first.
        flow: its markers.
    """

    picture: Picture
    flow: MarkerFlow


class Reading(NamedTuple):
    """What both sensors see at an instant [ns since 1970]."""

    time_ns: int
    touch: dict[Side, Touch]

    def is_contact(self) -> bool:
        """Say whether one of the gels touches something, by the challenge's rule without depth."""
        return any(each.flow.is_contact() for each in self.touch.values())

    def is_over_force(self) -> bool:
        """Say whether one of the gels is pressed too hard, by the same rule."""
        return any(each.flow.is_over_force() for each in self.touch.values())


class TactileSensors:
    """The cameras of both sensors with a tracker each; use it in `with`.

    Attributes:
        trackers: start again where the challenge's reset service is called.
    """

    def __init__(self, description: StationDescription) -> None:
        """Describe the cameras; they are opened by `with`."""
        self._cameras = {Side.LEFT: description.left, Side.RIGHT: description.right}
        self._open: dict[Side, TactileCamera] = {}
        self._stack = ExitStack()
        self.trackers = {side: MarkerTracker() for side in Side}

    def __enter__(self) -> "TactileSensors":
        with ExitStack() as stack:
            for side, camera in self._cameras.items():
                self._open[side] = stack.enter_context(TactileCamera(camera.serial_number, stream=camera.stream))
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def readings(self) -> Iterator[Reading]:
        """Yield a reading for each pair of pictures, without the first ones, which a tracker drops.

        Raises:
            DeviceFault: a camera stopped sending.
        """
        while True:
            touch = {}
            for side, camera in self._open.items():
                picture = camera.read()
                flow = self.trackers[side].see(picture)
                if flow is not None:
                    touch[side] = Touch(cut_picture(picture), flow)
            if len(touch) == len(Side):
                yield Reading(time_ns(), touch)
