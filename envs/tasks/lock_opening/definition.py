"""The lock task as others need to know it: actions, observables and where its parts lie."""

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...observable import Observable
from ...scene.observables import CONTACT_FORCES, MEASURED_POSE, SURFACE_POINTS, marker_flow, played_shape
from ...vision.observables import RGB_IMAGES
from ..definition import ActionComponent, InfoView, Measure, TaskDefinition
from ..measures import SURFACE_DIFF
from ..quantities import TOUCH_QUANTITIES, Quantity, setting

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
    optional_observables=(RGB_IMAGES,),
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
    perspective="vitac.envs.tasks.lock_opening.perspective:PERSPECTIVE",
    guided_motion="vitac.envs.tasks.lock_opening.guided_motion:out_and_up",
    quantities=(
        *TOUCH_QUANTITIES,
        Quantity(
            name="gripper_x_mm",
            unit="mm",
            meaning="Grasp beside its nominal place on the handle",
            range=(-4.0, 4.0),
            nominal=0.0,
            two_sided=True,
            apply=setting("gripper_x_mm"),
        ),
        Quantity(
            name="gripper_z_mm",
            unit="mm",
            meaning="Grasp above its nominal place on the handle",
            range=(-4.0, 4.0),
            nominal=0.0,
            two_sided=True,
            apply=setting("gripper_z_mm"),
        ),
        Quantity(
            name="slot_clearance_mm",
            unit="mm",
            meaning="Clearance of the teeth in their slots per side",
            range=(0.1, 3.0),
            nominal=2.0,
            apply=setting("slot_clearance_mm"),
        ),
    ),
)
