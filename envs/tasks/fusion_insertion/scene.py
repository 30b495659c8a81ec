"""Scene of the fusion task: a peg held by two gels above a base with two holes, and the rig (challenge-facts 2.3)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...assets import Meshes
from ...geometry.bases import RIM_MM
from ...scene.grasped_scene import Clocks, fixed_at_origin
from ...vision.camera import DepthMode, RigCamera, Sight
from ...vision.look import draw_clutter
from ...vision.pinhole import colour_camera_pose
from ...vision.rasterizer import Body, Label
from ..insertion.scene import InsertionScene, Parts
from .meshes import base_mesh, peg_bottom, peg_mesh
from .settings import FusionInsertionSettings
from .variation import START_GAP_MM, Z_TARGET_MM, FusionOffset, FusionShape, FusionStart, RigVariation, Target

# Sets the numbers of clutter apart from the noise, whose stream has the number of the env step here.
_CLUTTER_STREAM = 2**32


@dataclass(frozen=True, kw_only=True, eq=False)
class _Visible:
    """What the rig looks at, at one moment.

    Attributes:
        positions_m: vertices of each body [m], in the order of `FusionScene._visible_bodies`.
        y_m: commanded y of the peg, which the rig follows [m].
        z_m: 1 mm below the commanded height of the peg's lower end [m].
    """

    positions_m: list[NDArray[np.float64]]
    y_m: float
    z_m: float

    def mixed(self, before: "_Visible", part: float) -> "_Visible":
        """Return what is between this and an earlier moment, of which it has a part."""
        pairs = zip(before.positions_m, self.positions_m, strict=True)
        return _Visible(
            positions_m=[part * earlier_m + (1.0 - part) * now_m for earlier_m, now_m in pairs],
            y_m=part * before.y_m + (1.0 - part) * self.y_m,
            z_m=part * before.z_m + (1.0 - part) * self.z_m,
        )


class FusionScene(InsertionScene[FusionOffset, FusionInsertionSettings]):
    """A fusion scene, and what the rig sees.

    Attributes:
        target: which hole is the right one.
    """

    def __init__(
        self,
        *,
        start: FusionStart,
        meshes: Meshes,
        settings: FusionInsertionSettings,
        clocks: Clocks,
        rig: RigVariation,
    ) -> None:
        self._rig_variation = rig
        self.target: Target = start.target
        peg = peg_mesh(meshes, start.target)
        parts = Parts(
            sensors=meshes.sensors(settings.markers),
            peg=peg,
            peg_bottom=peg_bottom(peg, start.target),
            fixed=fixed_at_origin(base_mesh(meshes, settings.clearance_mm), friction=settings.base_friction),
            rim_mm=RIM_MM,
        )
        super().__init__(parts, offset=start.offset, settings=settings, clocks=clocks)
        # A generator of its own, so that clutter leaves the noise of the pictures as it is.
        self._clutter = draw_clutter(settings.look, np.random.default_rng((rig.noise_seed, _CLUTTER_STREAM)))
        self._rig = RigCamera(self._visible_bodies(), DepthMode(settings.depth_mode), settings.look)
        self._sight: Sight | None = None
        self._before: _Visible | None = None

    @property
    def shape(self) -> FusionShape:
        """Which peg is held."""
        return self.target.shape

    @property
    def direction(self) -> float:
        """Which peg and hole it plays: 1 left, the hexagon; -1 right, the cuboid."""
        return self.target.direction

    def grasp(self) -> None:
        """Close on the peg in free air, and take the references."""
        super().grasp()
        self._sight = None

    def move(self, command: NDArray[np.float64]) -> None:
        """Update the commanded offset as an action says, and drive the gripper there, all axes together."""
        dx, dy, dtheta, dz = self._scaled(command)
        now = self.offset
        goal = FusionOffset(
            x_mm=now.x_mm + dx, y_mm=now.y_mm + dy, theta_deg=now.theta_deg + dtheta, z_mm=now.z_mm + dz
        )
        self._sight = None
        self._before = self._visible() if self._settings.picture_delay > 0.0 else None
        self._travel(goal, max(abs(goal.x_mm - now.x_mm), abs(goal.y_mm - now.y_mm), abs(goal.z_mm - now.z_mm)))

    def sight(self) -> Sight:
        """Return what the rig sees now; looked at once, however often it is asked for before the next motion.

        Its noise follows from the episode's and the number of the env step, so that the pictures of an env step are the
        same whether those before were looked at or not.
        """
        if self._sight is None:
            seen = self._visible()
            if self._before is not None:
                seen = seen.mixed(self._before, self._settings.picture_delay)
            random = np.random.default_rng((self._rig_variation.noise_seed, self.env_steps))
            pose = colour_camera_pose(seen.y_m, seen.z_m, self._rig_variation.shift)
            self._sight = self._rig.look(seen.positions_m, pose, random)
        return self._sight

    def _visible(self) -> "_Visible":
        grasped = self.grasped
        peg_m = grasped.held_vertices_m(np.arange(len(grasped.held.mesh.vertices_m)))
        positions_m = [grasped.fixed.mesh.vertices_m, peg_m, grasped.gel_nodes_m(0), grasped.gel_nodes_m(1)]
        return _Visible(
            positions_m=[*positions_m, *(box.vertices_m for box, _ in self._clutter)],
            y_m=(self.offset.y_mm + self.target.y_mm) * 1e-3,
            z_m=(self.offset.z_mm + Z_TARGET_MM) * 1e-3,
        )

    def _lower_end_mm(self, offset: FusionOffset) -> tuple[float, float, float]:
        return offset.x_mm, offset.y_mm + self.target.y_mm, offset.z_mm + Z_TARGET_MM + START_GAP_MM

    def _visible_bodies(self) -> list[Body]:
        """Return base, peg, both gels and clutter, in the order in which `sight` gives their positions."""
        grasped = self.grasped
        solids = ((grasped.fixed.mesh, Label.BASE), (grasped.held.mesh, Label.PEG))
        gel = grasped.gel
        return [
            *(Body(vertex_count=len(mesh.vertices_m), triangles=mesh.triangles, label=label) for mesh, label in solids),
            *(
                Body(vertex_count=len(gel.rest_position_m), triangles=gel.surface_triangles, label=label)
                for label in (Label.LEFT_GEL, Label.RIGHT_GEL)
            ),
            *(
                Body(vertex_count=len(box.vertices_m), triangles=box.triangles, label=label)
                for box, label in self._clutter
            ),
        ]
