"""How the peg task is drawn: the plate cut open at the hole's middle, and a section from above."""

import numpy as np

from ...scene.perspective import Beside, FloatArray, InfoView, Perspective, Plane, Progress, SectionView, signed
from .task import SUCCESS_DEPTH_MM


def _position(info: InfoView) -> str:
    x, y, theta = info["gt_offset_mm_deg"]
    return f"offset x {signed(x)} mm, y {signed(y)} mm, θ {signed(theta)}°"


def _heights_mm(info: InfoView) -> FloatArray:
    return np.asarray(info["peg_relative_z_mm"])


PERSPECTIVE = Perspective(
    held_name="peg",
    fixed_name="plate, cut open",
    azimuth_deg=-38.0,
    elevation_deg=24.0,
    gel_labels=(Beside.ABOVE, Beside.LEFT),
    cut=Plane(normal=(1.0, 0.0, 0.0), offset_m=0.0),
    section=SectionView(
        title="hole and peg from above",
        held_cut=Plane(normal=(0.0, 0.0, 1.0), offset_m=25e-3),
        fixed_cut=Plane(normal=(0.0, 0.0, 1.0), offset_m=19.9e-3),
        axes=((0, "x"), (1, "y")),
        limits_mm=((-30.0, 30.0), (-22.5, 22.5)),
    ),
    progress=Progress(
        title="peg above plate [mm]",
        heights_mm=_heights_mm,
        goal_mm=-SUCCESS_DEPTH_MM,
        goal_is_below=True,
    ),
    position=_position,
)
