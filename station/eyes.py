"""Looks at both gels all the time: one thread reads the cameras in turn, follows the markers and feeds the guard."""

from collections.abc import Callable
from dataclasses import dataclass, field
from threading import Condition, Thread
from typing import Final, NamedTuple, Self

from .devices.device import DeviceFault
from .devices.tactile_camera import Picture, TactileCamera
from .guard import Guard
from .perception.assignment import AssignedMarkerTracker
from .perception.tracker import DROPPED_PICTURES, MarkerFlow, MarkerTracker

_PICTURE_S: Final = 10.0
"""Longest wait for a pair of pictures."""

Tracker = MarkerTracker | AssignedMarkerTracker


class Sight(NamedTuple):
    """What both sensors show at one time.

    Attributes:
        left: its markers.
        right: the same.
        pictures: of both cameras.
    """

    left: MarkerFlow
    right: MarkerFlow
    pictures: tuple[Picture, Picture]

    def movement_px(self) -> tuple[float, float]:
        """Return the mean movement of the markers on the left and on the right gel."""
        return self.left.mean_movement_px(), self.right.mean_movement_px()

    def is_over_force(self) -> bool:
        """Say whether a marker of either gel has moved too far."""
        return self.left.is_over_force() or self.right.is_over_force()


@dataclass(kw_only=True)
class Eyes:
    """Both tactile cameras of a station; use it in `with`.

    Attributes:
        left: opened.
        right: opened.
        guard: stops where a marker moves too far or a camera fails, and hears from here that the station is alive.
        make_tracker: one for each sensor.
        stops_on_movement: whether a marker that moves too far stops the station.
    """

    left: TactileCamera
    right: TactileCamera
    guard: Guard
    make_tracker: Callable[[], Tracker] = AssignedMarkerTracker
    stops_on_movement: bool = True
    _count: int = 0
    _restarts: int = 0
    _sight: Sight | None = None
    _error: DeviceFault | None = None
    _is_over: bool = False
    _changed: Condition = field(default_factory=Condition)

    def __enter__(self) -> Self:
        self._thread = Thread(target=self._look, name="eyes of the station", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._is_over = True
        self._thread.join()

    @property
    def latest(self) -> Sight | None:
        """What was seen last."""
        return self._sight

    def start_again(self) -> Sight:
        """Take the markers' present places for their references, and return what is seen then.

        Raises:
            DeviceFault: a camera failed.
        """
        with self._changed:
            self._restarts += 1
            self._sight = None
        return self.see()

    def see(self) -> Sight:
        """Return the next thing seen, or the first one after a start.

        Raises:
            DeviceFault: a camera failed.
        """
        with self._changed:
            number = self._count
            arrived = self._changed.wait_for(
                lambda: self._error is not None or (self._count > number and self._sight is not None),
                (DROPPED_PICTURES + 1) * _PICTURE_S,
            )
            if self._error is not None:
                raise self._error
            if not arrived or self._sight is None:
                raise DeviceFault("The tactile cameras sent no pictures. Check their USB cables.")
            return self._sight

    def wait(self, pictures: int) -> Sight:
        """Return what is seen after some more pictures."""
        for _ in range(max(pictures, 1)):
            sight = self.see()
        return sight

    def _look(self) -> None:
        trackers, restarts = (self.make_tracker(), self.make_tracker()), 0
        while not self._is_over:
            if restarts != self._restarts:
                restarts = self._restarts
                for tracker in trackers:
                    tracker.start_again()
            try:
                pictures = self.left.read(), self.right.read()
            except DeviceFault as error:
                self._fail(error)
                return
            left, right = (tracker.see(picture) for tracker, picture in zip(trackers, pictures, strict=True))
            self.guard.beat()
            if left is not None and right is not None:
                with self._changed:
                    self._count += 1
                    self._sight = Sight(left, right, pictures) if restarts == self._restarts else None
                    self._changed.notify_all()
                for flow in (left, right) if self.stops_on_movement else ():
                    self.guard.see_markers(flow.current - flow.reference)

    def _fail(self, error: DeviceFault) -> None:
        self.guard.stop(str(error), by_fault=True)
        with self._changed:
            self._error = error
            self._changed.notify_all()
