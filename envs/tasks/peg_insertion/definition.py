"""The peg task as others need to know it: actions, observables, how it is drawn; light to import."""

from ...scene.observables import CONTACT_FORCES, MEASURED_POSE, SURFACE_POINTS, played_shape
from ..definition import OPTIONAL_SENSORS, SURFACE_DIFF, TaskDefinition
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
from ..quantities import Quantity, symmetric

SUCCESS_DEPTH_MM = 0.3
"""How deep all of the peg's lower end must be below the rim."""

FORM_QUANTITIES = PEG_WIDTH, PEG_TAPER, PEG_BULGE, PEG_SLANT = (
    Quantity(
        name="peg_width",
        unit="1",
        meaning="Width of the peg over that of its shape",
        range=(0.5, 1.4),
        nominal=1.0,
    ),
    symmetric(name="peg_taper", unit="1", meaning="Taper of the peg beyond that of its shape", largest=0.3),
    symmetric(
        name="peg_bulge", unit="1", meaning="Width of the peg's middle third beyond that of its shape", largest=0.3
    ),
    symmetric(
        name="peg_slant_mm", unit="mm", meaning="Slant of the peg from one gripped face to the other", largest=4.0
    ),
)
"""What peg and hole are made by, beside the clearance."""

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
    optional_observables=OPTIONAL_SENSORS,
    measures=(SURFACE_DIFF, PEG_HEIGHT),
    perspective="vitac.envs.tasks.peg_insertion.definition:PERSPECTIVE",
    guided_motion="vitac.envs.tasks.peg_insertion.env:to_the_hole",
    accepts_start="vitac.envs.tasks.peg_insertion.env:accepts_start",
    quantities=(*INSERTION_QUANTITIES, *FORM_QUANTITIES),
    info_lengths={PEG_HEIGHT.name: 8},
)


PERSPECTIVE = insertion_perspective(
    fixed_name="plate",
    section=section_from_above(
        "hole and peg from above", peg_z_m=25e-3, fixed_z_m=19.9e-3, limits_mm=((-30.0, 30.0), (-22.5, 22.5))
    ),
    title="peg above plate [mm]",
    depth_mm=SUCCESS_DEPTH_MM,
)
