"""`ViTac/PegInsertion2024-v1`: seven pegs, holes of several clearances, and a success that asks for calm gels."""

from dataclasses import dataclass, field
from functools import partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ...assets import Meshes
from ...fem.model.mesh import SurfaceMesh
from ...geometry.pegs import CLEARANCE_MM, PegForm
from ...geometry.pegs_2024 import (
    SHARED_SHAPES,
    PegShape2024,
    bottom_vertices_2024,
    hole_outline_mm,
    hole_surface,
    peg_surface,
    plate_outline_mm,
    profile_mm,
)
from ...geometry.solid import overlaps_plate
from ...scene.grasped_scene import PhysicsSettings
from ..definition import EndReason, Flags
from ..insertion.interface import PegOffset
from ..insertion.scene import InsertionState
from ..peg_insertion.env import PegInsertionEnv, has_left_range, is_deep, place_profile
from ..peg_insertion.scene import PegInsertionSettings, PegScene
from ..settings import require
from ..task_env import Info
from .definition import PEG_TASK

GEL_FRICTION = 0.5
"""The class default of 2024: its environment does not hand the configured one, 87.5 at the mean, to its sensors."""
CALM_M = 1e-3
"""Both sensing faces must have moved less than this on average, in the frames of their cameras."""
NOT_CHECKED_M = (-1.0, -1.0)
"""What `observation_check_m` is where the peg is not in the hole."""


@dataclass(frozen=True, kw_only=True)
class PegInsertion2024Settings(PegInsertionSettings):
    """Those of 2025 with the friction of 2024; pegs are of the edition's seven shapes, in no other form."""

    physics: PhysicsSettings = field(default_factory=partial(PhysicsSettings, gel_friction=GEL_FRICTION))

    def __post_init__(self) -> None:
        super().__post_init__()
        own = PegForm(clearance_mm=self.clearance_mm)
        require(self.form == own, "peg_width to peg_slant_mm", self.form, "the defaults; the edition has no other form")


class PegScene2024(PegScene):
    """A peg of 2024 above its hole."""

    def _meshes_of_parts(
        self, meshes: Meshes, settings: PegInsertionSettings
    ) -> tuple[SurfaceMesh, NDArray[np.int64], SurfaceMesh]:
        shape = PegShape2024(self.shape)
        peg, hole = part_meshes(meshes, shape, settings.clearance_mm)
        return peg, bottom_vertices_2024(shape, peg), hole


def part_meshes(meshes: Meshes, shape: PegShape2024, clearance_mm: float) -> tuple[SurfaceMesh, SurfaceMesh]:
    """Return the peg and its plate, from files only where those of 2025 have the same."""
    peg, hole = peg_surface(shape), hole_surface(shape, clearance_mm)
    if shape not in SHARED_SHAPES:
        return peg, hole
    named = meshes.part(lambda: peg, f"peg_in_hole/{shape}_peg.STL")
    if clearance_mm != CLEARANCE_MM:
        return named, hole
    return named, meshes.part(lambda: hole, f"peg_in_hole/{shape}_hole_{CLEARANCE_MM:g}mm.STL")


def is_blocked(shape: PegShape2024, offset: PegOffset, clearance_mm: float) -> bool:
    """Return whether the peg's profile at this offset meets the plate's material."""
    return overlaps_plate(
        place_profile(profile_mm(shape), offset),
        plate=plate_outline_mm(shape, clearance_mm),
        hole=hole_outline_mm(shape, clearance_mm),
    )


def accepts_start(shape: str, offset_mm_deg: tuple[float, float, float]) -> bool:
    """Return whether an episode may start there: the peg must not just fall into a hole of 1.5 mm of clearance."""
    x_mm, y_mm, theta_deg = offset_mm_deg
    return is_blocked(PegShape2024(shape), PegOffset(x_mm=x_mm, y_mm=y_mm, theta_deg=theta_deg), CLEARANCE_MM)


def judge_flags(state: InsertionState[PegOffset], *, max_steps: int, z_step_mm: float) -> Flags:
    """Return the flags of an env step; unlike in 2025 the last one may succeed, and no flag is of the gels' motion."""
    left_range = has_left_range(state.offset)
    is_success = is_in_hole(state, max_steps=max_steps, z_step_mm=z_step_mm) and bool(
        (state.surface_diff_m < CALM_M).all()
    )
    return Flags(too_many_steps=state.env_steps >= max_steps, error_too_large=left_range, is_success=is_success)


def is_in_hole(state: InsertionState[PegOffset], *, max_steps: int, z_step_mm: float) -> bool:
    """Return whether the peg is in the hole, and no flag forbids that this counts."""
    is_flagged = has_left_range(state.offset) or state.env_steps > max_steps
    return is_deep(state, z_step_mm) and not is_flagged


class PegInsertion2024Env(PegInsertionEnv):
    """Insert one of seven pegs into its hole, by touch alone, as in 2024.

    As `ViTac/PegInsertion-v1`, from which it differs so: seven shapes, of which the evaluation plays three; the policy
    is not told how far the gripper has moved; the gels have a friction coefficient of 0.5, as the code of 2024 had by
    an oversight; success asks in addition that both sensing faces have moved less than 1 mm, where no motion of theirs
    ends an episode; it is still possible in the last env step, 8.

    `clearance_mm` chooses the hole: 0.5, 1, 1.5 (the evaluation's), 2 or 2.5. Holes of `concave2`, `convex` and
    `hexagon` are not evenly wide, as in the files of 2024.

    Reset options: `shape` ("concave1", "concave2", "convex", "cuboid", "hexagon", "octagon", "trapezoid"),
    `offset_mm_deg` (x, y, theta), and `rng_seed`. What is left open is drawn: the shape, and an offset within 5 mm and
    10 degrees at which the peg is really blocked.

    Ends: terminated by success (`end_reason` "success") or an offset beyond 12 mm or 15 degrees ("error"); truncated by
    8 env steps ("steps", also together with success), or physics that did not converge ("not_converged"). In infos
    `too_many_steps` is raised after them only, as in 2024. `observation_check_m` is the motion of both sensing faces
    [m] where the peg is in the hole, else -1, -1.

    Keyword arguments: those of `TactileTaskEnv`, and fields of `PegInsertion2024Settings`.
    """

    task: ClassVar = PEG_TASK
    settings_type: ClassVar = PegInsertion2024Settings
    scene_type: ClassVar = PegScene2024
    shape_type: ClassVar = PegShape2024
    training_ranges: ClassVar = {
        name: bounds for name, bounds in PegInsertionEnv.training_ranges.items() if name != "physics.gel_friction"
    }

    def _solids(self) -> list[SurfaceMesh]:
        meshes, clearance_mm = self._meshes, self.settings.clearance_mm
        return [mesh for shape in PegShape2024 for mesh in part_meshes(meshes, shape, clearance_mm)]

    def _is_blocked(self, shape: Any, offset: PegOffset, settings: PegInsertionSettings) -> bool:
        return is_blocked(shape, offset, settings.clearance_mm)

    def _judge(self) -> Flags:
        settings = self.settings
        return judge_flags(self.task_scene.state(), max_steps=settings.max_steps, z_step_mm=settings.z_step_mm)

    def _ending(self, flags: Flags, end_reason: EndReason | None) -> tuple[bool, bool]:
        terminated, truncated = super()._ending(flags, end_reason)
        return (True, flags.too_many_steps) if end_reason is EndReason.ERROR else (terminated, truncated)

    def _reward(self, flags: Flags, progress: float) -> float:
        return 0.0 if self._is_late(flags) else super()._reward(flags, progress)

    def _info(self, flags: Flags) -> Info:
        info = super()._info(flags)
        del info["tactile_movement_too_large"]
        settings, state = self.settings, self.task_scene.state()
        in_hole = is_in_hole(state, max_steps=settings.max_steps, z_step_mm=settings.z_step_mm)
        checked_m = state.surface_diff_m if in_hole else np.array(NOT_CHECKED_M)
        return {**info, "too_many_steps": self._is_late(flags), "observation_check_m": checked_m}

    def _is_late(self, flags: Flags) -> bool:
        return self.task_scene.env_steps > self.settings.max_steps and not flags.error_too_large
