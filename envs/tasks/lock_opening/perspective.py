"""How the lock task is drawn: the lock cut open along its middle, and the same section from the side."""

import numpy as np

from ...scene.perspective import Beside, FloatArray, InfoView, Perspective, Plane, Progress, SectionView, signed
from .task import CEILING_Z_M, SUCCESS_Z_RANGE_M

_MIDDLE = Plane(normal=(0.0, -1.0, 0.0), offset_m=0.0)


def _position(info: InfoView) -> str:
    rear, slot = info["key1_pts_m"], info["lock1_pts_m"]
    x_mm = 1e3 * (rear[:, 0].mean() - slot[:, 0].mean())
    z_mm = 1e3 * (rear[:, 2].mean() - CEILING_Z_M)
    return f"rear tooth from its slot x {signed(x_mm)} mm, z {signed(z_mm)} mm"


def _heights_mm(info: InfoView) -> FloatArray:
    teeth = np.concatenate([info["key1_pts_m"], info["key2_pts_m"]])
    return np.asarray(1e3 * (teeth[:, 2] - CEILING_Z_M))


PERSPECTIVE = Perspective(
    held_name="key",
    fixed_name="lock, cut open",
    azimuth_deg=-58.0,
    elevation_deg=24.0,
    gel_labels=(Beside.BELOW, Beside.ABOVE),
    cut=_MIDDLE,
    section=SectionView(
        title="key in the lock from the side",
        held_cut=_MIDDLE,
        fixed_cut=_MIDDLE,
        axes=((0, "x"), (2, "z")),
        limits_mm=((-4.0, 68.0), (-6.0, 48.0)),
    ),
    progress=Progress(
        title="teeth above ceiling [mm]",
        heights_mm=_heights_mm,
        goal_mm=1e3 * (SUCCESS_Z_RANGE_M[0] - CEILING_Z_M),
        goal_is_below=False,
    ),
    position=_position,
)
