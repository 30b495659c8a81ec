"""`ViTac/FusionInsertion-v1`: see which hole fits the peg, go there, and insert it by touch."""

from collections.abc import Mapping
from math import radians
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ...fem.model.mesh import SurfaceMesh
from ...vision.observables import OBJECT_POINT_CLOUD
from ...vision.pinhole import RigShift
from ..ending import Flags
from ..insertion.env import InsertionEnv
from ..insertion.settings import training_ranges
from ..randomization import drawn_settings
from ..task_env import Info, Observation
from .definition import TASK
from .info import SeenObjects
from .meshes import base_mesh, peg_mesh
from .scene import FusionScene
from .settings import FusionInsertionSettings
from .task import judge_flags
from .variation import SHAPE, START, FusionShape, Target, choose_rig, choose_start


class FusionInsertionEnv(InsertionEnv[FusionScene, FusionInsertionSettings]):
    """Insert a peg into that of two holes which fits it, by sight and touch.

    A hexagonal or a cuboid peg hangs between two gels above a base with a hexagonal hole at larger y (left) and a
    rectangular one (right), about midway between them. Only the hole of the peg's own shape counts, though the hexagon
    goes into the rectangle too. Every env step moves the gripper as the action says; actions outside -1 to 1 are
    clipped. A camera rig follows the gripper in y and z. World frame: z up, origin at the rectangular hole's centre, in
    the upper face of the plate; the rim is 17.4 mm high.

    The grid of `marker_flow` is drawn again at every observation. Depth is what an active stereo camera measures
    (`depth_mode="stereo"`) or exact ("gt").

    Reset options: `start` (x mm and y mm from the middle between the holes, theta deg, z mm, 1 for left or 0 for
    right), `shape` ("hexagon" or "cuboid"; with `start` it must be that of the side) and `rng_seed`, the integers that
    seed the episode's generator in place of the environment's own. Without `start` one is drawn: x and y within 5 mm,
    theta within 10 degrees, z of 3 to 9 mm, either side.

    Ends: terminated by success (`end_reason` "success"); truncated by a sensing surface that moved more than 1.5 mm
    ("tactile"), an offset beyond 12 mm in x, 30 mm in y, 20 degrees or z of 2.4 to 32.4 mm ("error"), 50 env steps
    ("steps"), or physics that did not converge ("not_converged", after which nothing moves). An end that already
    happened in the reset is in the info of the reset.

    Keyword arguments: those of `TactileTaskEnv`, and fields of `FusionInsertionSettings`.
    """

    task: ClassVar = TASK
    settings_type: ClassVar = FusionInsertionSettings
    shape_type: ClassVar = FusionShape
    training_ranges: ClassVar = training_ranges("base_friction")
    option_names: ClassVar[tuple[str, ...]] = (START, SHAPE)

    def reset(self, *, seed: int | None = None, options: Mapping[str, Any] | None = None) -> tuple[Observation, Info]:
        """Start an episode; see the class for the options.

        Raises:
            ResetOptionsError: an option is unknown or out of range.
        """
        observation, info = super().reset(seed=seed, options=options)
        return observation, {**info, **self._seen_objects()}

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, Info]:
        """Play one env step.

        Raises:
            ActionError: the action has another shape than the action space or is not finite.
        """
        observation, value, terminated, truncated, info = super().step(action)
        return observation, value, terminated, truncated, {**info, **self._seen_objects()}

    def _solids(self) -> list[SurfaceMesh]:
        pegs = [peg_mesh(self._meshes, target) for target in Target]
        return [*pegs, base_mesh(self._meshes, self.settings.clearance_mm)]

    def _start(self, options: dict[str, Any], random: np.random.Generator) -> FusionScene:
        settings = self.settings
        start = choose_start(
            options,
            random,
            shapes=self._shapes,
            xy_mm=settings.random_xy_mm,
            theta_deg=settings.random_theta_deg,
            z_mm=settings.random_z_mm,
        )
        if settings.random_physics:
            drawn = drawn_settings(settings, self.training_ranges, random)
        else:
            drawn = self._settings_of_episode(random)
        return FusionScene(
            start=start,
            meshes=self._meshes,
            settings=drawn,
            clocks=self._clocks,
            rig=choose_rig(
                random,
                turn_rad=settings.random_camera_turn_rad,
                offset_m=settings.random_camera_offset_m,
                placed=RigShift(
                    turn_rad=radians(drawn.camera_turn_deg),
                    offset_m=(drawn.camera_x_mm * 1e-3, 0.0, drawn.camera_z_mm * 1e-3),
                ),
            ),
        )

    def _judge(self) -> Flags:
        settings = self.settings
        return judge_flags(
            self.task_scene.state(), max_steps=settings.max_steps, insertion_depth_mm=settings.insertion_depth_mm
        )

    def _seen_objects(self) -> Info:
        """Return which objects the observed clouds are of; nothing where they are not observed."""
        if OBJECT_POINT_CLOUD not in self._observables:
            return {}
        objects = self.task_scene.sight().objects
        seen: SeenObjects = {"peg_seen": objects.peg_seen, "base_seen": objects.base_seen}
        return {**seen}
