"""How the toy task is drawn, and what moves where no policy is given."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from vitac.envs.scene.guided_motion import ActionArray, longest_action
from vitac.envs.scene.perspective import Beside, InfoView, Perspective, Plane, Progress, SectionView, signed

from .env import LIFTED_MM


def straight_up(_: dict[str, NDArray[Any]], info: dict[str, Any]) -> ActionArray:
    return longest_action(np.array([LIFTED_MM + 0.2 - info["height_mm"].min()]), np.array([1.0]))


def _position(info: InfoView) -> str:
    return f"height {signed(info['height_mm'].min())} mm"


PERSPECTIVE = Perspective(
    held_name="block",
    fixed_name="table",
    azimuth_deg=-38.0,
    elevation_deg=24.0,
    gel_labels=(Beside.ABOVE, Beside.LEFT),
    cut=Plane(normal=(1.0, 0.0, 0.0), offset_m=0.0),
    section=SectionView(
        title="block on the table from the side",
        held_cut=Plane(normal=(0.0, -1.0, 0.0), offset_m=0.0),
        fixed_cut=Plane(normal=(0.0, -1.0, 0.0), offset_m=0.0),
        axes=((0, "x"), (2, "z")),
        limits_mm=((-45.0, 45.0), (-2.0, 65.0)),
    ),
    progress=Progress(
        title="block above table [mm]",
        heights_mm=lambda info: np.asarray(info["height_mm"]),
        goal_mm=LIFTED_MM,
        goal_is_below=False,
    ),
    position=_position,
)
