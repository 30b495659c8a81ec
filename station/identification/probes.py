"""The moves from which a station is identified, through the guard, and what was seen and felt at each."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from vitac.errors import VitacError

from ..arm import Arm, Offset
from ..devices.stage import Pose
from ..eyes import OpenStation, SensorReading
from ..perception.markers import MarkerFlow

Force = NDArray[np.float64]

LIGHT_FORCE: Final = 1
"""Of the gripper where the peg has to slip between the gels."""
_REST_PICTURES: Final = 10
_BESIDE_MM: Final = 4.5
"""Of the peg's middle from the hole's where it stands on the plate."""
_ABOVE_MM: Final = 2.5
_BELOW_MM: Final = 2.5
_IN_HOLE_MM: Final = 2.5
"""Beyond where plate, grasp and tilts of 1.5 degrees, over half the width of peg and plate, put the first contact."""
_TOUCH_N: Final = 0.6
_PRESS_N, _LIGHT_N = 14.0, 17.0
_SLOW_MM_S, _SEEKING_MM_S = 0.2, 0.5
"""Where friction is felt nothing slides fast, as friction may depend on the speed."""
_STEP_MM, _LIGHT_STEP_MM, _WALL_STEP_MM = 0.05, 0.15, 0.15
_PRESS_STEPS, _LIGHT_STEPS, _WALL_STEPS, _HOLDS = 14, 20, 3, 12
_HOLD_S: Final = 0.5
_FRAMES, _MOVING_FRAMES, _ZERO_FRAMES = 10, 2, 20
"""Of the force/torque sensor, at rest and on the way."""
_SLIDES_MM: Final = (0.2, 0.4, 0.6, 0.4, 0.2, 0.0)
"""Along the axis in which the gripper closes: there the gels give so little that the peg slips on the plate at once.
Ways there and back part friction from the plate's tilt."""
_TOWARDS_WALL_MM, _WALL_N = 6.0, 1.0
"""A tilted peg is up to 2.5 mm from a wall, and swings about the closing axis by up to 1.5 mm before it presses so."""
_TURN_DEG, _TURN_STEP_DEG, _TURN_NM = 14.0, 0.5, 0.05


class NothingFelt(VitacError):
    """A probe met nothing where plate or hole should be; correct hole and shape in the station's file."""


class ProbeKind(StrEnum):
    """What was done."""

    GRASP = "grasp"
    AIR = "air"
    PRESS = "press"
    HOLD = "hold"
    SLIDE = "slide"
    SIDE = "side"
    MIDDLE = "middle"
    WALL = "wall"
    TURN = "turn"
    LIGHT_GRASP = "light-grasp"
    LIGHT = "light"


class Sample(NamedTuple):
    """One moment of a probe, at rest.

    Attributes:
        probe: what was done.
        axes: of the stage, by its encoders [mm, deg].
        wrench: of the force/torque sensor since the last sample in free air [N, N m], shape [6].
        flows: of both gels since they were free.
        after_s: since the last hold began, by pictures [s].
    """

    probe: ProbeKind
    axes: Pose
    wrench: Force
    flows: tuple[MarkerFlow, MarkerFlow]
    after_s: float = 0.0


@dataclass(kw_only=True)
class Probing:
    """Everything that was seen and felt.

    Attributes:
        rest_px: markers of the left and the right gel while nothing touches them, each shape [n, 2] [pixel].
        samples: in their order.
    """

    rest_px: tuple[NDArray[np.float64], NDArray[np.float64]]
    samples: list[Sample] = field(default_factory=list)

    def of(self, *probes: ProbeKind) -> list[Sample]:
        """Return the samples of some probes."""
        return [sample for sample in self.samples if sample.probe in probes]


def play_probes(station: OpenStation, show: Callable[[ProbeKind], None] = lambda _: None) -> Probing:
    """Play all probes, and put the peg back into its garage.

    Args:
        station: open and safe, with the peg in its garage or in the gripper.
        show: called as each begins.

    Raises:
        NothingFelt: plate or hole are not where the file says.
        NoPeg: the gripper closes on nothing.
    """
    return _Prober(station, show).play()


class _Prober:
    def __init__(self, station: OpenStation, show: Callable[[ProbeKind], None]) -> None:
        self._station, self._arm, self._show = station, Arm(station), show
        self._zero: Force = np.zeros(6)
        self._began = 0
        self._probing = Probing(rest_px=(np.zeros((0, 2)), np.zeros((0, 2))))

    def play(self) -> Probing:
        show, arm = self._show, self._arm
        show(ProbeKind.GRASP)
        arm.open_in_garage()
        self._probing.rest_px = self._see_free_gels()
        arm.fetch()
        self._sample(ProbeKind.GRASP)
        show(ProbeKind.PRESS)
        self._go_above((_BESIDE_MM, 0.0, 0.0))
        self._press(ProbeKind.PRESS, _PRESS_STEPS, _STEP_MM, _PRESS_N)
        show(ProbeKind.HOLD)
        self._began = self._station.eyes.pairs
        for _ in range(_HOLDS):
            self._sample(ProbeKind.HOLD, wait_s=_HOLD_S)
        show(ProbeKind.SLIDE)
        pressed = arm.pose()
        for way_mm in _SLIDES_MM:
            self._go(pressed._replace(y_mm=pressed.y_mm + way_mm), ProbeKind.SLIDE, _SLOW_MM_S)
        show(ProbeKind.SIDE)
        for x_mm, y_mm in ((_BESIDE_MM, 0.0), (0.0, _BESIDE_MM), (-_BESIDE_MM, 0.0), (0.0, -_BESIDE_MM)):
            self._go_above((x_mm, y_mm, 0.0))
            self._descend()
            self._sample(ProbeKind.SIDE)
        show(ProbeKind.WALL)
        self._go_above((0.0, 0.0, 0.0))
        middle = arm.place((0.0, 0.0, 0.0), arm.height_mm(-_IN_HOLE_MM))
        self._go(middle, ProbeKind.MIDDLE)
        for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            self._push_wall(middle, x, y)
        show(ProbeKind.TURN)
        for sign in (1, -1):
            self._turn(middle, sign)
        show(ProbeKind.LIGHT)
        arm.lift(self._station.procedure.safe_z_mm)
        arm.fetch(LIGHT_FORCE)
        self._sample(ProbeKind.LIGHT_GRASP)
        self._go_above((_BESIDE_MM, 0.0, 0.0))
        self._press(ProbeKind.LIGHT, _LIGHT_STEPS, _LIGHT_STEP_MM, _LIGHT_N)
        arm.lift(self._station.procedure.safe_z_mm)
        arm.open_in_garage()
        return self._probing

    def _see_free_gels(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        eyes = self._station.eyes
        sights = [eyes.start_again() for _ in range(_REST_PICTURES)]
        left, right = ([sight.left.reference for sight in sights], [sight.right.reference for sight in sights])
        return _mean_markers(left), _mean_markers(right)

    def _go_above(self, offset: Offset) -> None:
        """Go over a place without touching the plate, and take what is felt there for nothing."""
        arm, procedure = self._arm, self._station.procedure
        arm.lift(arm.height_mm(procedure.lateral_mm))
        if arm.pose().z_mm > procedure.safe_z_mm - 1.0:
            arm.go(arm.place(offset, procedure.safe_z_mm))
        arm.go(arm.place(offset, arm.height_mm(procedure.lateral_mm)))
        arm.go(arm.place(offset, arm.height_mm(_ABOVE_MM)))
        arm.settle(_HOLD_S)
        self._zero = np.array(self._station.guard.measure_wrench(_ZERO_FRAMES))
        self._sample(ProbeKind.AIR)

    def _press(self, probe: ProbeKind, steps: int, step_mm: float, largest_n: float) -> None:
        touched = self._descend(_SLOW_MM_S)
        self._sample(probe)
        for step in range(1, steps + 1):
            felt = self._go(touched._replace(z_mm=touched.z_mm - step * step_mm), probe, _SLOW_MM_S)
            if felt[2] > largest_n:
                return

    def _descend(self, speed_mm_s: float = _SEEKING_MM_S) -> Pose:
        """Come down until the force sensor feels the plate."""
        lowest = self._arm.pose()._replace(z_mm=self._arm.height_mm(-_BELOW_MM))
        return self._go_until(lowest, lambda felt: felt[2] > _TOUCH_N, "plate", speed_mm_s)

    def _push_wall(self, middle: Pose, x: int, y: int) -> None:
        far = middle._replace(x_mm=middle.x_mm + x * _TOWARDS_WALL_MM, y_mm=middle.y_mm + y * _TOWARDS_WALL_MM)
        there = self._go_until(far, lambda felt: math.hypot(felt[0], felt[1]) > _WALL_N, "wall of the hole")
        for step in range(_WALL_STEPS):
            way_mm = step * _WALL_STEP_MM
            self._go(there._replace(x_mm=there.x_mm + x * way_mm, y_mm=there.y_mm + y * way_mm), ProbeKind.WALL)
        self._go(middle, ProbeKind.MIDDLE)

    def _turn(self, middle: Pose, sign: int) -> None:
        far = middle._replace(rotation_deg=middle.rotation_deg + sign * _TURN_DEG)
        there = self._go_until(far, lambda felt: abs(felt[5]) > _TURN_NM, "wall of the hole, turning")
        for step in range(_WALL_STEPS):
            self._go(there._replace(rotation_deg=there.rotation_deg + sign * step * _TURN_STEP_DEG), ProbeKind.TURN)
        self._go(middle, ProbeKind.MIDDLE)

    def _go_until(
        self, target: Pose, is_met: Callable[[Force], bool], name: str, speed_mm_s: float = _SEEKING_MM_S
    ) -> Pose:
        def found(_sight: SensorReading, _pose: Pose) -> bool:
            return bool(is_met(self._felt(_MOVING_FRAMES)))

        if self._arm.go_until(target, speed_mm_s, found) is None:
            raise NothingFelt(
                f"A probe felt no {name} on its way to {tuple(target)}. Correct hole and shape in the file."
            )
        return self._arm.pose()

    def _go(self, target: Pose, probe: ProbeKind, speed_mm_s: float | None = None) -> Force:
        self._arm.go(target, speed_mm_s)
        return self._sample(probe)

    def _felt(self, frames: int) -> Force:
        return np.array(self._station.guard.measure_wrench(frames)) - self._zero

    def _sample(self, probe: ProbeKind, wait_s: float = 0.1) -> Force:
        """Take a sample at rest, and return the force felt in it."""
        eyes = self._station.eyes
        sight = self._arm.settle(wait_s)
        first = eyes.pairs
        felt = self._felt(_FRAMES)
        # The force is a mean over the time of some pictures.
        after_s = (0.5 * (first + eyes.pairs) - self._began) * self._station.procedure.picture_s
        self._probing.samples.append(Sample(probe, self._arm.pose(), felt, (sight.left, sight.right), after_s))
        return felt


def _mean_markers(pictures: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return the mean places of markers that most pictures show, by the first of them."""
    first = pictures[0]
    by_marker: list[list[NDArray[np.float64]]] = [[] for _ in first]
    for markers in pictures:
        distances = np.linalg.norm(first[:, None] - markers[None], axis=2)
        for number, (nearest, distance) in enumerate(zip(distances.argmin(1), distances.min(1), strict=True)):
            if distance < 2.0:
                by_marker[number].append(markers[nearest])
    return np.array([np.mean(each, axis=0) for each in by_marker if 2 * len(each) > len(pictures)])
