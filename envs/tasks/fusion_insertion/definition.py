"""The fusion task as others need to know it: actions, observables and where its parts lie."""

from typing import TYPE_CHECKING

import numpy as np

from ...observable import Observable
from ...scene.observables import marker_flow
from ...vision.observables import DEPTH_PICTURE, OBJECT_POINT_CLOUD, POINT_CLOUD, RGB_PICTURE
from ..definition import ActionComponent, TaskDefinition
from ..measures import PEG_HEIGHT, SURFACE_DIFF

if TYPE_CHECKING:
    from .scene import FusionScene

GT_DIRECTION: "Observable[FusionScene]" = Observable(
    name="gt_direction",
    shape=(1,),
    unit="1",
    meaning="Which peg and hole it is: 1 left, the hexagon; -1 right, the cuboid.",
    read=lambda scene, _: np.array([scene.target.direction]),
    privileged=True,
)
GT_OFFSET: "Observable[FusionScene]" = Observable(
    name="gt_offset",
    shape=(4,),
    unit="mm, mm, degree, mm",
    meaning="Commanded offset from the hole [x, y, theta, z]; world frame; the peg ends z - 9.5 mm above the rim.",
    read=lambda scene, _: scene.offset.as_array(),
    privileged=True,
)
RELATIVE_MOTION: "Observable[FusionScene]" = Observable(
    name="relative_motion",
    shape=(4,),
    unit="mm, mm, degree, mm",
    meaning="Commanded gripper motion [dx, dy, dtheta, dz] since the grasp; world frame.",
    read=lambda scene, _: scene.relative_motion_mm_deg(),
)

TASK = TaskDefinition(
    env_id="ViTac/FusionInsertion-v1",
    environment="vitac.envs.tasks.fusion_insertion.env:FusionInsertionEnv",
    actions=(
        ActionComponent(
            name="x",
            scale=1.0,
            unit="mm",
            meaning="Gripper motion along its own x axis; scaled, clipped, then turned by the present angle.",
        ),
        ActionComponent(
            name="y",
            scale=1.0,
            unit="mm",
            meaning="Gripper motion along its own y axis (the grasping direction); as x.",
        ),
        ActionComponent(
            name="theta",
            scale=1.0,
            unit="degree",
            meaning="Rotation about the vertical, counter-clockwise from above.",
        ),
        ActionComponent(name="z", scale=1.0, unit="mm", meaning="Gripper motion upwards."),
    ),
    observables=(
        GT_DIRECTION,
        GT_OFFSET,
        RELATIVE_MOTION,
        RGB_PICTURE,
        DEPTH_PICTURE,
        POINT_CLOUD,
        OBJECT_POINT_CLOUD,
        marker_flow("With the peg unturned u+ is up for both sensors; v+ is -x for the left and +x for the right one."),
    ),
    measures=(SURFACE_DIFF, PEG_HEIGHT),
    perspective="vitac.envs.tasks.fusion_insertion.perspective:PERSPECTIVE",
    guided_motion="vitac.envs.tasks.fusion_insertion.guided_motion:over_the_hole_then_down",
)
