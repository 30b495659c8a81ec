"""How the peg task is drawn: the plate cut open at the hole's middle, and a section from above."""

from ..insertion.perspective import insertion_perspective, section_from_above
from .definition import SUCCESS_DEPTH_MM

PERSPECTIVE = insertion_perspective(
    fixed_name="plate",
    section=section_from_above(
        "hole and peg from above", peg_z_m=25e-3, fixed_z_m=19.9e-3, limits_mm=((-30.0, 30.0), (-22.5, 22.5))
    ),
    title="peg above plate [mm]",
    depth_mm=SUCCESS_DEPTH_MM,
)
