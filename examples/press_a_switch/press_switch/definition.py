"""What others need to know of the task: actions, observables, and where its parts lie. Light to import."""

from typing import TYPE_CHECKING

from vitac.envs.observable import Curves, Observable
from vitac.envs.scene.observables import CONTACT_FORCES, marker_flow
from vitac.envs.tasks.definition import (
    OPTIONAL_SENSORS,
    SURFACE_DIFF,
    ActionComponent,
    Better,
    Measure,
    TaskDefinition,
)

if TYPE_CHECKING:
    from .scene import SwitchScene

CLOSES_AT_N = 5.0
"""Force of the finger on the button at which the switch closes."""

TRAVEL: "Observable[SwitchScene]" = Observable(
    name="travel",
    shape=(1,),
    unit="mm",
    meaning="How far the gripper has come down since the start.",
    read=lambda scene, _: scene.travel_mm(),
    curves=(Curves(title="Travel [mm]", names=("down",)),),
)
GT_HEIGHT: "Observable[SwitchScene]" = Observable(
    name="gt_height",
    shape=(1,),
    unit="mm",
    meaning="Height of the button above its housing.",
    read=lambda scene, _: scene.height_mm(),
    privileged=True,
)

TASK = TaskDefinition(
    env_id="Switch/Press-v1",
    environment="press_switch.env:SwitchEnv",
    actions=(ActionComponent(name="press", scale=0.5, unit="mm", meaning="Gripper motion downwards."),),
    observables=(GT_HEIGHT, CONTACT_FORCES, TRAVEL, marker_flow("u+ is up for both sensors.")),
    optional_observables=OPTIONAL_SENSORS,
    measures=(
        SURFACE_DIFF,
        Measure(
            name="travel_mm",
            label="travel",
            meaning="way of the gripper down",
            unit="mm",
            needs=("travel",),
            read=lambda info: tuple(info["travel"]),
            better=Better.LOW,
        ),
        Measure(
            name="gap_mm",
            label="finger",
            meaning="gap between finger and button",
            unit="mm",
            needs=("gap_mm",),
            read=lambda info: tuple(info["gap_mm"]),
        ),
    ),
    start_labels=("button {} mm high",),
    perspective="press_switch.perspective:PERSPECTIVE",
    guided_motion="press_switch.perspective:press_slowly",
)
