"""Both environments of 2024.

`ViTac/PegInsertion2024-v1`: seven pegs, holes of several clearances, and a success that asks for calm gels.
`ViTac/LockOpening2024-v1`: push a key into its lock and lift it; the key starts outside.
"""

from dataclasses import dataclass, field
from functools import partial
from math import inf
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ...assets import Meshes
from ...fem.model.mesh import SurfaceMesh
from ...fem.model.settings import ContactSettings
from ...geometry.keys_and_locks import LOCKS
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
from ...scene.perspective import ActionArray, longest_action
from ...tactile.markers import MarkerSettings
from ..definition import EndReason, Flags
from ..insertion.env import InsertionState
from ..insertion.interface import PegOffset
from ..lock_opening.definition import CEILING_Z_M, LIFTED_Z_M, LockState, judge_flags, mean_corner
from ..lock_opening.env import OFFSET, FloatArray, KeyOffset, LockOpeningEnv, LockOpeningSettings, LockScene, LockStart
from ..peg_insertion.env import PegInsertionEnv, PegInsertionSettings, PegScene, has_left_range, is_deep, place_profile
from ..settings import either_way, numbers, require
from ..task_env import Info, Observation
from .definition import LOCK_TASK, PEG_TASK, SUCCESS_Z_RANGE_M

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


def judge_peg_flags(state: InsertionState[PegOffset], *, max_steps: int, z_step_mm: float) -> Flags:
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
        return judge_peg_flags(self.task_scene.state(), max_steps=settings.max_steps, z_step_mm=settings.z_step_mm)

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


LARGEST_X_MM = 10.0
"""Of the distance of the key's tip from the lock's entrance at the start; what is beyond is clipped, as in 2024."""
LARGEST_ACTION = 30.0
"""Nothing is clipped up to here; a longer motion, of 120 mm along the key, leaves every range as this one does."""
_ERROR_PER_MM2 = 4.0
_OUTSIDE_MM2 = 64.0
_SURFACE_MM = (0.2, 1.5)


def lock_physics() -> PhysicsSettings:
    """Return time step and contact of the evaluation of 2024, which are its class defaults but for the time step."""
    contact = ContactSettings(d_hat_m=2e-4, kappa=1e3, friction_velocity_m_s=1e-3)
    return PhysicsSettings(time_step_s=0.033, contact=contact, gel_friction=GEL_FRICTION)


@dataclass(frozen=True, kw_only=True)
class LockOpening2024Settings(LockOpeningSettings):
    """Those of 2025 with the values of 2024.

    Attributes:
        failure_penalty: cost of the force, tactile or error flag for every env step that is left, in step penalties.
        jitter_z_mm: largest displacement of the sensors up or down, where `jitter_mm` is that along the key; 0, as the
            name of its setting was misspelt in 2024.
    """

    action_count: ClassVar[int] = len(LOCK_TASK.actions)

    max_steps: int = 100
    action_scale_mm: tuple[float, ...] = LOCK_TASK.action_scale
    failure_penalty: float = 10.0
    random_x_mm: float = LARGEST_X_MM
    jitter_z_mm: float = 0.0
    physics: PhysicsSettings = field(default_factory=lock_physics)
    markers: MarkerSettings = field(default_factory=lambda: MarkerSettings(noise_px=0.1, loss_probability=0.0))

    def __post_init__(self) -> None:
        super().__post_init__()
        require(0 <= self.random_x_mm <= LARGEST_X_MM, "random_x_mm", self.random_x_mm, f"0 to {LARGEST_X_MM:g} mm")
        require(0 <= self.jitter_z_mm <= 4, "jitter_z_mm", self.jitter_z_mm, "0 to 4 mm")


class LockScene2024(LockScene):
    """A key outside its lock."""

    def move(self, command: FloatArray) -> None:
        """Move the gripper as an action says, against each axis; nothing is clipped within any range."""
        bounded = np.clip(command, -LARGEST_ACTION, LARGEST_ACTION)
        x_mm, y_mm, z_mm = (-bounded * np.array(self._settings.action_scale_mm)).tolist()
        self.travel(x_mm, z_mm, y_mm)

    def _key_position_m(self, start: LockStart) -> FloatArray:
        return np.array([LOCKS[start.shape].length_mm + start.offset.x_mm, 0.0, 0.0]) * 1e-3


def alignment_error(state: LockState) -> float:
    """Return the error e of the reward: 4 per mm2 of both teeth's squared distance from where they should be.

    Outside the lock 64 mm2 are added for each, so that going in does not raise it.
    """
    return _ERROR_PER_MM2 * sum(
        _distance_mm2(tooth, slot, is_inside=state.is_inside) for tooth, slot in state.teeth_and_slots
    )


def reward(
    flags: Flags,
    surface_diff_m: FloatArray,
    *,
    progress: float,
    step_penalty: float,
    final_reward: float,
    failure_penalty: float,
) -> float:
    """Return the reward of an env step: progress, less penalty and the gels' part, plus the end's.

    The gels' part is 0.19 for gels at rest, and falls to -200 for each that has moved 1.5 mm.
    """
    final = 0.0
    if flags.is_success:
        final = final_reward
    elif flags.has_failed:
        final = -failure_penalty
    surface_mm = np.clip(surface_diff_m * 1e3, *_SURFACE_MM)
    return float(progress - step_penalty - (float((10.0 / (1.55 - surface_mm)).sum()) - 15.0) + final)


class LockOpening2024Env(LockOpeningEnv):
    """Push a key into its lock until its teeth stand below their slots, then lift it, by touch alone, as in 2024.

    As `ViTac/LockOpening-v1`, from which it differs so: the key starts outside, its tip up to 10 mm before the
    entrance; the gripper also moves sideways, every number of an action moves it against its axis, and nothing is
    clipped (up to 30, which leaves every range); 100 env steps; the teeth must be lifted by 8 mm, their top corners
    between 37 and 40 mm high; the sensors grip the handle up to 2 mm off along the key alone; gels with a friction
    coefficient of 0.5, a time step of 0.033 s, less noise of the markers and none lost.

    Reset options: `shape` ("key1" to "key4"), `offset_mm` (x of the key's tip before the entrance, clipped to 0 to
    10; y and z, which become 0), `sensor_jitter_mm` (x, z), and `rng_seed`. What is left open is drawn: the key, x from
    0 to 10 mm, and the jitter along the key of up to 2 mm either way.

    Ends: as `ViTac/LockOpening-v1`, after 100 env steps.

    Keyword arguments: those of `TactileTaskEnv`, and fields of `LockOpening2024Settings`.
    """

    task: ClassVar = LOCK_TASK
    settings_type: ClassVar = LockOpening2024Settings
    scene_type: ClassVar = LockScene2024
    training_ranges: ClassVar = {
        name: bounds for name, bounds in LockOpeningEnv.training_ranges.items() if name != "physics.gel_friction"
    }

    def _read_offset(self, value: Any) -> KeyOffset:
        """Return the offset that the option gives, clipped as in 2024: x to 0 to 10 mm, y and z to 0."""
        x_mm, _, _ = numbers(self.env_id, OFFSET, value, either_way(inf, inf, inf), "expected (x, y, z) in mm")
        return KeyOffset(x_mm=min(max(x_mm, 0.0), LARGEST_X_MM), y_mm=0.0, z_mm=0.0)

    def _largest_jitter_mm(self, settings: Any) -> tuple[float, float]:
        return settings.jitter_mm, settings.jitter_z_mm

    def _error(self) -> float:
        return alignment_error(self.task_scene.state())

    def _judge(self) -> Flags:
        state, most = self.task_scene.state(), self.settings.max_steps
        return judge_flags(state, max_steps=most, success_z_range_m=SUCCESS_Z_RANGE_M)

    def _reward(self, flags: Flags, progress: float) -> float:
        settings, left = self.settings, self.settings.max_steps - self.task_scene.env_steps
        return reward(
            flags,
            self.scene.surface_diff_m(),
            progress=progress,
            step_penalty=settings.step_penalty,
            final_reward=settings.final_reward,
            failure_penalty=settings.failure_penalty * settings.step_penalty * left,
        )


def _distance_mm2(tooth_m: FloatArray, slot_m: FloatArray, *, is_inside: bool) -> float:
    x, y, z = (1e3 * value for value in mean_corner(tooth_m))
    apart_mm = x - 1e3 * mean_corner(slot_m)[0]
    goal_m, more_mm2 = (LIFTED_Z_M, 0.0) if is_inside else (CEILING_Z_M, _OUTSIDE_MM2)
    return apart_mm * apart_mm + y * y + (z - 1e3 * goal_m) ** 2 + more_mm2


# How near its slot the rear tooth is before it is lifted, and above the least height at which the lock opens [mm].
_ALIGNED_MM, _LIFT_MARGIN_MM = 0.5, 0.5


def in_and_up(_: Observation, info: Info) -> ActionArray:
    """Go in until the rear tooth is below its slot, then up into it."""
    tooth_m, slot_m = info["key1_pts_m"], info["lock1_pts_m"]
    inwards_mm = 1e3 * (tooth_m[:, 0].mean() - slot_m[:, 0].mean())
    down_mm = 1e3 * (tooth_m[:, 2].min() - SUCCESS_Z_RANGE_M[0]) - _LIFT_MARGIN_MM
    is_aligned = abs(inwards_mm) < _ALIGNED_MM
    return longest_action(np.array([inwards_mm, 0.0, down_mm if is_aligned else 0.0]), np.array(LOCK_TASK.action_scale))
