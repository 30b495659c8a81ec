"""Sequences of pictures of a gel whose markers move in a known way: what trackers are measured on."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .gel_picture import GelCamera

Positions = NDArray[np.float64]

_MIDDLE_PX: Final = (160.0, 120.0)
_LIGHT_PX: Final = 60.0
"""Mean movement of the markers at which the light has shifted by the half width of the picture."""
WORN_DARKNESS: Final = 0.35
"""Darkness that is left of a worn marker."""
_GLARE_PICTURES: Final = 3


SMALL_CAMERA: Final = GelCamera(width=448, height=338)
"""Its cut picture has the camera's own pixels, which is the fastest to render."""


def marker_grid(rows: int = 7, columns: int = 9, spacing_px: float = 32.0) -> Positions:
    """Return the centres of printed markers in the cut picture, shape [rows * columns, 2] [pixel]."""
    x = _MIDDLE_PX[0] + spacing_px * (np.arange(columns) - (columns - 1) / 2)
    y = _MIDDLE_PX[1] + spacing_px * (np.arange(rows) - (rows - 1) / 2)
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


@dataclass(frozen=True, kw_only=True)
class Press:
    """What is done to a gel: it grows from nothing and goes back, strongest in the middle of the picture.

    Attributes:
        shear_px: movement along u and v.
        twist_rad: rotation about the middle.
        spread: relative distance from the middle that is added.
        width_px: standard deviation of the bell that all of them have over the picture.
        still: pictures at rest before.
        pictures: pictures in all.
    """

    shear_px: tuple[float, float] = (0.0, 0.0)
    twist_rad: float = 0.0
    spread: float = 0.0
    width_px: float = 120.0
    still: int = 15
    pictures: int = 60

    def markers(self, rest_px: Positions, picture: int) -> Positions:
        """Return where markers are in a picture, shape [n, 2] [pixel]."""
        part = np.sin(np.pi * max(picture - self.still, 0) / (self.pictures - self.still))
        arm = rest_px - _MIDDLE_PX
        bell = np.exp(-0.5 * (arm**2).sum(axis=1, keepdims=True) / self.width_px**2)
        turned = np.stack((-arm[:, 1], arm[:, 0]), axis=1)
        moved: Positions = rest_px + part * bell * (self.shear_px + self.twist_rad * turned + self.spread * arm)
        return moved


class Seen(NamedTuple):
    """A picture of a camera, and where its markers are in the cut picture, shape [n, 2] [pixel]."""

    picture: NDArray[np.uint8]
    markers_px: Positions


@dataclass(frozen=True, kw_only=True)
class PressedGel:
    """A gel that is pressed before its camera.

    Attributes:
        press: what is done to it.
        camera: what it is seen by.
        seed: of the noise, the places of its markers, and which of them are worn or dazzled.
        misprint_px: largest distance of a marker from its grid along u and v.
        worn: number of pale markers.
        dazzled: number of markers that vanish for three pictures in the middle, as under glare.
    """

    press: Press
    camera: GelCamera = field(default_factory=GelCamera)
    seed: int = 0
    misprint_px: float = 1.0
    worn: int = 0
    dazzled: int = 0

    def pictures(self) -> Iterator[Seen]:
        """Yield its pictures."""
        generator = np.random.default_rng(self.seed)
        rest_px = marker_grid()
        rest_px += generator.uniform(-self.misprint_px, self.misprint_px, rest_px.shape)
        chosen = generator.permutation(len(rest_px))
        worn, dazzled = chosen[: self.worn], chosen[self.worn : self.worn + self.dazzled]
        for number in range(self.press.pictures):
            darkness = np.full(len(rest_px), self.camera.darkness)
            darkness[worn] *= WORN_DARKNESS
            if 0 <= number - self.press.pictures // 2 < _GLARE_PICTURES:
                darkness[dazzled] = 0.0
            markers_px = self.press.markers(rest_px, number)
            tilt_x, tilt_y = (markers_px - rest_px).mean(axis=0) / _LIGHT_PX
            picture = self.camera.picture(markers_px, generator, darkness=darkness, tilt=(tilt_x, tilt_y))
            yield Seen(picture, markers_px)
