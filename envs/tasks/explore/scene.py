"""Scene of the exploring task: a block with an end of unknown shape, between two gels above a pin."""

from dataclasses import dataclass, field
from functools import lru_cache
from math import radians

import numpy as np

from ...assets import Meshes
from ...deterministic_math import sine_cosine
from ...fem.model.mesh import RigidBody, SurfaceMesh
from ...geometry.solid import Face, Polygon, as_polygon, prism_faces, rectangle, solid_from_faces
from ...scene.grasped_scene import Clocks, GraspedScene, PhysicsSettings, fixed_at_origin
from ...scene.gripper import UPRIGHT_MOUNTS, Gripper, GripperPose, ipc_steps
from ...scene.perspective import FloatArray
from ...tactile.gel import highest_mm
from ...tactile.markers import MarkerSettings
from ..settings import arena_physics, require
from .definition import LARGEST_XY_MM, TASK, EndShape

BLOCK_MM = rectangle(-20.0, 20.0, -15.0, 15.0)
GRIPPED_WIDTH_MM = 30.0
END_MM, BLOCK_TOP_MM = 10.0, 50.0
PIN_TOP_MM, PIN_RADIUS_MM, PIN_CORNERS = 20.0, 1.5, 12
GRIPPER_ABOVE_END_MM = 30.0

GRASP_GAP_MM = 0.1
LIFT_MM = 0.5
"""Height of the end above the pin while the gripper travels."""
PRESS_SPEED_M_S, TRAVEL_SPEED_M_S = 5e-3, 40e-3

_ARM_MM, _HALF_MM = 10.0, 3.0
_OUTLINES_MM: dict[EndShape, Polygon] = {
    EndShape.SQUARE: rectangle(-8.0, 8.0, -8.0, 8.0),
    EndShape.BAR: rectangle(-_ARM_MM, _ARM_MM, -_HALF_MM, _HALF_MM),
    EndShape.BEAM: rectangle(-_HALF_MM, _HALF_MM, -_ARM_MM, _ARM_MM),
    EndShape.CROSS: as_polygon(
        [
            (-_HALF_MM, -_ARM_MM),
            (_HALF_MM, -_ARM_MM),
            (_HALF_MM, -_HALF_MM),
            (_ARM_MM, -_HALF_MM),
            (_ARM_MM, _HALF_MM),
            (_HALF_MM, _HALF_MM),
            (_HALF_MM, _ARM_MM),
            (-_HALF_MM, _ARM_MM),
            (-_HALF_MM, _HALF_MM),
            (-_ARM_MM, _HALF_MM),
            (-_ARM_MM, -_HALF_MM),
            (-_HALF_MM, -_HALF_MM),
        ]
    ),
    EndShape.FRAME: rectangle(-8.0, 8.0, -8.0, 8.0),
    EndShape.CORNER: as_polygon(
        [
            (-_HALF_MM, -_HALF_MM),
            (_ARM_MM, -_HALF_MM),
            (_ARM_MM, _HALF_MM),
            (_HALF_MM, _HALF_MM),
            (_HALF_MM, _ARM_MM),
            (-_HALF_MM, _ARM_MM),
        ]
    ),
}
_OPENING_MM = rectangle(-5.0, 5.0, -5.0, 5.0)


@dataclass(frozen=True, kw_only=True)
class ExploreSettings:
    """What the task leaves open; lengths in mm and angles in degrees.

    Attributes:
        max_steps: env steps, the last of which gives the answer.
        action_scale: at an action of 1 the motion in x and y [mm], and the weights of the answer, which is 1.
        press_mm: how far a touch goes beyond the pin's upper end.
        indentation_mm: how far each gel is pressed into the block.
        random_xy_mm: largest |x| and |y| of a random place of the end on the block.
        random_angle_deg: largest angle of one.
        physics: materials of the gels and time stepping.
        markers: ranges of the marker grid.
    """

    max_steps: int = 6
    action_scale: tuple[float, ...] = TASK.action_scale
    press_mm: float = 0.3
    indentation_mm: float = 0.875
    random_xy_mm: float = 3.0
    random_angle_deg: float = 20.0
    physics: PhysicsSettings = field(default_factory=arena_physics)
    markers: MarkerSettings = field(default_factory=MarkerSettings)

    def __post_init__(self) -> None:
        require(self.max_steps >= 1, "max_steps", self.max_steps, "at least 1")
        motions, answers = self.action_scale[:2], self.action_scale[2:]
        usable = all(0 <= value <= 20 for value in motions) and answers == TASK.action_scale[2:]
        require(usable, "action_scale", self.action_scale, "two numbers of 0 to 20, then six times 1")
        require(0 < self.press_mm <= 1, "press_mm", self.press_mm, "0 to 1 mm")
        require(0 < self.indentation_mm <= 2, "indentation_mm", self.indentation_mm, "0 to 2 mm, half the gel")
        require(0 <= self.random_xy_mm <= 3, "random_xy_mm", self.random_xy_mm, "0 to 3 mm")
        require(0 <= self.random_angle_deg <= 30, "random_angle_deg", self.random_angle_deg, "0 to 30 degrees")


@dataclass(frozen=True, kw_only=True)
class EndPose:
    """Where the end is on the block."""

    x_mm: float
    y_mm: float
    angle_deg: float

    def place(self, outline_mm: Polygon) -> Polygon:
        """Return an outline turned, then moved [mm]."""
        sine, cosine = sine_cosine(radians(self.angle_deg))
        x, y = outline_mm.T
        return np.column_stack([cosine * x - sine * y + self.x_mm, sine * x + cosine * y + self.y_mm])


@dataclass(frozen=True, kw_only=True)
class ExploreStart:
    """Which end the block has, and where."""

    shape: EndShape
    end: EndPose


def block_mesh(shape: EndShape, pose: EndPose) -> SurfaceMesh:
    """Return the block with its end, whose lower face is z = 0; origin below the middle of the block."""
    outline_mm = pose.place(_OUTLINES_MM[shape])
    holes_mm = (pose.place(_OPENING_MM),) if shape is EndShape.FRAME else ()
    bottom, top, *walls = prism_faces(BLOCK_MM, END_MM, BLOCK_TOP_MM)
    end_bottom, end_top, *end_walls = prism_faces(outline_mm, 0.0, END_MM, holes_mm=holes_mm)
    around = Face(outline_mm=bottom.outline_mm, holes_mm=(end_top.outline_mm,))
    within = [Face(outline_mm=hole[::-1]) for hole in end_top.holes_mm]
    return solid_from_faces([around, top, *walls, end_bottom, *end_walls, *within], f"block with {shape}")


@lru_cache
def pin_mesh() -> SurfaceMesh:
    """Return the pin, which stands at the origin; its lower face is z = 0."""
    turns = [sine_cosine(radians(360.0 * corner / PIN_CORNERS)) for corner in range(PIN_CORNERS)]
    outline_mm = PIN_RADIUS_MM * np.array([(cosine, sine) for sine, cosine in turns])
    return solid_from_faces(prism_faces(outline_mm, 0.0, PIN_TOP_MM), "pin")


class ExploreScene:
    """The block, and the touches that the gripper makes with it.

    Attributes:
        shape: of the end.
        grasped: the physics, the gripper and its sensors.
        env_steps: played so far in the episode.
        confidences: of the last answer in the order of `EndShape`, shape [6]; all equal before the first.
    """

    def __init__(self, *, start: ExploreStart, meshes: Meshes, settings: ExploreSettings, clocks: Clocks) -> None:
        self.shape, self._end, self._settings = start.shape, start.end, settings
        self.env_steps = 0
        self.confidences = np.full(len(EndShape), 1.0 / len(EndShape))
        self._position_mm = np.zeros(2)
        lowest_mm = PIN_TOP_MM + LIFT_MM
        pose = GripperPose(
            x_m=0.0,
            y_m=0.0,
            z_m=(lowest_mm + GRIPPER_ABOVE_END_MM) * 1e-3,
            angle_rad=0.0,
            half_opening_m=(0.5 * GRIPPED_WIDTH_MM + highest_mm(meshes.gel()) + GRASP_GAP_MM) * 1e-3,
        )
        self.grasped = GraspedScene(
            gripper=Gripper(mounts=UPRIGHT_MOUNTS, gel=meshes.gel(), pose=pose),
            held=RigidBody(
                mesh=block_mesh(start.shape, start.end),
                rotation=np.eye(3),
                translation_m=np.array([0.0, 0.0, lowest_mm]) * 1e-3,
                density_kg_m3=settings.physics.rigid_density_kg_m3,
            ),
            fixed=fixed_at_origin(pin_mesh(), friction=1.0),
            physics=settings.physics,
            sensors=meshes.sensors(settings.markers),
            clocks=clocks,
        )

    def grasp(self) -> None:
        """Close on the block in free air, take the references, and touch the pin with the middle of the block."""
        closing_mm = GRASP_GAP_MM + self._settings.indentation_mm
        self._go(closing_mm, PRESS_SPEED_M_S, closing_m=closing_mm * 1e-3)
        self.grasped.capture_references()
        self._press(down=True)

    def move(self, command: FloatArray) -> None:
        """Take the answer of an action, lift the block, go where the action says, and touch the pin."""
        weights = 0.5 * (1.0 + np.clip(command[2:], -1.0, 1.0))
        total = weights.sum()
        self.confidences = weights / total if total > 0.0 else np.full(len(EndShape), 1.0 / len(EndShape))
        motion_mm = np.clip(command[:2], -1.0, 1.0) * np.array(self._settings.action_scale[:2])
        self._press(down=False)
        self._position_mm = self._position_mm + motion_mm
        x_mm, y_mm = motion_mm.tolist()
        self._go(float(np.abs(motion_mm).max()), TRAVEL_SPEED_M_S, x_m=x_mm * 1e-3, y_m=y_mm * 1e-3)
        self._press(down=True)

    def position_mm(self) -> FloatArray:
        """Return where the block is over the pin, x and y [mm], shape [2]."""
        return self._position_mm

    def has_left_range(self) -> bool:
        """Return whether the gripper is too far from the pin."""
        return bool((np.abs(self._position_mm) > LARGEST_XY_MM).any())

    def end_pose_mm_deg(self) -> FloatArray:
        """Return where the end is on the block: x, y and angle [mm, mm, deg], shape [3]."""
        return np.array([self._end.x_mm, self._end.y_mm, self._end.angle_deg])

    def brier_score(self) -> float:
        """Return the squared distance of the confidences from the truth, summed over the shapes."""
        truth = np.array([shape is self.shape for shape in EndShape], dtype=np.float64)
        return float(((self.confidences - truth) ** 2).sum())

    def is_right(self) -> bool:
        """Return whether the answer is most confident of the true shape, and of no other as much."""
        [*others, best] = np.argsort(self.confidences, kind="stable")
        return list(EndShape)[best] is self.shape and bool(self.confidences[others[-1]] < self.confidences[best])

    def _press(self, *, down: bool) -> None:
        distance_mm = LIFT_MM + self._settings.press_mm
        self._go(distance_mm, PRESS_SPEED_M_S, z_m=(-1e-3 if down else 1e-3) * distance_mm)

    def _go(self, distance_mm: float, speed_m_s: float, **motion_m: float) -> None:
        time_step_s = self._settings.physics.time_step_s
        count = ipc_steps(distance_mm * 1e-3, speed_per_s=speed_m_s, time_step_s=time_step_s)
        self.grasped.move_to(self.grasped.pose.moved(**motion_m), ipc_steps=count)
