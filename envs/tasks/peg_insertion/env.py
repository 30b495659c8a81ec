"""`ViTac/PegInsertion-v1`: insert a peg that is held between two tactile sensors."""

from typing import Any, ClassVar

import numpy as np

from ...fem.model.mesh import SurfaceMesh
from ...geometry.pegs import PegShape
from ..ending import Flags
from ..insertion.env import InsertionEnv
from ..insertion.settings import training_ranges
from .definition import TASK
from .meshes import hole_mesh, peg_mesh
from .scene import PegScene
from .settings import PegInsertionSettings
from .task import judge_flags
from .variation import OFFSET, SHAPE, choose_start


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
    shape_type: ClassVar = PegShape
    training_ranges: ClassVar = training_ranges("hole_friction")
    option_names: ClassVar[tuple[str, ...]] = (SHAPE, OFFSET)

    def _solids(self) -> list[SurfaceMesh]:
        meshes, form = self._meshes, self.settings.form
        return [mesh(meshes, shape, form) for shape in PegShape for mesh in (peg_mesh, hole_mesh)]

    def _start(self, options: dict[str, Any], random: np.random.Generator) -> PegScene:
        settings = self._settings_with_draws()
        start = choose_start(
            options,
            random,
            shapes=self._shapes,
            form=settings.form,
            xy_mm=settings.random_xy_mm,
            theta_deg=settings.random_theta_deg,
        )
        drawn = self._settings_of_episode(random)
        return PegScene(start=start, meshes=self._meshes, settings=drawn, clocks=self._clocks)

    def _judge(self) -> Flags:
        settings = self.settings
        return judge_flags(self.task_scene.state(), max_steps=settings.max_steps, z_step_mm=settings.z_step_mm)
