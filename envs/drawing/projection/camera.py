"""The eye of a picture: a parallel projection, in which equal lengths stay equal and depths are linear."""

from dataclasses import dataclass
from functools import cached_property
from math import cos, radians, sin

import numpy as np
from numpy.typing import NDArray

from ...scene.perspective import Plane

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class ParallelCamera:
    """Looks at a point from a direction; the world's z is up in the picture.

    Attributes:
        azimuth_deg: where the eye stands, about z, counter-clockwise from +x [deg].
        elevation_deg: height of the eye above the horizon [deg], less than 90 either way.
        centre_m: the point in the middle of the picture [m].
        height_m: what the picture shows from its lower to its upper edge [m].
        width_px: pixels across.
        height_px: pixels from top to bottom.
    """

    azimuth_deg: float
    elevation_deg: float
    centre_m: tuple[float, float, float]
    height_m: float
    width_px: int
    height_px: int

    @cached_property
    def axes(self) -> FloatArray:
        """Unit vectors to the right, upwards, and away from the eye, as rows, shape [3, 3]."""
        a, e = radians(self.azimuth_deg), radians(self.elevation_deg)
        right = (-sin(a), cos(a), 0.0)
        up = (-cos(a) * sin(e), -sin(a) * sin(e), cos(e))
        away = (-cos(a) * cos(e), -sin(a) * cos(e), -sin(e))
        return np.array([right, up, away])

    def project(self, points_m: FloatArray) -> FloatArray:
        """Return picture coordinates of points: x to the right, y downwards [pixel], depth [m], shape [..., 3]."""
        seen = (points_m - np.array(self.centre_m)) @ self.axes.T
        scale = self.height_px / self.height_m
        x = 0.5 * self.width_px + scale * seen[..., 0]
        y = 0.5 * self.height_px - scale * seen[..., 1]
        return np.stack([x, y, seen[..., 2]], axis=-1)

    def plane_depths_m(self, plane: Plane) -> FloatArray:
        """Return a plane's depth behind every pixel's centre [m], shape [height, width]; it must not be edge-on."""
        right, up, away = self.axes @ np.array(plane.normal)
        start = float(plane.heights_m(np.array(self.centre_m)))
        metre = self.height_m / self.height_px
        x = (np.arange(self.width_px) + 0.5 - 0.5 * self.width_px) * metre
        y = (0.5 * self.height_px - np.arange(self.height_px) - 0.5) * metre
        return np.asarray(-(start + right * x[None, :] + up * y[:, None]) / away)
