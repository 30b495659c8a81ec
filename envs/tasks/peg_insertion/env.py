"""`ViTac/PegInsertion-v1`: insert a peg that is held between two tactile sensors."""

from collections.abc import Mapping
from enum import StrEnum
from math import radians
from typing import Any, ClassVar

import numpy as np

from ...deterministic_math import sine_cosine
from ...fem.model.mesh import SurfaceMesh
from ...geometry.pegs import (
    CHALLENGE_FORM,
    PLATE_OUTLINE_MM,
    PegForm,
    PegShape,
    hole_outline_mm,
    profile_mm,
)
from ...geometry.solid import Polygon, overlaps_plate
from ...scene.perspective import ActionArray, longest_action
from ..definition import Flags
from ..insertion.env import InsertionEnv, way_to_the_hole
from ..insertion.interface import PegOffset, is_beyond
from ..insertion.scene import InsertionState, compute_flags, training_ranges
from ..settings import SHAPE, choose_shape, either_way, numbers
from ..task_env import Info, Observation
from .definition import SUCCESS_DEPTH_MM, TASK
from .scene import PegInsertionSettings, PegScene, PegStart, hole_mesh, peg_mesh

OFFSET = "offset_mm_deg"


# The task's own limits of the commanded offset.
LARGEST_XY_MM = 12.0
LARGEST_THETA_DEG = 15.0


def is_blocked(shape: PegShape, offset: PegOffset, form: PegForm = CHALLENGE_FORM) -> bool:
    """Return whether the peg's profile at this offset meets the plate's material."""
    placed = place_profile(profile_mm(shape, form), offset)
    return overlaps_plate(placed, plate=PLATE_OUTLINE_MM, hole=hole_outline_mm(shape, form))


def place_profile(profile: Polygon, offset: PegOffset) -> Polygon:
    """Return a peg's profile at an offset [mm]."""
    sine, cosine = sine_cosine(radians(offset.theta_deg))
    x, y = profile.T
    return np.column_stack([cosine * x - sine * y + offset.x_mm, sine * x + cosine * y + offset.y_mm])


def accepts_start(shape: str, offset_mm_deg: tuple[float, float, float]) -> bool:
    """Return whether an episode may start there: the peg must not just fall into the hole."""
    x_mm, y_mm, theta_deg = offset_mm_deg
    return is_blocked(PegShape(shape), PegOffset(x_mm=x_mm, y_mm=y_mm, theta_deg=theta_deg))


SUCCESS_COMMANDED_DEPTH_MM = 0.35


def judge_flags(state: InsertionState[PegOffset], *, max_steps: int, z_step_mm: float) -> Flags:
    """Return the flags of an env step.

    The limits of the offset are tested once per env step on the commanded values, not after each IPC step as published;
    success asks for the commanded *and* the measured depth (docs/environments.md, "Where the paper and the 2025 code
    differ").
    """
    reached = is_deep(state, z_step_mm)
    return compute_flags(state, max_steps=max_steps, left_range=has_left_range(state.offset), reached=reached)


def is_deep(state: InsertionState[PegOffset], z_step_mm: float) -> bool:
    """Return whether the peg is in the hole, as commanded and as measured."""
    return state.env_steps * z_step_mm > SUCCESS_COMMANDED_DEPTH_MM and state.is_deeper_than(SUCCESS_DEPTH_MM)


def has_left_range(offset: PegOffset) -> bool:
    """Return whether the commanded offset is beyond its limits."""
    return (
        is_beyond(offset.x_mm, LARGEST_XY_MM)
        or is_beyond(offset.y_mm, LARGEST_XY_MM)
        or is_beyond(offset.theta_deg, LARGEST_THETA_DEG)
    )


class PegInsertionEnv(InsertionEnv[PegScene, PegInsertionSettings]):
    """Insert a peg into the hole of a plate, by touch alone.

    The peg hangs between two gels, displaced from its hole by a few millimetres and degrees that the policy is not
    told. Every env step moves the gripper as the action says, then 0.125 mm down. Actions outside -1 to 1 are clipped.
    World frame: z up, origin at the hole's centre in the plate's lower face.

    The grid of `marker_flow` is drawn again at every observation.

    Reset options: `shape` ("cuboid", "trapezoid", "concave1"), `offset_mm_deg` (x, y, theta), and `rng_seed`, the
    integers that seed the episode's generator in place of the environment's own. What is left open is drawn: the
    shape, and an offset within 5 mm and 10 degrees at which the peg is really blocked.

    Ends: terminated by success (`end_reason` "success"); truncated by a sensing surface that moved more than 1.5 mm
    ("tactile"), an offset beyond 12 mm or 15 degrees ("error"), 8 env steps ("steps"), or physics that did not converge
    ("not_converged", after which nothing moves). An end that already happened in the reset is in the info of the reset.

    Keyword arguments: those of `TactileTaskEnv`, and fields of `PegInsertionSettings`.
    """

    task: ClassVar = TASK
    settings_type: ClassVar = PegInsertionSettings
    scene_type: ClassVar[type[PegScene]] = PegScene
    shape_type: ClassVar[type[StrEnum]] = PegShape
    training_ranges: ClassVar = training_ranges("hole_friction")
    option_names: ClassVar[tuple[str, ...]] = (SHAPE, OFFSET)

    def _solids(self) -> list[SurfaceMesh]:
        meshes, form = self._meshes, self.settings.form
        return [mesh(meshes, shape, form) for shape in PegShape for mesh in (peg_mesh, hole_mesh)]

    def choose_start(
        self, options: Mapping[str, Any], random: np.random.Generator, settings: PegInsertionSettings
    ) -> PegStart:
        """Return the start that the options give; what they leave open is drawn: the shape, then a blocked offset."""
        shape, wanted = choose_shape(self.env_id, options, self._shapes, random), options.get(OFFSET)
        if wanted is None:
            return PegStart(shape=shape, offset=self._draw_blocked_offset(shape, random, settings))
        expected = (
            f"expected (x mm, y mm, theta deg) within {LARGEST_XY_MM:g} mm and {LARGEST_THETA_DEG:g} degrees either way"
        )
        ranges = either_way(LARGEST_XY_MM, LARGEST_XY_MM, LARGEST_THETA_DEG)
        x_mm, y_mm, theta_deg = numbers(self.env_id, OFFSET, wanted, ranges, expected)
        return PegStart(shape=shape, offset=PegOffset(x_mm=x_mm, y_mm=y_mm, theta_deg=theta_deg))

    def _draw_blocked_offset(
        self, shape: StrEnum, random: np.random.Generator, settings: PegInsertionSettings
    ) -> PegOffset:
        """Return a uniform offset (drawn x, y, theta), drawn again until the peg cannot just fall into the hole.

        The 2025 code asks a collision library about the solids; prisms with one axis collide where their profiles do.
        """
        xy_mm, largest_deg = settings.random_xy_mm, settings.random_theta_deg
        while True:
            x, y, theta = random.uniform(-1.0, 1.0, 3).tolist()
            offset = PegOffset(x_mm=x * xy_mm, y_mm=y * xy_mm, theta_deg=theta * largest_deg)
            if self._is_blocked(shape, offset, settings):
                return offset

    def _is_blocked(self, shape: Any, offset: PegOffset, settings: PegInsertionSettings) -> bool:
        return is_blocked(shape, offset, settings.form)

    def _judge(self) -> Flags:
        settings = self.settings
        return judge_flags(self.task_scene.state(), max_steps=settings.max_steps, z_step_mm=settings.z_step_mm)


def to_the_hole(_: Observation, info: Info) -> ActionArray:
    """Take the offset away."""
    return longest_action(np.array(way_to_the_hole(info["gt_offset_mm_deg"].tolist())), np.array(TASK.action_scale))
