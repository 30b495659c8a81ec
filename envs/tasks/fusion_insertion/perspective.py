"""How the fusion task is drawn: the base cut open along both holes, and a section from above."""

from ...geometry.bases import RIM_MM
from ..insertion.perspective import insertion_perspective, section_from_above

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
