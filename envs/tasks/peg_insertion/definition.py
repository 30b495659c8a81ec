"""The peg task as others need to know it: actions, observables and where its parts lie."""

from ...scene.observables import CONTACT_FORCES, MEASURED_POSE, SURFACE_POINTS, played_shape
from ...vision.observables import RGB_IMAGES
from ..definition import TaskDefinition
from ..insertion.interface import (
    INSERTION_QUANTITIES,
    MARKER_FLOW,
    PEG_HEIGHT,
    gt_offset,
    horizontal_actions,
    relative_motion,
)
from ..measures import SURFACE_DIFF
from ..quantities import Quantity, setting

SUCCESS_DEPTH_MM = 0.3
"""How deep all of the peg's lower end must be below the rim."""

TASK = TaskDefinition(
    env_id="ViTac/PegInsertion-v1",
    environment="vitac.envs.tasks.peg_insertion.env:PegInsertionEnv",
    actions=horizontal_actions(xy_mm=2.0, theta_deg=4.0),
    observables=(
        gt_offset("mm, mm, degree", "[x, y, theta]; world frame."),
        relative_motion("the start; world frame; the descent before the first step is not counted."),
        MARKER_FLOW,
        played_shape("cuboid, trapezoid, concave1"),
        MEASURED_POSE,
        CONTACT_FORCES,
        SURFACE_POINTS,
    ),
    optional_observables=(RGB_IMAGES,),
    measures=(SURFACE_DIFF, PEG_HEIGHT),
    perspective="vitac.envs.tasks.peg_insertion.perspective:PERSPECTIVE",
    guided_motion="vitac.envs.tasks.peg_insertion.guided_motion:to_the_hole",
    accepts_start="vitac.envs.tasks.peg_insertion.variation:accepts_start",
    quantities=(
        *INSERTION_QUANTITIES,
        Quantity(
            name="peg_width",
            unit="1",
            meaning="Width of the peg over that of its shape",
            range=(0.5, 1.4),
            nominal=1.0,
            apply=setting("peg_width"),
        ),
        Quantity(
            name="peg_taper",
            unit="1",
            meaning="Taper of the peg beyond that of its shape",
            range=(-0.3, 0.3),
            nominal=0.0,
            two_sided=True,
            apply=setting("peg_taper"),
        ),
        Quantity(
            name="peg_bulge",
            unit="1",
            meaning="Width of the peg's middle third beyond that of its shape",
            range=(-0.3, 0.3),
            nominal=0.0,
            two_sided=True,
            apply=setting("peg_bulge"),
        ),
        Quantity(
            name="peg_slant_mm",
            unit="mm",
            meaning="Slant of the peg from one gripped face to the other",
            range=(-4.0, 4.0),
            nominal=0.0,
            two_sided=True,
            apply=setting("peg_slant_mm"),
        ),
    ),
    info_lengths={PEG_HEIGHT.name: 8},
)
