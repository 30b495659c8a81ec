"""What a camera rig saw in an episode, after the reset and each env step: colour and depth pictures as one file."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ..drawing.playback import Playback
from ..drawing.projection.frame import Frame
from ..vision.camera import Sight
from .container import Changes, PlaybackTooLarge, pack

CAMERAS_BYTES: Final = 512 << 10
"""Most that the file may have; pictures with the noise of stereo depth take about 7 kB for each env step."""
_EVERY_PX = (1, 2, 4)
"""Intervals of pixels that are tried until the file is small enough."""
_COLOUR_MASKS = (0xFF, 0xF8, 0xF0, 0xE0, 0xC0)
"""Bits of red, green and blue that are tried until a palette holds all colours."""
_PALETTE = 256
_DEPTH_LEVELS = 254
"""Depths are 1 to 255 between the nearest and the farthest; 0 is unknown."""


def pack_cameras(playback: Playback, *, at_most: int = CAMERAS_BYTES) -> bytes | None:
    """Return the file of an episode; None where the task has no camera rig.

    Args:
        playback: the episode.
        at_most: size of the file [bytes].

    Raises:
        PlaybackTooLarge: even with few pixels it is larger.
    """
    moments = [playback.moments[index] for index in playback.last_moments]
    sights = [moment.sight for moment in moments if moment.sight is not None]
    if not sights:
        return None
    frame, size = Frame.around(sights), 0
    for every in _EVERY_PX:
        content = _packed(sights, frame, every)
        size = len(content)
        if size <= at_most:
            return content
    raise PlaybackTooLarge(f"Expected camera pictures of at most {at_most} bytes, got {size} for {len(sights)} looks.")


def _packed(sights: list[Sight], frame: Frame, every_px: int) -> bytes:
    rows, columns = (slice(part.start, part.stop, every_px) for part in (frame.rows, frame.columns))
    palette, indices = _indexed(np.stack([sight.colours[rows, columns] for sight in sights]))
    depths_mm = 1e3 * np.stack([sight.depth_m[rows, columns] for sight in sights]).astype(np.float64)
    header = {
        "first_row": frame.rows.start,
        "first_column": frame.columns.start,
        "every_px": every_px,
        "nearest_mm": frame.nearest_mm,
        "farthest_mm": frame.farthest_mm,
    }
    arrays: dict[str, NDArray[Any] | Changes] = {
        "palette": palette,
        "colours": Changes(values=indices),
        "depths": _depth_levels(depths_mm, frame),
    }
    return pack(header, arrays)


def _indexed(colours: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return a palette, shape [p, 3], and the index of each pixel's colour in it, [..., 3] to [...]."""
    for mask in _COLOUR_MASKS:
        palette, indices = np.unique((colours & mask).reshape(-1, 3), axis=0, return_inverse=True)
        if len(palette) <= _PALETTE:
            break
    return palette, indices.reshape(colours.shape[:-1]).astype(np.uint8)


def _depth_levels(depths_mm: NDArray[np.float64], frame: Frame) -> NDArray[np.uint8]:
    reach_mm = max(frame.farthest_mm - frame.nearest_mm, 1e-3)
    levels = 1 + np.rint((depths_mm - frame.nearest_mm) / reach_mm * _DEPTH_LEVELS)
    return np.where(depths_mm > 0, np.clip(levels, 1, 1 + _DEPTH_LEVELS), 0).astype(np.uint8)
