"""The peg task as others need to know it: actions, observables and where its parts lie."""

from typing import TYPE_CHECKING

from ...observable import Observable
from ...scene.observables import marker_flow
from ..definition import ActionComponent, TaskDefinition
from ..measures import PEG_HEIGHT, SURFACE_DIFF

if TYPE_CHECKING:
    from .scene import PegScene

GT_OFFSET: "Observable[PegScene]" = Observable(
    name="gt_offset",
    shape=(3,),
    unit="mm, mm, degree",
    meaning="Commanded offset from the hole [x, y, theta]; world frame.",
    read=lambda scene, _: scene.offset.as_array(),
    privileged=True,
)
RELATIVE_MOTION: "Observable[PegScene]" = Observable(
    name="relative_motion",
    shape=(4,),
    unit="mm, mm, degree, mm",
    meaning=(
        "Commanded gripper motion [dx, dy, dtheta, dz] since the start; world frame; the descent before the first step "
        "is not counted."
    ),
    read=lambda scene, _: scene.relative_motion_mm_deg(),
)

TASK = TaskDefinition(
    env_id="ViTac/PegInsertion-v1",
    environment="vitac.envs.tasks.peg_insertion.env:PegInsertionEnv",
    actions=(
        ActionComponent(
            name="x",
            scale=2.0,
            unit="mm",
            meaning=(
                "Gripper motion along its own x axis (the peg's long side); scaled, clipped, then turned by the "
                "present angle."
            ),
        ),
        ActionComponent(
            name="y",
            scale=2.0,
            unit="mm",
            meaning="Gripper motion along its own y axis (the grasping direction); as x.",
        ),
        ActionComponent(
            name="theta",
            scale=4.0,
            unit="degree",
            meaning="Rotation about the vertical, counter-clockwise from above.",
        ),
    ),
    observables=(
        GT_OFFSET,
        RELATIVE_MOTION,
        marker_flow("With the peg unturned u+ is up for both sensors; v+ is -x for the left and +x for the right one."),
    ),
    measures=(SURFACE_DIFF, PEG_HEIGHT),
    perspective="vitac.envs.tasks.peg_insertion.perspective:PERSPECTIVE",
    guided_motion="vitac.envs.tasks.peg_insertion.guided_motion:to_the_hole",
)
