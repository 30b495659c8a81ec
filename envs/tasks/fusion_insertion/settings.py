"""Settings of the fusion task; the defaults are those of the 2025 Track 2 evaluation (challenge-facts 3, 7)."""

from dataclasses import dataclass, field

from ...geometry.bases import LARGEST_CLEARANCE_MM, OFFICIAL_CLEARANCE_MM
from ...scene.grasped_scene import PhysicsSettings
from ...tactile.markers import MarkerSettings
from ...vision.camera import DepthMode
from ...vision.look import CHALLENGE_LOOK, Look
from ..insertion.settings import check_friction, check_settings
from ..settings import require
from .definition import TASK


@dataclass(frozen=True, kw_only=True)
class FusionInsertionSettings:
    """What the task leaves open; lengths in mm and angles in degrees are the challenge's own interface.

    Attributes:
        max_steps: env steps after which an episode is cut off.
        action_scale_mm_deg: motion at an action of 1: x [mm], y [mm], theta [deg], z [mm].
        step_penalty: P in the reward.
        final_reward: reward of success.
        insertion_depth_mm: how deep all of the peg's lower end must be below the rim.
        indentation_mm: how far each gel is pressed into the peg.
        gripper_x_mm: grasp centre along the peg's x axis.
        gripper_z_mm: grasp centre above the peg's upper end.
        peg_friction: friction coefficient of the peg.
        base_friction: friction coefficient of the base.
        clearance_mm: gap between a centred peg and its hole; other bases than the evaluated one are for training.
        depth_mode: "stereo" as the camera measures depth, which is scored; "gt" for the exact one.
        look: colours, light and clutter in the pictures.
        picture_delay: part of an env step by which pictures lag behind, from 0 to 1.
        camera_x_mm: offset of the rig from its nominal place along the world's x, away from the base.
        camera_z_mm: the same upwards.
        camera_turn_deg: turn of the rig about the world's y axis.
        random_xy_mm: largest |x| and |y| of a random start.
        random_theta_deg: largest |theta| of a random start.
        random_z_mm: smallest and largest z of a random start.
        random_physics: draw friction, indentation and grip for every episode, over the challenge's training ranges
            and in place of the values above; for training.
        random_camera_turn_rad: largest turn of the rig either way, drawn for every episode; for training.
        random_camera_offset_m: largest offset of the rig either way along every axis; for training.
        physics: materials of the gels and time stepping.
        markers: ranges of the marker grid.
    """

    max_steps: int = 50
    action_scale_mm_deg: tuple[float, ...] = TASK.action_scale
    step_penalty: float = 0.8
    final_reward: float = 50.0
    insertion_depth_mm: float = 1.0
    indentation_mm: float = 0.875
    gripper_x_mm: float = 0.0
    gripper_z_mm: float = -8.0
    peg_friction: float = 9.5
    base_friction: float = 0.5
    clearance_mm: float = OFFICIAL_CLEARANCE_MM
    depth_mode: str = DepthMode.STEREO.value
    look: Look = CHALLENGE_LOOK
    picture_delay: float = 0.0
    camera_x_mm: float = 0.0
    camera_z_mm: float = 0.0
    camera_turn_deg: float = 0.0
    random_xy_mm: float = 5.0
    random_theta_deg: float = 10.0
    random_z_mm: tuple[float, ...] = (3.0, 9.0)
    random_physics: bool = False
    random_camera_turn_rad: float = 0.0
    random_camera_offset_m: float = 0.0
    physics: PhysicsSettings = field(default_factory=PhysicsSettings)
    markers: MarkerSettings = field(default_factory=MarkerSettings)

    def __post_init__(self) -> None:
        check_settings(self, action_numbers=len(TASK.actions))
        check_friction("base_friction", self.base_friction)
        depth, clearance = self.insertion_depth_mm, self.clearance_mm
        require(0 < depth <= 12, "insertion_depth_mm", depth, "0 to 12 mm, less than the hole's depth")
        require(0 < clearance < LARGEST_CLEARANCE_MM, "clearance_mm", clearance, "more than 0 and less than 7.5 mm")
        require(self.depth_mode in set(DepthMode), "depth_mode", self.depth_mode, f"one of {', '.join(DepthMode)}")
        require(0 <= self.picture_delay <= 1, "picture_delay", self.picture_delay, "0 to 1")
        self._check_camera()
        self._check_random_ranges()

    def _check_camera(self) -> None:
        for name in ("camera_x_mm", "camera_z_mm"):
            require(abs(getattr(self, name)) <= 20, name, getattr(self, name), "-20 to 20 mm")
        require(abs(self.camera_turn_deg) <= 3, "camera_turn_deg", self.camera_turn_deg, "-3 to 3 degrees")

    def _check_random_ranges(self) -> None:
        require(0 <= self.random_xy_mm <= 7, "random_xy_mm", self.random_xy_mm, "0 to 7 mm")
        require(0 <= self.random_theta_deg <= 20, "random_theta_deg", self.random_theta_deg, "0 to 20 degrees")
        z = self.random_z_mm
        require(len(z) == 2 and 0 <= z[0] <= z[1] <= 20, "random_z_mm", z, "two numbers of 0 to 20 mm, rising")
        turn, offset = self.random_camera_turn_rad, self.random_camera_offset_m
        require(0 <= turn <= 0.1, "random_camera_turn_rad", turn, "0 to 0.1 rad")
        require(0 <= offset <= 0.05, "random_camera_offset_m", offset, "0 to 0.05 m")
