"""How the task is drawn, and what moves where no policy is given."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from vitac.envs.scene.perspective import (
    ActionArray,
    Beside,
    InfoView,
    Perspective,
    Plane,
    ProgressPlot,
    SectionView,
    signed,
)

from .definition import CLOSES_AT_N


def press_slowly(_: dict[str, NDArray[Any]], info: dict[str, Any]) -> ActionArray:
    """Go down by the gap, then by a tenth of a millimetre at a time."""
    return np.array([min(1.0, max(0.2, 2.0 * info["gap_mm"].min()))], dtype=np.float32)


def _position(info: InfoView) -> str:
    return f"{signed(info['gap_mm'].min())} mm, {info['button_force_n']:.1f} N"


PERSPECTIVE = Perspective(
    held_name="finger",
    fixed_name="switch",
    azimuth_deg=-38.0,
    elevation_deg=24.0,
    gel_labels=(Beside.ABOVE, Beside.LEFT),
    cut=Plane(normal=(1.0, 0.0, 0.0), offset_m=0.0),
    section=SectionView(
        title="finger on the switch from the side",
        held_cut=Plane(normal=(0.0, -1.0, 0.0), offset_m=0.0),
        fixed_cut=Plane(normal=(0.0, -1.0, 0.0), offset_m=0.0),
        axes=((0, "x"), (2, "z")),
        limits_mm=((-45.0, 45.0), (-2.0, 65.0)),
    ),
    progress=ProgressPlot(
        title="force on the button [N]",
        heights_mm=lambda info: np.array([info["button_force_n"]]),
        goal_mm=CLOSES_AT_N,
        goal_is_below=False,
    ),
    position=_position,
)
