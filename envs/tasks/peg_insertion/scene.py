"""Scene of the peg task: a peg held by two gels above a plate with its hole (challenge-facts 2.1)."""

import numpy as np
from numpy.typing import NDArray

from ...assets import Meshes
from ...geometry.pegs import PLATE_THICKNESS_MM, bottom_vertices
from ...scene.grasped_scene import Clocks, fixed_at_origin
from ..insertion.offset import PegOffset
from ..insertion.scene import TRAVEL_SPEED_M_S, InsertionScene, Parts
from .meshes import hole_mesh, peg_mesh
from .settings import PegInsertionSettings
from .variation import PegStart

# Free space between peg and plate before the grasp.
START_GAP_MM = 0.1
APPROACH_SPEED_M_S = 1e-3


class PegScene(InsertionScene[PegOffset, PegInsertionSettings]):
    """A peg above its hole, which every env step brings one z step further down.

    Attributes:
        shape: of peg and hole.
    """

    def __init__(self, *, start: PegStart, meshes: Meshes, settings: PegInsertionSettings, clocks: Clocks) -> None:
        self.shape = start.shape
        # Commanded height of the gripper, relative to the grasp.
        self._z_mm = 0.0
        form = settings.form
        peg = peg_mesh(meshes, start.shape, form)
        parts = Parts(
            sensors=meshes.sensors(settings.markers),
            peg=peg,
            peg_bottom=bottom_vertices(start.shape, peg, form),
            fixed=fixed_at_origin(hole_mesh(meshes, start.shape, form), friction=settings.hole_friction),
            rim_mm=PLATE_THICKNESS_MM,
        )
        super().__init__(parts, offset=start.offset, settings=settings, clocks=clocks)

    def grasp(self) -> None:
        """Close on the peg, take the references, and come down until the peg would stand one z step deep."""
        super().grasp()
        self._descend(START_GAP_MM + self._settings.z_step_mm, APPROACH_SPEED_M_S)

    def move(self, command: NDArray[np.float64]) -> None:
        """Update the commanded offset as an action says, and drive the gripper there."""
        dx, dy, dtheta = self._scaled(command)
        now = self.offset
        self.travel(PegOffset(x_mm=now.x_mm + dx, y_mm=now.y_mm + dy, theta_deg=now.theta_deg + dtheta))

    def travel(self, goal: PegOffset) -> None:
        """Move the gripper to an offset, x, y and theta together, then one z step down."""
        distance_mm = max(abs(goal.x_mm - self.offset.x_mm), abs(goal.y_mm - self.offset.y_mm))
        self._travel(goal, distance_mm, raised_mm=self._z_mm)
        self._descend(self._settings.z_step_mm, TRAVEL_SPEED_M_S)

    def relative_motion_mm_deg(self) -> NDArray[np.float64]:
        """Return the commanded x, y, theta, z since the reset [mm, mm, deg, mm], without the reset's own descent."""
        return np.append(super().relative_motion_mm_deg(), -self.env_steps * self._settings.z_step_mm)

    def _lower_end_mm(self, offset: PegOffset) -> tuple[float, float, float]:
        return offset.x_mm, offset.y_mm, PLATE_THICKNESS_MM + START_GAP_MM

    def _descend(self, distance_mm: float, speed_m_s: float) -> None:
        self._z_mm -= distance_mm
        distance_m = distance_mm * 1e-3
        self.grasped.move_to(self.grasped.pose.moved(z_m=-distance_m), ipc_steps=self._ipc_steps(distance_m, speed_m_s))
