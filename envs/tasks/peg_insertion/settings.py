"""Settings of the peg task; the defaults are those of the 2025 Track 1 evaluation (challenge-facts 3, 7)."""

from dataclasses import dataclass, field

from ...geometry.pegs import CLEARANCE_MM, PegForm
from ...scene.grasped_scene import PhysicsSettings
from ...tactile.markers import MarkerSettings
from ..insertion.settings import check_friction, check_settings
from ..settings import require
from .definition import TASK


@dataclass(frozen=True, kw_only=True)
class PegInsertionSettings:
    """What the task leaves open; lengths in mm and angles in degrees are the challenge's own interface.

    Attributes:
        max_steps: env steps after which an episode is cut off.
        z_step_mm: descent at the end of every env step.
        action_scale_mm_deg: motion at an action of 1: x [mm], y [mm], theta [deg].
        step_penalty: P in the reward.
        final_reward: reward of success.
        indentation_mm: how far each gel is pressed into the peg.
        gripper_x_mm: grasp centre along the peg's x axis.
        gripper_z_mm: grasp centre above the peg's upper end.
        peg_friction: friction coefficient of the peg.
        hole_friction: friction coefficient of the plate.
        clearance_mm: gap between a centred peg and its hole.
        peg_width: factor of the peg's width in the middle of the grasp, see `PegForm`.
        peg_taper: by how much that factor differs at the gripped faces.
        peg_bulge: by how much that factor is larger in the middle third.
        peg_slant_mm: by how much the gripped faces lie on different sides of the middle.
        random_xy_mm: largest |x| and |y| of a random start.
        random_theta_deg: largest |theta| of a random start.
        physics: materials of the gels and time stepping.
        markers: ranges of the marker grid.
    """

    max_steps: int = 8
    z_step_mm: float = 0.125
    action_scale_mm_deg: tuple[float, ...] = TASK.action_scale
    step_penalty: float = 1.0
    final_reward: float = 10.0
    indentation_mm: float = 0.875
    gripper_x_mm: float = 0.0
    gripper_z_mm: float = -8.0
    peg_friction: float = 9.5
    hole_friction: float = 0.5
    clearance_mm: float = CLEARANCE_MM
    peg_width: float = 1.0
    peg_taper: float = 0.0
    peg_bulge: float = 0.0
    peg_slant_mm: float = 0.0
    random_xy_mm: float = 5.0
    random_theta_deg: float = 10.0
    physics: PhysicsSettings = field(default_factory=PhysicsSettings)
    markers: MarkerSettings = field(default_factory=MarkerSettings)

    def __post_init__(self) -> None:
        check_settings(self, action_numbers=len(TASK.actions))
        check_friction("hole_friction", self.hole_friction)
        require(0.1 <= self.clearance_mm <= 3, "clearance_mm", self.clearance_mm, "0.1 to 3 mm")
        require(0.5 <= self.peg_width <= 1.4, "peg_width", self.peg_width, "0.5 to 1.4")
        require(abs(self.peg_taper) <= 0.3, "peg_taper", self.peg_taper, "-0.3 to 0.3")
        require(abs(self.peg_bulge) <= 0.3, "peg_bulge", self.peg_bulge, "-0.3 to 0.3")
        require(abs(self.peg_slant_mm) <= 4, "peg_slant_mm", self.peg_slant_mm, "-4 to 4 mm")
        require(0 < self.z_step_mm <= 5, "z_step_mm", self.z_step_mm, "0 to 5 mm")
        require(0 < self.random_xy_mm <= 12, "random_xy_mm", self.random_xy_mm, "0 to 12 mm")
        require(0 <= self.random_theta_deg <= 15, "random_theta_deg", self.random_theta_deg, "0 to 15 degrees")

    @property
    def form(self) -> PegForm:
        """Form of peg and hole."""
        return PegForm(
            width=self.peg_width,
            taper=self.peg_taper,
            bulge=self.peg_bulge,
            slant_mm=self.peg_slant_mm,
            clearance_mm=self.clearance_mm,
        )
