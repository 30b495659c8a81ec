"""`ViTac/Explore-v1`: find by touch which of six ends a held block has.

First its scene: a block with an end of unknown shape, between two gels above a pin.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from math import radians
from typing import Any, ClassVar

import numpy as np

from ...assets import Meshes
from ...deterministic_math import sine_cosine
from ...fem.model.mesh import RigidBody, SurfaceMesh
from ...geometry.solid import Face, Polygon, as_polygon, prism_faces, rectangle, solid_from_faces
from ...scene.grasped_scene import Clocks, GraspedScene, PhysicsSettings, fixed_at_origin
from ...scene.gripper import UPRIGHT_MOUNTS, Gripper, GripperPose, ipc_steps
from ...scene.perspective import ActionArray, FloatArray
from ...tactile.gel import highest_mm
from ...tactile.markers import MarkerSettings
from ..definition import Flags, surface_moved_too_far
from ..settings import SHAPE, arena_physics, choice, choose_shape, either_way, numbers, require
from ..task_env import Info, Observation, TactileTaskEnv
from .definition import LARGEST_XY_MM, REACH_MM, TASK, EndShape

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


END_POSE = "end_pose_mm_deg"
LARGEST_MM_DEG = (3.0, 3.0, 30.0)
AROUND_MM = ((6.5, 0.0), (6.5, 6.5), (0.0, 6.5), (-6.5, 0.0), (0.0, -6.5))
"""Where the touches of `touch_around` are after the first, from the pin."""


class ExploreEnv(TactileTaskEnv[ExploreScene, ExploreSettings]):
    """Find by touch which of six ends a held block has, and say how certain you are.

    A block hangs between two gels above a pin of 3 mm. Below it is an end, 10 mm high: a square, a bar, a bar across,
    a cross, a frame or a corner, not quite in the middle of the block and not quite straight, which the policy is not
    told. Every env step lifts the block, moves it as the action says, and brings it down on the pin by 0.3 mm more than
    the gap. Where the end is above the pin, the gels feel it; where it is not, nothing touches. The reset makes the
    first touch, with the middle of the block. Actions outside -1 to 1 are clipped.

    World frame: z up, origin below the pin. Contacts are those of `arena-2`.

    The last six numbers of an action are the answer so far. That of the last env step counts: its Brier score is the
    squared distance of the confidences from the truth.

    Reset options: `shape` ("square", "bar", "beam", "cross", "frame", "corner"), `end_pose_mm_deg` (x, y, angle of the
    end on the block), and `rng_seed`. What is left open is drawn.

    Ends: after 6 env steps, terminated with success if the answer is most confident of the true shape, else truncated
    ("steps"); truncated before by a sensing surface that moved more than 1.5 mm ("tactile"), by a gripper more than
    16 mm from the pin ("error"), or by physics that did not converge ("not_converged").

    Keyword arguments: those of `TactileTaskEnv`, and fields of `ExploreSettings`.
    """

    task: ClassVar = TASK
    settings_type: ClassVar = ExploreSettings
    scene_type: ClassVar = ExploreScene
    shape_type: ClassVar = EndShape
    option_names: ClassVar[tuple[str, ...]] = (SHAPE, END_POSE)

    def _solids(self) -> list[SurfaceMesh]:
        straight = EndPose(x_mm=0.0, y_mm=0.0, angle_deg=0.0)
        return [*(block_mesh(shape, straight) for shape in EndShape), pin_mesh()]

    def choose_start(
        self, options: Mapping[str, Any], random: np.random.Generator, settings: ExploreSettings
    ) -> ExploreStart:
        """Return the start that the options give; all is drawn also where they do."""
        drawn_one, given = choose_shape(self.env_id, {}, self._shapes, random), options.get(SHAPE)
        shape = drawn_one if given is None else choice(self.env_id, SHAPE, given, EndShape)
        x, y, angle = random.uniform(-1.0, 1.0, 3).tolist()
        xy_mm = settings.random_xy_mm
        drawn = (x * xy_mm, y * xy_mm, angle * settings.random_angle_deg)
        wanted = options.get(END_POSE, drawn)
        xy_largest_mm, _, largest_deg = LARGEST_MM_DEG
        expected = (
            f"expected (x mm, y mm, angle deg) within {xy_largest_mm:g} mm and {largest_deg:g} degrees either way"
        )
        x_mm, y_mm, angle_deg = numbers(self.env_id, END_POSE, wanted, either_way(*LARGEST_MM_DEG), expected)
        return ExploreStart(shape=shape, end=EndPose(x_mm=x_mm, y_mm=y_mm, angle_deg=angle_deg))

    def _error(self) -> float:
        return self.task_scene.brier_score()

    def _judge(self) -> Flags:
        scene = self.task_scene
        is_over = scene.env_steps >= self.settings.max_steps
        has_moved, has_left = surface_moved_too_far(scene.grasped.surface_diff_m()), scene.has_left_range()
        is_success = is_over and scene.is_right() and not (has_moved or has_left)
        return Flags(
            tactile_movement_too_large=has_moved,
            error_too_large=has_left,
            too_many_steps=is_over and not is_success,
            is_success=is_success,
        )

    def _reward(self, flags: Flags, progress: float) -> float:
        return progress + (1.0 if flags.is_success else 0.0)

    def _info(self, flags: Flags) -> Info:
        scene = self.task_scene
        return {
            **self._common_info(flags),
            "relative_motion_mm": scene.position_mm(),
            "confidences": scene.confidences,
            "brier_score": scene.brier_score(),
            "is_success": flags.is_success,
            "shape_number": list(EndShape).index(scene.shape),
        }


def touch_around(_: Observation, info: Info) -> ActionArray:
    """Touch five places around the middle, and answer with the truth: who imitates it learns how certain one can be."""
    place_mm = np.array(AROUND_MM[min(info["steps"], len(AROUND_MM) - 1)])
    action = np.full(2 + len(EndShape), -1.0)
    action[:2] = np.clip((place_mm - info["relative_motion_mm"]) / REACH_MM, -1.0, 1.0)
    action[2 + info["shape_number"]] = 1.0
    return action.astype(np.float32)
