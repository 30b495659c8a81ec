"""How each task is best looked at: from where, cut open where, and which of its numbers are shown."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import VitacError
from ..tasks.lock_opening.task import CEILING_Z_M, SUCCESS_Z_RANGE_M
from ..tasks.lock_opening.variation import ENV_ID as LOCK_OPENING
from ..tasks.peg_insertion.task import SUCCESS_DEPTH_MM
from ..tasks.peg_insertion.variation import ENV_ID as PEG_INSERTION
from .projection.section import Plane

FloatArray = NDArray[np.float64]
InfoView = Mapping[str, Any]


class NotDrawable(VitacError):
    """There is no perspective for an environment; the message lists those that there are."""


class Beside(StrEnum):
    """Where a name stands."""

    ABOVE = "above"
    BELOW = "below"
    LEFT = "left"


@dataclass(frozen=True, kw_only=True)
class SectionView:
    """A plane view of both parts, cut.

    Attributes:
        title: what is seen.
        held_cut: where the held part is cut.
        fixed_cut: where the fixed part is cut.
        axes: world axes to the right and upwards, as (index, name).
        limits_mm: what is shown along both: (low, high), (low, high) [mm].
    """

    title: str
    held_cut: Plane
    fixed_cut: Plane
    axes: tuple[tuple[int, str], tuple[int, str]]
    limits_mm: tuple[tuple[float, float], tuple[float, float]]


@dataclass(frozen=True, kw_only=True)
class Progress:
    """Heights by which success is judged.

    Attributes:
        title: what they are the heights of.
        heights_mm: their values from the info of an env step [mm].
        goal_mm: all must be beyond this [mm].
        goal_is_below: whether beyond means below.
    """

    title: str
    heights_mm: Callable[[InfoView], FloatArray]
    goal_mm: float
    goal_is_below: bool


@dataclass(frozen=True, kw_only=True)
class Perspective:
    """How a task is drawn.

    Attributes:
        held_name: of the held part.
        fixed_name: of the fixed part.
        azimuth_deg: of the eye, see `ParallelCamera`.
        elevation_deg: of the eye.
        gel_labels: on which side of the left and of the right gel its name has room.
        cut: the fixed part is taken away on this plane's positive side.
        section: the plane view beside it.
        progress: what the time line shows.
        position: the held part's place, in words, from the info of an env step.
    """

    held_name: str
    fixed_name: str
    azimuth_deg: float
    elevation_deg: float
    gel_labels: tuple[Beside, Beside]
    cut: Plane
    section: SectionView
    progress: Progress
    position: Callable[[InfoView], str]


def perspective_of(env_id: str) -> Perspective:
    """How the task of an environment is drawn.

    Raises:
        NotDrawable: nobody has chosen a view of it yet.
    """
    if env_id not in PERSPECTIVES:
        known = ", ".join(sorted(PERSPECTIVES))
        raise NotDrawable(f"No view of {env_id} has been chosen, so it cannot be drawn; there are views of {known}.")
    return PERSPECTIVES[env_id]


def _peg_position(info: InfoView) -> str:
    x, y, theta = info["gt_offset_mm_deg"]
    return f"offset x {_signed(x)} mm, y {_signed(y)} mm, θ {_signed(theta)}°"


def _signed(value: float) -> str:
    return f"{value:+z.2f}".replace("-", "−")


def _peg_heights_mm(info: InfoView) -> FloatArray:
    return np.asarray(info["peg_relative_z_mm"])


def _key_position(info: InfoView) -> str:
    rear, slot = info["key1_pts_m"], info["lock1_pts_m"]
    x_mm = 1e3 * (rear[:, 0].mean() - slot[:, 0].mean())
    z_mm = 1e3 * (rear[:, 2].mean() - CEILING_Z_M)
    return f"rear tooth from its slot x {_signed(x_mm)} mm, z {_signed(z_mm)} mm"


def _teeth_heights_mm(info: InfoView) -> FloatArray:
    teeth = np.concatenate([info["key1_pts_m"], info["key2_pts_m"]])
    return np.asarray(1e3 * (teeth[:, 2] - CEILING_Z_M))


PERSPECTIVES = {
    PEG_INSERTION: Perspective(
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
            heights_mm=_peg_heights_mm,
            goal_mm=-SUCCESS_DEPTH_MM,
            goal_is_below=True,
        ),
        position=_peg_position,
    ),
    LOCK_OPENING: Perspective(
        held_name="key",
        fixed_name="lock, cut open",
        azimuth_deg=-58.0,
        elevation_deg=24.0,
        gel_labels=(Beside.BELOW, Beside.ABOVE),
        cut=Plane(normal=(0.0, -1.0, 0.0), offset_m=0.0),
        section=SectionView(
            title="key in the lock from the side",
            held_cut=Plane(normal=(0.0, -1.0, 0.0), offset_m=0.0),
            fixed_cut=Plane(normal=(0.0, -1.0, 0.0), offset_m=0.0),
            axes=((0, "x"), (2, "z")),
            limits_mm=((-4.0, 68.0), (-6.0, 48.0)),
        ),
        progress=Progress(
            title="teeth above ceiling [mm]",
            heights_mm=_teeth_heights_mm,
            goal_mm=1e3 * (SUCCESS_Z_RANGE_M[0] - CEILING_Z_M),
            goal_is_below=False,
        ),
        position=_key_position,
    ),
}
