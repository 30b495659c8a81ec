"""How the fusion task is drawn: the base cut open along both holes, and a section from above."""

import numpy as np

from ...geometry.bases import RIM_MM
from ...scene.perspective import Beside, FloatArray, InfoView, Perspective, Plane, Progress, SectionView, signed


def _position(info: InfoView) -> str:
    x, y, theta, z = info["gt_offset_mm_deg"]
    return f"offset x {signed(x)} mm, y {signed(y)} mm, θ {signed(theta)}°, z {signed(z)} mm"


def _heights_mm(info: InfoView) -> FloatArray:
    return np.asarray(info["peg_relative_z_mm"])


PERSPECTIVE = Perspective(
    held_name="peg",
    fixed_name="base, cut open",
    azimuth_deg=-38.0,
    elevation_deg=24.0,
    gel_labels=(Beside.ABOVE, Beside.LEFT),
    cut=Plane(normal=(1.0, 0.0, 0.0), offset_m=0.0),
    section=SectionView(
        title="holes and peg from above",
        held_cut=Plane(normal=(0.0, 0.0, 1.0), offset_m=40e-3),
        fixed_cut=Plane(normal=(0.0, 0.0, 1.0), offset_m=RIM_MM * 1e-3 - 0.1e-3),
        axes=((0, "x"), (1, "y")),
        limits_mm=((-52.0, 52.0), (-25.0, 70.0)),
    ),
    progress=Progress(
        title="peg above rim [mm]",
        heights_mm=_heights_mm,
        goal_mm=-1.0,
        goal_is_below=True,
    ),
    position=_position,
)
