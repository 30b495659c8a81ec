"""How insertion tasks are drawn: the fixed part cut open at the hole's middle, and a section from above."""

import numpy as np

from ...scene.perspective import Beside, FloatArray, InfoView, Perspective, Plane, Progress, SectionView, signed


def insertion_perspective(*, fixed_name: str, section: SectionView, title: str, depth_mm: float) -> Perspective:
    """Return the perspective of an insertion task.

    Args:
        fixed_name: of the part with the hole.
        section: the view from above; see `section_from_above`.
        title: of the peg's height in the time line.
        depth_mm: how deep the peg's lower end must be [mm].
    """
    return Perspective(
        held_name="peg",
        fixed_name=f"{fixed_name}, cut open",
        azimuth_deg=-38.0,
        elevation_deg=24.0,
        gel_labels=(Beside.ABOVE, Beside.LEFT),
        cut=Plane(normal=(1.0, 0.0, 0.0), offset_m=0.0),
        section=section,
        progress=Progress(title=title, heights_mm=_heights_mm, goal_mm=-depth_mm, goal_is_below=True),
        position=_position,
    )


def section_from_above(
    title: str, *, peg_z_m: float, fixed_z_m: float, limits_mm: tuple[tuple[float, float], tuple[float, float]]
) -> SectionView:
    """Return the view from above on the peg and the fixed part, each cut at a height of its own [m]."""
    return SectionView(
        title=title,
        held_cut=_level(peg_z_m),
        fixed_cut=_level(fixed_z_m),
        axes=((0, "x"), (1, "y")),
        limits_mm=limits_mm,
    )


def _level(z_m: float) -> Plane:
    return Plane(normal=(0.0, 0.0, 1.0), offset_m=z_m)


def _heights_mm(info: InfoView) -> FloatArray:
    return np.asarray(info["peg_relative_z_mm"])


def _position(info: InfoView) -> str:
    x, y, theta, *z = info["gt_offset_mm_deg"]
    height = "".join(f", z {signed(value)} mm" for value in z)
    return f"offset x {signed(x)} mm, y {signed(y)} mm, θ {signed(theta)}°{height}"
