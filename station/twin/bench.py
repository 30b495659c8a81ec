"""The twin's world: peg, gels, plate and faults, and a clock that advances with the pictures."""

import logging
from collections import deque
from dataclasses import dataclass, field
from math import dist, inf
from threading import Condition, Event, Lock, Thread
from time import monotonic
from typing import Final, Self

import numpy as np
from vitac.envs.assets import Meshes
from vitac.envs.vision.camera import Sight
from vitac.errors import VitacError

from ..description import StationTask, TwinClass, TwinMark
from .depth_pictures import DepthCameraTwin
from .force_torque import ForceTorqueTwin
from .gel_view import GelView, Picture
from .grasp import CUBOID_PEG, HOLE, Axes, HeldPeg, Mounted, Wrench, grip_harder, hold_peg, in_world
from .gripper import GripperTwin
from .hidden import FaultScript, HiddenSettings, TwinFault
from .pictures import CameraFault, CameraTwin
from .stage import StageFault, StageTwin
from .structure import FaultyWrench, twin_gel

_logger = logging.getLogger(__name__)

PEG_AT: Final = 180
"""Position of the gripper at which its gels meet the peg."""
GRIP_FORCE: Final = 50
"""Of the gripper's command at which it closes as far as the hidden indentation; less closes less far."""
_SETTLED_MM: Final = 1e-5
_NEAR_MM: Final = 3.0
"""From the garage: a gripper that closes on a key goes up to 2 mm beside it, along and in height."""
_LET_GO: Final = 5
"""Positions by which the gripper opens until the peg is free."""
_NOISE: Final = (0.05,) * 3 + (0.002,) * 3
"""Of forces [N] and torques [N m]."""
_TOUCH_N: Final = 0.3
_SPIKE_N: Final = 500.0
_READER_S: Final = 5.0
"""The clock waits no longer than this for a reader of pictures."""
_LOOK_S: Final = 0.02
_NO_WRENCH: Final[Wrench] = (0.0,) * 6


@dataclass
class Backlash:
    """An axis that follows with play, and loses a part of its way.

    Attributes:
        play_mm: when it turns round.
        lost: part of each way.
        stick_mm: way that its guide sticks for before it jumps after the drive.
        n_mm: stiffness against a force along it.
    """

    play_mm: float
    lost: float = 0.0
    stick_mm: float = 0.0
    n_mm: float = inf
    _at: float = 0.0
    _commanded: float = 0.0
    _lost_mm: float = 0.0
    _stuck_at: float = 0.0
    _given_mm: float = 0.0

    def follow(self, commanded: float, force_n: float = 0.0) -> float:
        """Return where the axis really is; half of the rest of what a force gives is given each time."""
        self._lost_mm += self.lost * (commanded - self._commanded)
        self._commanded = commanded
        half = 0.5 * self.play_mm
        self._at = min(max(self._at, commanded - half), commanded + half)
        if abs(self._at - self._stuck_at) > self.stick_mm:
            self._stuck_at = self._at
        more_mm = 0.5 * (force_n / self.n_mm - self._given_mm)
        if abs(more_mm) > _SETTLED_MM:
            self._given_mm += more_mm
        return self._stuck_at - self._lost_mm + self._given_mm

    def find_steps(self) -> None:
        """Count from the switch again, as homing does."""
        self._lost_mm = 0.0


@dataclass(kw_only=True)
class Bench:
    """The world of a twin; use it in `with`, which lets its time pass.

    Attributes:
        hidden: what it is really like.
        mounted: peg, and the plate or base with its hole.
        period_s: time between pictures.
        speed: how much faster than real time it may run; what the computer can do where None.
        script: what breaks.
        mark: what the station's file says of it.
        now_s: its time.
        contacts: how often the peg has touched the plate.
        begun: what has been broken so far.
    """

    hidden: HiddenSettings
    mounted: Mounted = CUBOID_PEG
    period_s: float = 0.04
    speed: float | None = 1.0
    script: FaultScript = field(default_factory=FaultScript)
    mark: TwinMark = field(default_factory=lambda: TwinMark(twin_class=TwinClass.A))
    now_s: float = 0.0
    contacts: int = 0
    begun: list[TwinFault] = field(default_factory=list)

    def __post_init__(self) -> None:
        structure = self.hidden.structure
        self._meshes = Meshes(gel=twin_gel(structure), is_arena=True)
        self.stage = StageTwin(clock=self.time_s)
        self.gripper = GripperTwin(clock=self.time_s, object_at=None)
        self.box = ForceTorqueTwin(wrench=self._measure_wrench)
        self.views = [
            GelView(self._meshes.gel(), sensor, structure, self.period_s)
            for sensor in (self.hidden.left, self.hidden.right)
        ]
        late = 1 + round(self.hidden.latency_s / self.period_s)
        self._seen: list[deque[Picture]] = [deque(maxlen=late) for _ in self.views]
        quality = structure.jpeg_quality
        self.cameras = [CameraTwin(picture=_Reader(self, side), period_s=1e-3, quality=quality) for side in range(2)]
        lost = self.hidden.lost_steps
        springs = structure.compliance
        self._axes = [
            Backlash(
                play_mm=self.hidden.backlash_mm,
                lost=part,
                stick_mm=springs.stick_mm if springs else 0.0,
                n_mm=springs.stage_n_mm if springs else inf,
            )
            for part in (lost, lost, 0.0)
        ]
        self._faulty_wrench = FaultyWrench(structure.wrench) if structure.wrench else None
        self.depth_camera = DepthCameraTwin(look=self.look) if self.mounted.task is StationTask.FUSION else None
        self.held: HeldPeg | None = None
        self._is_in_garage, self._is_touching = True, False
        self._wrench: Wrench = _NO_WRENCH
        self._waiting = list(self.script.faults)
        self._running: list[tuple[float, TwinFault]] = []
        self._generator = np.random.default_rng(self.hidden.left.seed + self.hidden.right.seed)
        self._number, self._taken = 0, [0, 0]
        self._changed, self._over, self._world = Condition(), Event(), Lock()
        # Kernels are loaded now: later, none of the twin's lines would answer meanwhile.
        self._garaged = self._hold(self.mounted.garage)
        self._look(self._garaged)
        self._garaged.wrench()
        self._garaged.look()
        self._let_go()

    def __enter__(self) -> Self:
        self.advance()
        self._thread = Thread(target=self._run, name="bench of the twin", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        with self._changed:
            self._changed.notify_all()
        self._thread.join()

    def time_s(self) -> float:
        """Return the time that its devices move by."""
        return self.now_s

    def take(self, side: int) -> Picture:
        """Return the next picture of a camera, as soon as there is one; none twice, however long the physics takes.

        Stations count time by pictures: an old one would show them the gels as they were before a motion.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._taken[side] < self._number or self._over.is_set())
            self._taken[side] = self._number
            self._changed.notify_all()
            return self._seen[side][0]

    def part_at(self) -> Axes | None:
        """Return where the gripper would hold the part that it holds, or that is in its garage; None where it fell."""
        if self.held is not None:
            return self.stage.axes()
        return self.mounted.garage if self._is_in_garage else None

    def look(self) -> Sight | None:
        """Return what the RGB-D camera sees: the peg in the gripper, or else in its garage; None without a camera."""
        with self._world:
            return (self.held or self._garaged).look()

    @property
    def is_whole(self) -> bool:
        """Whether nothing is broken."""
        return not self._running

    def begin(self, fault: TwinFault, for_s: float) -> None:
        """Break something for a while."""
        self._running.append((self.now_s + for_s, fault))
        self.begun.append(fault)
        _logger.info("%s begins at %.2f s", fault, self.now_s)
        left = self.cameras[0]
        match fault:
            case TwinFault.UNPLUGGED_CAMERA:
                left.faults.add(CameraFault.UNPLUGGED)
            case TwinFault.FROZEN_STREAM:
                left.faults.add(CameraFault.FROZEN)
            case TwinFault.STUCK_GRIPPER:
                self.gripper.stick()
            case TwinFault.STAGE_ALARM:
                self.stage.faults.add(StageFault.ALARM)
            case TwinFault.NETWORK_CUT:
                self.box.cut_for_a_while()
            case TwinFault.DROPPED_PEG:
                self._let_go()
            case TwinFault.TORN_GEL | TwinFault.FORCE_SPIKE:
                pass  # read where pictures and forces are made

    def mend(self, fault: TwinFault) -> None:
        """Mend what was broken; a person puts a dropped peg back."""
        _logger.info("%s ends at %.2f s", fault, self.now_s)
        for camera in self.cameras:
            camera.faults.clear()
        self.gripper.faults.clear()
        self.stage.faults.clear()
        self.box.faults.clear()
        self._is_in_garage = self._is_in_garage or self.held is None

    def _run(self) -> None:
        due_s = monotonic()
        while not self._over.is_set():
            due_s = max(due_s + self.period_s / (self.speed or np.inf), monotonic() - self.period_s)
            self._over.wait(max(due_s - monotonic(), 0.0) if any(self._readers()) else self.period_s)
            self._await_readers()
            self.advance()

    def _await_readers(self) -> None:
        """Wait until each reader has the last pictures; one that leaves says nothing, so look again and again."""
        end_s = monotonic() + _READER_S
        with self._changed:
            while not self._is_taken() and monotonic() < end_s:
                self._changed.wait(_LOOK_S)

    def _readers(self) -> list[bool]:
        return [bool(camera.streams) and not camera.faults for camera in self.cameras]

    def _is_taken(self) -> bool:
        taken = zip(self._readers(), self._taken, strict=True)
        return self._over.is_set() or all(number == self._number for is_read, number in taken if is_read)

    def advance(self) -> None:
        """Let one period pass and take both pictures."""
        self.now_s += self.period_s
        with self._world:
            self._move()
        self._break_and_mend()
        if self._number and not any(self._readers()):
            return
        is_torn = any(fault is TwinFault.TORN_GEL for _, fault in self._running)
        drift_px = self.hidden.drift_px_h * self.now_s / 3600.0
        torn = (is_torn, False)
        age_h = self.now_s / 3600.0
        pictures = [
            view.picture(drift_px=drift_px, is_torn=gone, age_h=age_h)
            for view, gone in zip(self.views, torn, strict=True)
        ]
        with self._changed:
            for seen, picture in zip(self._seen, pictures, strict=True):
                seen.append(picture)
            self._number += 1
            self._changed.notify_all()

    def _move(self) -> None:
        *linear, rotation_deg = self.stage.axes()
        x, y, z = (axis.follow(*each) for axis, *each in zip(self._axes, linear, self._wrench[:3], strict=True))
        if linear == [0.0, 0.0, 0.0]:
            for axis in self._axes:
                axis.find_steps()
        at = (x, y, z, rotation_deg)
        is_between = self.held is not None or (self._is_in_garage and self._is_near_garage(at))
        self.gripper.object_at = PEG_AT if is_between else None
        position = self.gripper.position()
        if self.held is None and is_between and position >= PEG_AT:
            self._grasp(at)
        elif self.held is not None and position < PEG_AT - _LET_GO:
            self._let_go()
            self._is_in_garage = self._is_near_garage(at)
        if self.held is not None:
            self._carry(self.held, at)

    def _is_near_garage(self, at: Axes) -> bool:
        return dist(at[:3], self.mounted.garage[:3]) < _NEAR_MM

    def _grasp(self, at: Axes) -> None:
        try:
            self.held = self._hold(at, self.gripper.force)
        except VitacError as error:
            _logger.warning("The twin's gripper could not close on the peg: %s", error)
        else:
            self._is_in_garage = False
            self._look(self.held)

    def _hold(self, at: Axes, force: int = GRIP_FORCE) -> HeldPeg:
        """Return the peg in the gripper, whose force says how far it closes."""
        hidden = grip_harder(self.hidden, force / GRIP_FORCE)
        return hold_peg(self.mounted, self._in_world(at), hidden, self._meshes, self.period_s)

    def _let_go(self) -> None:
        self.held, self._wrench, self._is_touching = None, _NO_WRENCH, False
        self.gripper.object_at = None
        for view in self.views:
            view.look_at_rest()

    def _carry(self, held: HeldPeg, at: Axes) -> None:
        if not held.follow(self._in_world(at)):
            return
        self._wrench = held.wrench()
        is_touching = dist(self._wrench[:3], (0.0, 0.0, 0.0)) > _TOUCH_N
        if is_touching and not self._is_touching:
            self.contacts += 1
        # The peg must be clear of the plate before it can touch it again.
        self._is_touching = is_touching or (self._is_touching and not self.mounted.is_clear(at))
        self._look(held)

    def _look(self, held: HeldPeg) -> None:
        body_m = held.scene.held_vertices_m(np.arange(len(held.scene.held_surface.vertices_m)))
        for side, view in enumerate(self.views):
            view.look(
                held.scene.gel_nodes_m(side), held.scene.sensor_pose(side), body_m, held.scene.held_surface.triangles
            )

    def _in_world(self, at: Axes) -> Axes:
        """Return where the stage really is, relative to the hole; the station's file has other values."""
        return in_world(at, HOLE, self.hidden)

    def _break_and_mend(self) -> None:
        for fault in [each for each in self._waiting if each.contact <= self.contacts]:
            self._waiting.remove(fault)
            self.begin(fault.fault, fault.for_s)
        over = [each for each in self._running if each[0] <= self.now_s]
        self._running = [each for each in self._running if each not in over]
        for _, each in over:
            self.mend(each)

    def _measure_wrench(self) -> Wrench:
        if any(fault is TwinFault.FORCE_SPIKE for _, fault in self._running):
            return (0.0, 0.0, _SPIKE_N, 0.0, 0.0, 0.0)
        wrench = np.array(self._wrench)
        if self._faulty_wrench is not None:
            wrench = self._faulty_wrench.show(wrench)
        x, y, z, turn_x, turn_y, turn_z = (wrench + self._generator.normal(0.0, _NOISE)).tolist()
        return x, y, z + self.hidden.force_drift_n_h * self.now_s / 3600.0, turn_x, turn_y, turn_z


@dataclass(frozen=True)
class _Reader:
    """Takes the pictures of one camera."""

    bench: Bench
    side: int

    def __call__(self) -> Picture:
        return self.bench.take(self.side)
