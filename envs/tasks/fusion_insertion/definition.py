"""The fusion task as others need to know it: actions, observables, how it is drawn; light to import."""

from typing import Protocol

import numpy as np

from ...geometry.bases import RIM_MM
from ...observable import Observable
from ...scene.observables import CONTACT_FORCES, MEASURED_POSE, SURFACE_POINTS, played_shape
from ...vision.observables import DEPTH_PICTURE, OBJECT_POINT_CLOUD, POINT_CLOUD, RGB_PICTURE
from ...vision.stereo.method import METHOD
from ..definition import OPTIONAL_SENSORS, SURFACE_DIFF, ActionComponent, TaskDefinition
from ..insertion.interface import (
    INSERTION_QUANTITIES,
    MARKER_FLOW,
    PEG_HEIGHT,
    gt_offset,
    horizontal_actions,
    insertion_perspective,
    relative_motion,
    section_from_above,
)
from ..quantities import Quantity, setting, symmetric


class HasDirection(Protocol):
    """A scene with a peg and a hole on the left and on the right."""

    @property
    def direction(self) -> float:
        """Which of them is played: 1 left, -1 right."""


GT_DIRECTION: Observable[HasDirection] = Observable(
    name="gt_direction",
    shape=(1,),
    unit="1",
    meaning="Which peg and hole it is: 1 left, the hexagon; -1 right, the cuboid.",
    read=lambda scene, _: np.array([scene.direction]),
    privileged=True,
)

LOOK_QUANTITIES = (
    symmetric(
        name="peg_hue_deg",
        unit="degree",
        meaning="Turn of the peg's hue",
        largest=180.0,
        apply=setting("look.peg_hue_deg"),
    ),
    symmetric(
        name="base_hue_deg",
        unit="degree",
        meaning="Turn of the base's hue",
        largest=180.0,
        apply=setting("look.base_hue_deg"),
    ),
    Quantity(
        name="brightness",
        unit="1",
        meaning="Brightness of the picture",
        range=(0.2, 1.2),
        nominal=1.0,
        apply=setting("look.brightness"),
    ),
    symmetric(
        name="light_deg",
        unit="degree",
        meaning="Turn of the light about the vertical",
        largest=180.0,
        apply=setting("look.light_deg"),
    ),
    Quantity(
        name="clutter",
        unit="1",
        meaning="Boxes around the base, rounded down",
        range=(0.0, 8.99),
        nominal=0.0,
        apply=setting("look.clutter"),
    ),
)

CAMERA_QUANTITIES = PICTURE_DELAY, CAMERA_X, CAMERA_Z, CAMERA_TURN = (
    Quantity(
        name="picture_delay",
        unit="1",
        meaning="Part of an env step by which pictures lag behind",
        range=(0.0, 1.0),
        nominal=0.0,
    ),
    symmetric(name="camera_x_mm", unit="mm", meaning="Offset of the cameras along x", largest=20.0),
    symmetric(name="camera_z_mm", unit="mm", meaning="Offset of the cameras in height", largest=20.0),
    symmetric(name="camera_turn_deg", unit="degree", meaning="Turn of the cameras about y", largest=3.0),
)

TASK = TaskDefinition(
    env_id="ViTac/FusionInsertion-v1",
    environment="vitac.envs.tasks.fusion_insertion.env:FusionInsertionEnv",
    actions=(
        *horizontal_actions(xy_mm=1.0, theta_deg=1.0),
        ActionComponent(name="z", scale=1.0, unit="mm", meaning="Gripper motion upwards."),
    ),
    observables=(
        GT_DIRECTION,
        gt_offset("mm, mm, degree, mm", "[x, y, theta, z]; world frame; the peg ends z - 9.5 mm above the rim."),
        relative_motion("the grasp; world frame."),
        RGB_PICTURE,
        DEPTH_PICTURE,
        POINT_CLOUD,
        OBJECT_POINT_CLOUD,
        MARKER_FLOW,
        played_shape("hexagon, cuboid"),
        MEASURED_POSE,
        CONTACT_FORCES,
        SURFACE_POINTS,
    ),
    optional_observables=OPTIONAL_SENSORS,
    measures=(SURFACE_DIFF, PEG_HEIGHT),
    methods=(METHOD,),
    perspective="vitac.envs.tasks.fusion_insertion.definition:PERSPECTIVE",
    guided_motion="vitac.envs.tasks.fusion_insertion.env:guide_to_the_hole",
    quantities=(*INSERTION_QUANTITIES, *LOOK_QUANTITIES, *CAMERA_QUANTITIES),
    info_lengths={PEG_HEIGHT.name: 6},
)


PERSPECTIVE = insertion_perspective(
    fixed_name="base",
    section=section_from_above(
        "holes and peg from above",
        peg_z_m=40e-3,
        fixed_z_m=RIM_MM * 1e-3 - 0.1e-3,
        limits_mm=((-52.0, 52.0), (-25.0, 70.0)),
    ),
    title="peg above rim [mm]",
    depth_mm=1.0,
)
