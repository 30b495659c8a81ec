"""Scene of the peg task: settings, parts, and motions of a peg held by two gels above a plate with its hole."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from ...assets import Meshes
from ...fem.model.mesh import RigidBody, SurfaceMesh
from ...fem.scene.layout import placed
from ...geometry.pegs import (
    CHALLENGE_FORM,
    PLATE_THICKNESS_MM,
    PegForm,
    PegShape,
    bottom_vertices,
    hole_surface,
    peg_surface,
)
from ...scene.grasped_scene import Clocks
from ..insertion.interface import CLEARANCE, PegOffset
from ..insertion.scene import (
    TRAVEL_SPEED_M_S,
    InsertionScene,
    InsertionSettings,
    Parts,
    check_friction,
    check_settings,
    lay,
    place_peg,
)
from ..quantities import check_quantities
from ..settings import require
from .definition import FORM_QUANTITIES, PEG_BULGE, PEG_SLANT, PEG_TAPER, PEG_WIDTH, TASK


@dataclass(frozen=True, kw_only=True)
class PegInsertionSettings(InsertionSettings):
    """What the task leaves open beside what all do that insert a peg.

    Attributes:
        z_step_mm: descent at the end of every env step.
        hole_friction: friction coefficient of the plate.
        clearance_mm: gap between a centred peg and its hole.
        peg_width: factor of the peg's width in the middle of the grasp, see `PegForm`.
        peg_taper: by how much that factor differs at the gripped faces.
        peg_bulge: by how much that factor is larger in the middle third.
        peg_slant_mm: by how much the gripped faces lie on different sides of the middle.
    """

    max_steps: int = 8
    action_scale_mm_deg: tuple[float, ...] = TASK.action_scale
    step_penalty: float = 1.0
    final_reward: float = 10.0
    z_step_mm: float = 0.125
    hole_friction: float = 0.5
    clearance_mm: float = CLEARANCE.nominal
    peg_width: float = PEG_WIDTH.nominal
    peg_taper: float = PEG_TAPER.nominal
    peg_bulge: float = PEG_BULGE.nominal
    peg_slant_mm: float = PEG_SLANT.nominal

    def __post_init__(self) -> None:
        check_settings(self, action_numbers=len(TASK.actions))
        check_friction("hole_friction", self.hole_friction)
        check_quantities(self, (CLEARANCE, *FORM_QUANTITIES))
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


@dataclass(frozen=True, kw_only=True)
class PegStart:
    """Start of an episode; the shape is one of its edition's."""

    shape: StrEnum
    offset: PegOffset


def peg_mesh(meshes: Meshes, shape: PegShape, form: PegForm = CHALLENGE_FORM) -> SurfaceMesh:
    """Return the peg of this shape."""
    return _part(meshes, form, lambda: peg_surface(shape, form), f"{shape}_peg.STL")


def hole_mesh(meshes: Meshes, shape: PegShape, form: PegForm = CHALLENGE_FORM) -> SurfaceMesh:
    """Return the plate with the hole for this peg, 1.5 mm of clearance per side where the form has no other."""
    return _part(meshes, form, lambda: hole_surface(shape, form), f"{shape}_hole_1.5mm.STL")


def _part(meshes: Meshes, form: PegForm, generate: Callable[[], SurfaceMesh], file: str) -> SurfaceMesh:
    """Return a part; the challenge has files of its own form only, so all others are generated."""
    return meshes.part(generate, f"peg_in_hole/{file}") if form == CHALLENGE_FORM else generate()


# Free space between an upright peg and a level plate before the grasp; tilted ones get as much more as they need.
START_GAP_MM = 0.1
APPROACH_SPEED_M_S = 1e-3


class PegScene(InsertionScene[PegOffset, PegInsertionSettings]):
    """A peg above its hole, which every env step brings one z step further down.

    Attributes:
        shape: of peg and hole.
    """

    def __init__(
        self,
        *,
        start: PegStart,
        meshes: Meshes,
        settings: PegInsertionSettings,
        clocks: Clocks,
        gap_mm: float | None = None,
    ) -> None:
        """Build the scene.

        Args:
            start: shape and offset.
            meshes: of gels and parts.
            settings: of the task.
            clocks: that the scene's work is counted on.
            gap_mm: free height below the peg before the grasp; by default as little as its tilt and the plate's allow.
        """
        self.shape = start.shape
        # Commanded height of the gripper, relative to the grasp.
        self._z_mm = 0.0
        peg, peg_bottom, hole = self._meshes_of_parts(meshes, settings)
        fixed = lay(self._place_fixed(hole, settings.hole_friction), settings)
        self._gap_mm = _free_gap_mm(peg, start.offset, fixed, settings) if gap_mm is None else gap_mm
        parts = Parts(
            sensors=meshes.sensors(settings.markers),
            peg=peg,
            peg_bottom=peg_bottom,
            fixed=fixed,
            rim_mm=PLATE_THICKNESS_MM,
        )
        super().__init__(parts, offset=start.offset, settings=settings, clocks=clocks)

    def _meshes_of_parts(
        self, meshes: Meshes, settings: PegInsertionSettings
    ) -> tuple[SurfaceMesh, NDArray[np.int64], SurfaceMesh]:
        """Return the peg, its vertices at its lower corners, and the plate."""
        shape, form = PegShape(self.shape), settings.form
        peg = peg_mesh(meshes, shape, form)
        return peg, bottom_vertices(shape, peg, form), hole_mesh(meshes, shape, form)

    def grasp(self) -> None:
        """Close on the peg, take the references, and come down until the peg would stand one z step deep."""
        super().grasp()
        self._descend(self._gap_mm + self._settings.z_step_mm, APPROACH_SPEED_M_S)

    def move(self, command: NDArray[np.float64]) -> None:
        """Update the commanded offset as an action says, and drive the gripper there."""
        dx, dy, dtheta = self._scaled(command)
        now = self.offset
        self.travel(PegOffset(x_mm=now.x_mm + dx, y_mm=now.y_mm + dy, theta_deg=now.theta_deg + dtheta))

    def travel(self, goal: PegOffset) -> None:
        """Move the gripper to an offset, x, y and theta together, then one z step down."""
        distance_mm = max(abs(goal.x_mm - self.offset.x_mm), abs(goal.y_mm - self.offset.y_mm))
        self._travel(goal, ipc_steps=self._steps_to(goal, distance_mm), raised_mm=self._z_mm)
        self._descend(self._settings.z_step_mm, TRAVEL_SPEED_M_S)

    def relative_motion_mm_deg(self) -> NDArray[np.float64]:
        """Return the commanded x, y, theta, z since the reset [mm, mm, deg, mm], without the reset's own descent."""
        return np.append(super().relative_motion_mm_deg(), -self.env_steps * self._settings.z_step_mm)

    def _lower_end_mm(self, offset: PegOffset) -> tuple[float, float, float]:
        return offset.x_mm, offset.y_mm, PLATE_THICKNESS_MM + self._gap_mm

    def _descend(self, distance_mm: float, speed_m_s: float) -> None:
        self._z_mm -= distance_mm
        distance_m = distance_mm * 1e-3
        self.grasped.move_to(self.grasped.pose.moved(z_m=-distance_m), ipc_steps=self._ipc_steps(distance_m, speed_m_s))


def _free_gap_mm(peg: SurfaceMesh, offset: PegOffset, fixed: RigidBody, settings: PegInsertionSettings) -> float:
    """Return the height above the middle of the plate at which a peg is as far from the plate as if both were level."""
    if not any((settings.peg_tilt_deg, settings.hole_tilt_x_deg, settings.hole_tilt_y_deg)):
        return START_GAP_MM
    lowered = place_peg(peg, offset, (offset.x_mm, offset.y_mm, PLATE_THICKNESS_MM), settings)
    normal = fixed.rotation[:, 2]
    middle_m = np.array((0.0, 0.0, PLATE_THICKNESS_MM * 1e-3))
    heights_m = ((placed(peg.vertices_m, lowered) - middle_m) * normal).sum(axis=1)
    return START_GAP_MM - 1e3 * float(heights_m.min() / normal[2])
