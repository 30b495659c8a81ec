"""Settings of the lock task; the defaults are those of the 2025 Track 1 evaluation (challenge-facts 3, 7)."""

from dataclasses import dataclass, field
from math import isfinite

from ...fem.model.settings import ContactSettings
from ...geometry.keys_and_locks import OWN_CLEARANCE
from ...scene.grasped_scene import PhysicsSettings
from ...tactile.markers import MarkerSettings
from ..settings import require
from .definition import TASK


def lock_physics() -> PhysicsSettings:
    """Return the time step and friction smoothing of the lock task; the rest as in the peg task."""
    return PhysicsSettings(time_step_s=0.2, contact=ContactSettings(friction_velocity_m_s=1e-3))


TRAINING_RANGES = {
    "physics.gel_friction": (50.0, 125.0),
    "key_friction": (0.2, 1.0),
    "lock_friction": (0.0, 1.0),
    "indentation_mm": (0.5, 1.25),
}
"""Ranges of the published training (challenge-facts 3)."""


@dataclass(frozen=True, kw_only=True)
class LockOpeningSettings:
    """What the task leaves open; lengths in mm are the challenge's own interface.

    Attributes:
        max_steps: env steps after which an episode is cut off.
        action_scale_mm: motion at an action of 1: x [mm], z [mm].
        step_penalty: P in the reward.
        final_reward: reward of success.
        failure_penalty: cost of the force, tactile or error flag.
        indentation_mm: how far each gel is pressed into the key.
        gripper_x_mm: grasp centre beside its nominal place on the handle, outwards; the jitter is added.
        gripper_z_mm: the same upwards.
        slot_clearance_mm: room of a tooth in its slot on both sides; 0 for that of the challenge's lock, which is 2 mm,
            and 1 mm for key3.
        key_friction: friction coefficient of the key.
        lock_friction: friction coefficient of the lock.
        random_x_mm: largest x of a random start.
        jitter_mm: largest displacement of the sensors along the key, and up or down.
        reference_quirks: reproduce the jump of `relative_motion` after the first env step of the 2025 code, which
            tells the keys apart (challenge-facts 14.2).
        physics: materials of the gels and time stepping.
        markers: ranges of the marker grid.
    """

    max_steps: int = 50
    action_scale_mm: tuple[float, ...] = TASK.action_scale
    step_penalty: float = 1.0
    final_reward: float = 10.0
    failure_penalty: float = 5.0
    indentation_mm: float = 0.875
    gripper_x_mm: float = 0.0
    gripper_z_mm: float = 0.0
    slot_clearance_mm: float = OWN_CLEARANCE
    key_friction: float = 0.6
    lock_friction: float = 0.5
    random_x_mm: float = 5.0
    jitter_mm: float = 2.0
    reference_quirks: bool = False
    physics: PhysicsSettings = field(default_factory=lock_physics)
    markers: MarkerSettings = field(default_factory=MarkerSettings)

    def __post_init__(self) -> None:
        require(self.max_steps >= 1, "max_steps", self.max_steps, "at least 1")
        scale = self.action_scale_mm
        usable = len(scale) == 2 and all(isfinite(value) and 0 <= value <= 10 for value in scale)
        require(usable, "action_scale_mm", scale, "two numbers of 0 to 10")
        require(0 < self.indentation_mm <= 2, "indentation_mm", self.indentation_mm, "0 to 2 mm, half the gel")
        for name in ("gripper_x_mm", "gripper_z_mm"):
            require(abs(getattr(self, name)) <= 4, name, getattr(self, name), "-4 to 4 mm")
        gap_mm = self.slot_clearance_mm
        require(gap_mm == OWN_CLEARANCE or 0.1 <= gap_mm <= 3, "slot_clearance_mm", gap_mm, "0, or 0.1 to 3 mm")
        for name in ("key_friction", "lock_friction"):
            require(0 <= getattr(self, name) <= 1e3, name, getattr(self, name), "0 to 1000")
        require(0 <= self.random_x_mm <= 20, "random_x_mm", self.random_x_mm, "0 to 20 mm")
        require(0 <= self.jitter_mm <= 4, "jitter_mm", self.jitter_mm, "0 to 4 mm")
