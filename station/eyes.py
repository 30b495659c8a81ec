"""Opens all devices of a station, and looks at both gels all the time.

One thread reads the cameras in turn and follows the markers. It informs the guard and all listeners: trials, ROS
topics, recordings.
"""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from enum import StrEnum
from queue import SimpleQueue
from threading import Condition, Thread
from time import monotonic, sleep, time_ns
from typing import Final, NamedTuple, Self

from vitac.errors import VitacError

from .description import Procedure, Release, StationDescription, StationTask
from .devices.cameras import AnyDepthCamera, GelSightCamera, Picture, open_depth_camera
from .devices.force_torque import ForceTorqueSensor
from .devices.gripper import HandE
from .devices.stage import DeviceFault, GrblState, LinearStage, Pose
from .guard import Guard, StopCause
from .held_part import Beside, HeldPart
from .overview import Overview
from .perception.markers import DROPPED_PICTURES, AssignedMarkerTracker, MarkerFlow, MarkerTracker
from .perception.observation import DAMAGED_PART, Cells, find_changed_part, measure_brightness

_PICTURE_S: Final = 10.0
"""Longest wait for a pair of pictures."""

_LOOK_S: Final = 0.02
"""Time between two looks whether the stage moves."""

_FREE_S: Final = 60.0
"""Longest way out of a hole or a lock, in real time; twins have patience."""

_REST_S: Final = 0.2
"""Time between two pairs of pictures while nothing is to move."""

Tracker = MarkerTracker | AssignedMarkerTracker


class Finger(StrEnum):
    """A tactile sensor, by its finger."""

    LEFT = "left"
    RIGHT = "right"


class SensorReading(NamedTuple):
    """What both sensors show at one time.

    Attributes:
        left: its markers.
        right: the same.
        pictures: of both cameras.
        time_ns: when they were followed [ns since 1970].
    """

    left: MarkerFlow
    right: MarkerFlow
    pictures: tuple[Picture, Picture]
    time_ns: int

    def movement_px(self) -> tuple[float, float]:
        """Return the mean movement of the markers on the left and on the right gel."""
        return self.left.mean_movement_px(), self.right.mean_movement_px()

    def is_contact(self) -> bool:
        """Say whether one of the gels touches something, by the challenge's rule without depth."""
        return self.left.is_contact() or self.right.is_contact()

    def is_over_force(self) -> bool:
        """Say whether a marker of either gel has moved too far."""
        return self.left.is_over_force() or self.right.is_over_force()


def open_cameras(description: StationDescription, stack: ExitStack) -> tuple[GelSightCamera, GelSightCamera]:
    """Open both tactile cameras until the stack is closed.

    Raises:
        DeviceNotFound: a camera is missing.
    """
    left, right = (
        stack.enter_context(GelSightCamera(camera.serial_number, stream=camera.stream, patience=description.patience))
        for camera in (description.left, description.right)
    )
    return left, right


@dataclass(kw_only=True)
class Eyes:
    """Both tactile cameras of a station; use it in `with`.

    Attributes:
        left: opened.
        right: opened.
        guard: if there is one, it is stopped where a marker moves too far, a gel is damaged or a camera fails, and
            hears from here that the station is alive.
        make_tracker: one for each sensor.
        stops_on_movement: whether a marker that moves too far stops the station.
        rests: whether nobody commands a motion; then five pairs of pictures a second do, for guard and console.
        pictures: last ones of both cameras, and their time [ns since 1970]; None before the first.
    """

    left: GelSightCamera
    right: GelSightCamera
    guard: Guard | None = None
    make_tracker: Callable[[], Tracker] = AssignedMarkerTracker
    stops_on_movement: bool = True
    rests: bool = False
    pictures: tuple[tuple[Picture, Picture], int] | None = None
    _count: int = 0
    _again: frozenset[Finger] = frozenset()
    _sight: SensorReading | None = None
    _error: DeviceFault | None = None
    _is_over: bool = False
    _changed: Condition = field(default_factory=Condition)
    _listeners: list[SimpleQueue[SensorReading | DeviceFault]] = field(default_factory=list)
    _undamaged: dict[Finger, Cells] = field(default_factory=dict)

    def __enter__(self) -> Self:
        self._thread = Thread(target=self._look, name="eyes of the station", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._is_over = True
        self._thread.join()

    @property
    def latest(self) -> SensorReading | None:
        """What was seen last."""
        return self._sight

    @property
    def pairs(self) -> int:
        """Number of pairs of pictures so far."""
        return self._count

    def start_again(self) -> SensorReading:
        """Take the markers' present places for their references, and return what is seen then.

        Raises:
            DeviceFault: a camera failed.
        """
        self.restart_trackers(*Finger)
        return self.see()

    def restart_trackers(self, *sides: Finger) -> None:
        """Have the next pictures of these sides taken for references."""
        with self._changed:
            self._again |= frozenset(sides)
            self._sight = None

    def see(self) -> SensorReading:
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

    def wait(self, pictures: int) -> SensorReading:
        """Return what is seen after some more pictures."""
        for _ in range(max(pictures, 1)):
            sight = self.see()
        return sight

    def sights(self) -> Iterator[SensorReading]:
        """Yield everything that is seen from now on, including what arrives while the caller is busy.

        Raises:
            DeviceFault: while it is iterated, if a camera failed.
        """
        seen: SimpleQueue[SensorReading | DeviceFault] = SimpleQueue()
        with self._changed:
            self._listeners.append(seen)
            if self._error is not None:
                seen.put(self._error)
        return self._heard(seen)

    def _heard(self, seen: "SimpleQueue[SensorReading | DeviceFault]") -> Iterator[SensorReading]:
        try:
            while not isinstance(each := seen.get(), DeviceFault):
                yield each
            raise each
        finally:
            self._listeners.remove(seen)

    def _look(self) -> None:
        trackers = {side: self.make_tracker() for side in Finger}
        while not self._is_over:
            with self._changed:
                again, self._again = self._again, frozenset()
            for side in again:
                trackers[side].start_again()
                self._undamaged.pop(side, None)
            try:
                pictures = self.left.read(), self.right.read()
            except DeviceFault as error:
                self._fail(error)
                return
            self.pictures = pictures, time_ns()
            left, right = (trackers[side].see(picture) for side, picture in zip(Finger, pictures, strict=True))
            if self.guard is not None:
                self.guard.beat()
            if left is not None and right is not None:
                self._tell(SensorReading(left, right, pictures, time_ns()))
            if self.rests and self.guard is not None:
                sleep(min(_REST_S, self.guard.limits.heartbeat_s / 4))

    def _tell(self, sight: SensorReading) -> None:
        with self._changed:
            self._count += 1
            self._sight = None if self._again else sight
            self._changed.notify_all()
            for listener in self._listeners:
                listener.put(sight)
        if self.guard is not None:
            self._guard(self.guard, sight)

    def _guard(self, guard: Guard, sight: SensorReading) -> None:
        for side, picture in zip(Finger, sight.pictures, strict=True):
            cells = measure_brightness(picture)
            part = find_changed_part(self._undamaged.setdefault(side, cells), cells)
            if part > DAMAGED_PART:
                guard.stop(
                    f"The {side} gel is damaged or covered: {part:.0%} of its picture is darker or brighter by half "
                    "than when its tracker started.",
                    cause=StopCause.FAULT,
                )
        for flow in (sight.left, sight.right) if self.stops_on_movement else ():
            guard.see_markers(flow.current - flow.reference)

    def _fail(self, error: DeviceFault) -> None:
        if self.guard is not None:
            self.guard.stop(str(error), cause=StopCause.FAULT)
        with self._changed:
            self._error = error
            self._changed.notify_all()
            for listener in self._listeners:
                listener.put(error)


class NoProcedure(VitacError):
    """The station's file says nothing of trials; add `procedure` to it."""


def find_procedure(description: StationDescription) -> Procedure:
    """Return how trials are played on a station.

    Raises:
        NoProcedure: its file does not say it.
    """
    if description.procedure is None:
        raise NoProcedure(f"The file of {description.name} has no `procedure`: add where hole and garage are.")
    return description.procedure


@dataclass(kw_only=True)
class OpenStation:
    """A station whose guard and eyes are at work.

    Attributes:
        procedure: how trials are played on it.
        thresholds_px: movement of both gels that is more than noise, since the last grasp; None before it.
        held: where the gripper has closed on its part.
    """

    description: StationDescription
    procedure: Procedure
    stage: LinearStage
    gripper: HandE
    guard: Guard
    eyes: Eyes
    depth_camera: AnyDepthCamera | None = None
    overview: Overview | None = None
    thresholds_px: tuple[float, float] | None = None
    held: HeldPart = field(default_factory=HeldPart)


@contextmanager
def open_station(description: StationDescription, held: HeldPart | None = None) -> Iterator[OpenStation]:
    """Open the devices and watch them until the context ends.

    A stage in alarm is homed unless the gripper may hold a key in its lock, one that was held gives up its motion, and
    the force/torque sensor is zeroed if the gripper holds nothing: whoever calls this has made the station safe.

    Args:
        description: of the station.
        held: where the gripper has closed on its part; in the middle if None.

    Raises:
        DeviceNotFound: nothing answers at a device's address.
        DeviceFault: a device does not do what it is asked for.
        NoProcedure: the file has none.
    """
    procedure, held = find_procedure(description), held or HeldPart()
    with ExitStack() as stack:
        patience, at = description.patience, description.force_torque
        stage = stack.enter_context(LinearStage(description.stage.port, patience=patience))
        gripper = stack.enter_context(HandE(description.gripper.port, unit=description.gripper.unit, patience=patience))
        box = stack.enter_context(ForceTorqueSensor(at.host, at.port, patience=patience))
        # Before anybody would have to read pictures meanwhile.
        _make_ready(stage, gripper, box, description, held.beside_mm)
        left, right = open_cameras(description, stack)
        described = description.depth_camera
        depth_camera: AnyDepthCamera | None = open_depth_camera(described, patience=patience) if described else None
        if depth_camera is not None:
            stack.enter_context(depth_camera)
        guard = Guard(
            limits=description.limits,
            stage=stage,
            gripper=gripper,
            force_torque=box,
            picture_s=procedure.picture_s,
        )
        stack.enter_context(guard)
        eyes = stack.enter_context(Eyes(left=left, right=right, guard=guard))
        overview = Overview(description.overview, guard, patience) if description.overview else None
        if overview is not None:
            stack.enter_context(overview)
        yield OpenStation(
            description=description,
            procedure=procedure,
            stage=stage,
            gripper=gripper,
            guard=guard,
            eyes=eyes,
            depth_camera=depth_camera,
            overview=overview,
            held=held,
        )


def _free(stage: LinearStage, description: StationDescription, procedure: Procedure, beside_mm: Beside) -> None:
    """Take away what the gripper holds, where nobody is asked: pressed onto something it may pass a limit.

    The guard would then stop the station each time it is opened, and the trial of a killed agent would never be played.
    A peg goes straight up; a key down out of the slots, out of its lock to the garage in front of it, and up there.
    """
    pose, hole, garage = stage.status().pose, procedure.hole, procedure.garage
    if procedure.release is not Release.AUTOMATIC or pose.z_mm >= procedure.safe_z_mm:
        return
    way = [pose._replace(z_mm=procedure.safe_z_mm)]
    if procedure.task is StationTask.LOCK:
        x_mm, z_mm = garage.x_mm + beside_mm[0], hole.z_mm + beside_mm[1]
        before_lock = Pose(x_mm, garage.y_mm, z_mm, pose.rotation_deg)
        way = [pose._replace(z_mm=z_mm), before_lock, before_lock._replace(z_mm=procedure.safe_z_mm)]
    for target in way:
        stage.start_move(target, feed=60 * description.limits.speed_mm_s)
        end_s = monotonic() + description.patience * _FREE_S
        while stage.status().is_moving:
            if monotonic() > end_s:
                raise DeviceFault("The stage takes too long to come out. Look what holds it.")
            sleep(_LOOK_S)


def _free_locked(stage: LinearStage, description: StationDescription, procedure: Procedure, beside_mm: Beside) -> None:
    """Take a held key out of its lock and up before a stage in alarm is homed, which knows no way around a lock.

    Raises:
        DeviceFault: people are there to do it.
    """
    if procedure.task is not StationTask.LOCK:
        return
    if procedure.release is not Release.AUTOMATIC:
        raise DeviceFault(
            "The stage is in alarm and the gripper is closed. Homing would break a key in its lock, as it lifts it: "
            "open the gripper by hand, and put the key into its garage."
        )
    stage.unlock()
    _free(stage, description, procedure, beside_mm)


def _make_ready(
    stage: LinearStage, gripper: HandE, box: ForceTorqueSensor, description: StationDescription, beside_mm: Beside
) -> None:
    procedure, state = description.procedure, stage.status().state
    if state is GrblState.ALARM:
        if procedure is not None and gripper.status().position > procedure.open_position:
            _free_locked(stage, description, procedure, beside_mm)
        stage.home()
    elif state is GrblState.HOLD:
        stage.forget_motion()
    gripper.activate()
    if procedure is not None and gripper.status().position > procedure.open_position:
        _free(stage, description, procedure, beside_mm)
    elif procedure is not None:
        box.stop()
        box.zero()
    box.start(description.force_torque.rate_hz)
