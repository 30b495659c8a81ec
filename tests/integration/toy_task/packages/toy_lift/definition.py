"""The toy task as ViTac Arena needs to know it."""

from typing import TYPE_CHECKING

from vitac.envs.observable import Observable
from vitac.envs.scene.observables import marker_flow
from vitac.envs.tasks.definition import ActionComponent, Measure, TaskDefinition
from vitac.envs.tasks.measures import SURFACE_DIFF

if TYPE_CHECKING:
    from .scene import LiftScene

HEIGHT: "Observable[LiftScene]" = Observable(
    name="height",
    shape=(1,),
    unit="mm",
    meaning="Height of the block's lower face above the table.",
    read=lambda scene, _: scene.heights_mm().mean(keepdims=True),
)
GT_PLACE: "Observable[LiftScene]" = Observable(
    name="gt_place",
    shape=(1,),
    unit="mm",
    meaning="Where the block stands along x.",
    read=lambda scene, _: scene.place_mm(),
    privileged=True,
)

TASK = TaskDefinition(
    env_id="Toy/Lift-v1",
    environment="toy_lift.env:LiftEnv",
    actions=(ActionComponent(name="lift", scale=1.0, unit="mm", meaning="Gripper motion upwards."),),
    observables=(GT_PLACE, HEIGHT, marker_flow("u+ is up for both sensors.")),
    measures=(
        SURFACE_DIFF,
        Measure(name="height_mm", label="block", needs=("height_mm",), read=lambda info: tuple(info["height_mm"])),
    ),
    perspective="toy_lift.perspective:PERSPECTIVE",
    guided_motion="toy_lift.perspective:straight_up",
)
