"""The part of the cameras' pictures that shows something, with the range of their depths."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...vision.camera import Sight
from ...vision.optics import HEIGHT_PX, WIDTH_PX

_MARGIN_PX = 10


@dataclass(frozen=True, kw_only=True)
class Frame:
    """The part of a picture that is shown, and the depths that colours stand for.

    Attributes:
        rows: from the first to behind the last.
        columns: the same across.
        nearest_mm: smallest depth of the scale.
        farthest_mm: largest depth of the scale.
    """

    rows: slice
    columns: slice
    nearest_mm: float
    farthest_mm: float

    @classmethod
    def around(cls, sights: Sequence[Sight]) -> "Frame":
        """Return the frame around all that is ever seen, with a scale for the first and the last depth picture."""
        shown = np.any([sight.segmentation > 0 for sight in sights], axis=0)
        depths_mm = 1e3 * np.concatenate([sight.depth_m[sight.depth_m > 0] for sight in (sights[0], sights[-1])])
        low, high = np.quantile(depths_mm, (0.01, 0.99)) if len(depths_mm) else (0.0, 1000.0)
        return cls(
            rows=widened(np.flatnonzero(shown.any(axis=1)), HEIGHT_PX),
            columns=widened(np.flatnonzero(shown.any(axis=0)), WIDTH_PX),
            nearest_mm=float(low),
            farthest_mm=float(high),
        )


def widened(places: NDArray[np.int64], end: int) -> slice:
    """Return the range of places with a margin, within 0 and `end`; all of it where there is no place."""
    if len(places) == 0:
        return slice(0, end)
    return slice(max(0, int(places.min()) - _MARGIN_PX), min(end, int(places.max()) + 1 + _MARGIN_PX))
