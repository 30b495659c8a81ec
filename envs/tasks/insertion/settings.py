"""What the settings of every insertion task have, and how it is checked."""

from math import isfinite
from typing import Protocol

from ...scene.grasped_scene import PhysicsSettings
from ...tactile.markers import MarkerSettings
from ..randomization import Ranges
from ..settings import require

_WORDS = {3: "three", 4: "four"}


class InsertionSettings(Protocol):
    """Settings of a task that inserts a peg."""

    @property
    def max_steps(self) -> int:
        """Env steps after which an episode is cut off."""

    @property
    def action_scale_mm_deg(self) -> tuple[float, ...]:
        """Motion at an action of 1: x [mm], y [mm], theta [deg], and z [mm] where the action has it."""

    @property
    def step_penalty(self) -> float:
        """P in the reward."""

    @property
    def final_reward(self) -> float:
        """Reward of success."""

    @property
    def indentation_mm(self) -> float:
        """How far each gel is pressed into the peg."""

    @property
    def gripper_x_mm(self) -> float:
        """Grasp centre along the peg's x axis."""

    @property
    def gripper_z_mm(self) -> float:
        """Grasp centre above the peg's upper end."""

    @property
    def peg_friction(self) -> float:
        """Friction coefficient of the peg."""

    @property
    def physics(self) -> PhysicsSettings:
        """Materials of the gels and time stepping."""

    @property
    def markers(self) -> MarkerSettings:
        """Ranges of the marker grid."""


def training_ranges(fixed_friction: str) -> Ranges:
    """Return the ranges of the published training (challenge-facts 3).

    Args:
        fixed_friction: the setting with the friction coefficient of the part with the hole.
    """
    return {
        "physics.gel_friction": (50.0, 125.0),
        "peg_friction": (4.0, 15.0),
        fixed_friction: (0.0, 1.0),
        "indentation_mm": (0.5, 1.25),
        "gripper_x_mm": (-1.0, 1.0),
        "gripper_z_mm": (-10.0, -6.0),
    }


def check_settings(settings: InsertionSettings, *, action_numbers: int) -> None:
    """Refuse settings that no insertion task can be played with.

    Raises:
        SettingsError: one is out of range.
    """
    require(settings.max_steps >= 1, "max_steps", settings.max_steps, "at least 1")
    scale = settings.action_scale_mm_deg
    usable = len(scale) == action_numbers and all(isfinite(value) and 0 <= value <= 20 for value in scale)
    require(usable, "action_scale_mm_deg", scale, f"{_WORDS[action_numbers]} numbers of 0 to 20")
    indentation_mm = settings.indentation_mm
    require(0 < indentation_mm <= 2, "indentation_mm", indentation_mm, "0 to 2 mm, half the gel")
    require(abs(settings.gripper_x_mm) <= 7, "gripper_x_mm", settings.gripper_x_mm, "-7 to 7 mm")
    require(-17 <= settings.gripper_z_mm <= 0, "gripper_z_mm", settings.gripper_z_mm, "-17 to 0 mm")
    check_friction("peg_friction", settings.peg_friction)


def check_friction(name: str, value: float) -> None:
    """Refuse a friction coefficient that is out of range.

    Raises:
        SettingsError: it is.
    """
    require(0 <= value <= 1e3, name, value, "0 to 1000")
