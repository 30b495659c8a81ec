"""The lock task as others need to know it: actions, observables, goal, how it is drawn; light to import."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...observable import Observable
from ...scene.observables import CONTACT_FORCES, MEASURED_POSE, SURFACE_POINTS, marker_flow, played_shape
from ...scene.perspective import Beside, Perspective, Plane, ProgressPlot, SectionView, signed
from ..definition import (
    OPTIONAL_SENSORS,
    SURFACE_DIFF,
    ActionComponent,
    Flags,
    InfoView,
    Measure,
    TaskDefinition,
    surface_moved_too_far,
)
from ..quantities import TOUCH_QUANTITIES, Quantity, symmetric

FloatArray = NDArray[np.float64]


class HasLock(Protocol):
    """A scene with a key and a lock, whose corners and teeth are measured."""

    def tip_m(self) -> FloatArray:
        """Return the corners of the key's tip [m], shape (4, 3)."""

    def rear_slot_m(self) -> FloatArray:
        """Return the lower corners of the slot for the rear tooth [m], shape (4, 3)."""

    def front_slot_m(self) -> FloatArray:
        """Return the lower corners of the slot for the front tooth [m], shape (4, 3)."""

    def entrance_m(self) -> FloatArray:
        """Return the corners of the lock's entrance face [m], shape (4, 3)."""

    def rear_tooth_from_slot(self) -> FloatArray:
        """Return where the rear tooth is from its slot [5 mm], shape (3,)."""

    def front_tooth_from_slot(self) -> FloatArray:
        """Return where the front tooth is from its slot [5 mm], shape (3,)."""

    def relative_motion_mm(self) -> FloatArray:
        """Return the commanded motion of the gripper since the start [mm], shape (3,)."""


def _corners(name: str, meaning: str, read: Callable[[HasLock], FloatArray]) -> Observable[HasLock]:
    return Observable(
        name=name, shape=(4, 3), unit="m", meaning=meaning, read=lambda scene, _: read(scene), privileged=True
    )


def _tooth(name: str, meaning: str, read: Callable[[HasLock], FloatArray]) -> Observable[HasLock]:
    return Observable(
        name=name, shape=(3,), unit="5 mm", meaning=meaning, read=lambda scene, _: read(scene), privileged=True
    )


def _lowest_corners_mm(info: InfoView) -> tuple[float, ...]:
    """Return the height of the lowest top corner of the rear and of the front measured tooth."""
    return tuple(1000 * min(z for _, _, z in info[key]) for key in ("key1_pts_m", "key2_pts_m"))


RELATIVE_MOTION: Observable[HasLock] = Observable(
    name="relative_motion",
    shape=(3,),
    unit="mm",
    meaning="Commanded gripper motion [dx, dy, dz] since the start; world frame, x out of the lock, z up.",
    read=lambda scene, _: scene.relative_motion_mm(),
)

GRIP_QUANTITIES = GRIPPER_X, GRIPPER_Z = (
    symmetric(name="gripper_x_mm", unit="mm", meaning="Grasp beside its nominal place on the handle", largest=4.0),
    symmetric(name="gripper_z_mm", unit="mm", meaning="Grasp above its nominal place on the handle", largest=4.0),
)

SLOT_CLEARANCE = Quantity(
    name="slot_clearance_mm",
    unit="mm",
    meaning="Clearance of the teeth in their slots per side",
    range=(0.1, 3.0),
    nominal=2.0,
)

TASK = TaskDefinition(
    env_id="ViTac/LockOpening-v1",
    environment="vitac.envs.tasks.lock_opening.env:LockOpeningEnv",
    actions=(
        ActionComponent(
            name="x",
            scale=2.0,
            unit="mm",
            meaning=(
                "Gripper motion into the lock, along -x; negative values pull the key out. Both components are moved "
                "together."
            ),
        ),
        ActionComponent(name="z", scale=1.0, unit="mm", meaning="Gripper motion down; negative values lift the key."),
    ),
    observables=(
        _corners("key_side_pts", "Corners of the key's tip.", lambda scene: scene.tip_m()),
        _corners("lock1_pts", "Lower corners of the slot for the key's rear tooth.", lambda scene: scene.rear_slot_m()),
        _corners("lock2_pts", "Lower corners of the slot for the front tooth.", lambda scene: scene.front_slot_m()),
        _corners("lock_side_pts", "Corners of the lock's entrance face.", lambda scene: scene.entrance_m()),
        _tooth(
            "key1",
            "Rear tooth from its slot: x, y, and height above the ceiling.",
            lambda scene: scene.rear_tooth_from_slot(),
        ),
        _tooth("key2", "Front tooth from its slot, as key1.", lambda scene: scene.front_tooth_from_slot()),
        RELATIVE_MOTION,
        marker_flow(
            "The left sensor is at -y. u+ is into the lock for both sensors; v+ is up for the left and down for the "
            "right one."
        ),
        played_shape("key1, key2, key3, key4"),
        MEASURED_POSE,
        CONTACT_FORCES,
        SURFACE_POINTS,
    ),
    optional_observables=OPTIONAL_SENSORS,
    measures=(
        SURFACE_DIFF,
        Measure(
            name="tooth_z_mm",
            label="teeth",
            meaning="height of the key's lowest corners",
            unit="mm",
            needs=("key1_pts_m", "key2_pts_m"),
            read=_lowest_corners_mm,
        ),
    ),
    perspective="vitac.envs.tasks.lock_opening.definition:PERSPECTIVE",
    guided_motion="vitac.envs.tasks.lock_opening.env:out_and_up",
    quantities=(*TOUCH_QUANTITIES, *GRIP_QUANTITIES, SLOT_CLEARANCE),
)


LARGEST_Y_M = 10e-3
Z_RANGE_M = (15e-3, 45e-3)
LARGEST_X_M = 110e-3
SUCCESS_Y_M = 2e-3
SUCCESS_Z_RANGE_M = (33e-3, 40e-3)
# Height the teeth are to have: in their slots once both are inside the lock, at the channel's ceiling before.
LIFTED_Z_M = 0.037
CEILING_Z_M = 0.030
_ERROR_PER_M = 500.0
_SURFACE_PENALTY_RANGE_MM = (0.2, 1.5)


@dataclass(frozen=True, kw_only=True, eq=False)
class LockState:
    """What an env step is judged by; points in the world, each of shape [4, 3] [m].

    Attributes:
        env_steps: played so far, this one included.
        rear_tooth_m: top corners of the key's rear measured tooth.
        front_tooth_m: top corners of the front measured tooth.
        rear_slot_m: lower corners of the slot for the rear tooth.
        front_slot_m: lower corners of the slot for the front tooth.
        entrance_m: corners of the lock's entrance face.
        surface_diff_m: of the left and the right sensor [m], shape [2].
    """

    env_steps: int
    rear_tooth_m: FloatArray
    front_tooth_m: FloatArray
    rear_slot_m: FloatArray
    front_slot_m: FloatArray
    entrance_m: FloatArray
    surface_diff_m: FloatArray

    @property
    def is_inside(self) -> bool:
        """Whether both teeth are behind the lock's entrance."""
        entrance_x_m = mean_corner(self.entrance_m)[0]
        return all(tooth[:, 0].max() < entrance_x_m for tooth in (self.rear_tooth_m, self.front_tooth_m))

    @property
    def teeth_and_slots(self) -> tuple[tuple[FloatArray, FloatArray], ...]:
        """Both teeth, each with its slot."""
        return (self.rear_tooth_m, self.rear_slot_m), (self.front_tooth_m, self.front_slot_m)


def judge_flags(
    state: LockState, *, max_steps: int, success_z_range_m: tuple[float, float] = SUCCESS_Z_RANGE_M
) -> Flags:
    """Return the flags of an env step; success with all top corners of the teeth within a range of height [m].

    Success means that both teeth stand in absolute windows, not that each is aligned with its slot (as published); it
    asks for no flag. No angle is tested.
    """
    teeth = (state.rear_tooth_m, state.front_tooth_m)
    return Flags(
        tactile_movement_too_large=surface_moved_too_far(state.surface_diff_m),
        error_too_large=any(_out_of_range(tooth) for tooth in teeth),
        too_many_steps=state.env_steps >= max_steps,
        is_success=all(
            _lifted(tooth, entrance_x_m=mean_corner(state.entrance_m)[0], z_range_m=success_z_range_m)
            for tooth in teeth
        ),
    )


def alignment_error(state: LockState) -> float:
    """Return the error e of the reward: 500 per metre of distance of both teeth from where they should be."""
    goal_z_m = LIFTED_Z_M if state.is_inside else CEILING_Z_M
    return _ERROR_PER_M * sum(_distance_m(tooth, slot, goal_z_m) for tooth, slot in state.teeth_and_slots)


def reward(
    flags: Flags,
    surface_diff_m: FloatArray,
    *,
    progress: float,
    step_penalty: float,
    final_reward: float,
    failure_penalty: float,
) -> float:
    """Return the reward of an env step: progress, less penalty and both surfaces' motion, plus the end's part."""
    final = 0.0
    if flags.is_success:
        final = final_reward
    elif flags.has_failed:
        final = -failure_penalty
    left, right = np.clip(surface_diff_m * 1e3, *_SURFACE_PENALTY_RANGE_MM).tolist()
    return float(-step_penalty + progress - (left + right) + final)


def _out_of_range(tooth_m: FloatArray) -> bool:
    x, y, z = mean_corner(tooth_m)
    low, high = Z_RANGE_M
    return abs(y) > LARGEST_Y_M or z > high or z < low or x > LARGEST_X_M


def _lifted(tooth_m: FloatArray, *, entrance_x_m: float, z_range_m: tuple[float, float]) -> bool:
    x, z = tooth_m[:, 0], tooth_m[:, 2]
    low, high = z_range_m
    inside = x.max() < entrance_x_m and x.min() > 0.0 and abs(mean_corner(tooth_m)[1]) < SUCCESS_Y_M
    return bool(inside and z.min() > low and z.max() < high)


def _distance_m(tooth_m: FloatArray, slot_m: FloatArray, goal_z_m: float) -> float:
    x, y, z = mean_corner(tooth_m)
    return abs(x - mean_corner(slot_m)[0]) + abs(goal_z_m - z) + abs(y)


def mean_corner(points_m: FloatArray) -> tuple[float, float, float]:
    """Return the middle of four corners [m]."""
    x, y, z = (points_m[0] + points_m[1] + points_m[2] + points_m[3]).tolist()
    return x / 4.0, y / 4.0, z / 4.0


_MIDDLE = Plane(normal=(0.0, -1.0, 0.0), offset_m=0.0)


def _position(info: InfoView) -> str:
    rear, slot = info["key1_pts_m"], info["lock1_pts_m"]
    x_mm = 1e3 * (rear[:, 0].mean() - slot[:, 0].mean())
    z_mm = 1e3 * (rear[:, 2].mean() - CEILING_Z_M)
    return f"rear tooth from its slot x {signed(x_mm)} mm, z {signed(z_mm)} mm"


def heights_mm(info: InfoView) -> FloatArray:
    """Return the heights of the top corners of both teeth above the ceiling [mm], shape [8]."""
    teeth = np.concatenate([info["key1_pts_m"], info["key2_pts_m"]])
    return np.asarray(1e3 * (teeth[:, 2] - CEILING_Z_M))


PERSPECTIVE = Perspective(
    held_name="key",
    fixed_name="lock, cut open",
    azimuth_deg=-58.0,
    elevation_deg=24.0,
    gel_labels=(Beside.BELOW, Beside.ABOVE),
    cut=_MIDDLE,
    section=SectionView(
        title="key in the lock from the side",
        held_cut=_MIDDLE,
        fixed_cut=_MIDDLE,
        axes=((0, "x"), (2, "z")),
        limits_mm=((-4.0, 68.0), (-6.0, 48.0)),
    ),
    progress=ProgressPlot(
        title="teeth above ceiling [mm]",
        heights_mm=heights_mm,
        goal_mm=1e3 * (SUCCESS_Z_RANGE_M[0] - CEILING_Z_M),
        goal_is_below=False,
    ),
    position=_position,
    arrival="opened the lock",
)
