"""A sensor of somebody's own: gel, camera and markers, each marker attached to the face of the gel that carries it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..fem.model.mesh import GelMesh
from .attachment import Attachment, Fault, attach_along_rays
from .camera import CENTRE_U_PX, CENTRE_V_PX, FOCAL_U_PX, FOCAL_V_PX
from .markers import U_RANGE_PX, V_RANGE_PX

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

MILLIMETRE_M = 1e-3
# From the camera's optical centre to the back face of the gel, for every sensor (challenge-facts 9).
EYE_TO_BACK_MM = 18.0


@dataclass(frozen=True, kw_only=True)
class CameraIntrinsics:
    """A pinhole without distortion, for a picture of 320 x 240 pixels; the defaults are the challenge's.

    Attributes:
        focal_u_px: focal length along the picture's rows.
        focal_v_px: along its columns.
        centre_u_px: where the camera's axis meets the picture.
        centre_v_px: the same, downwards.
    """

    focal_u_px: float = FOCAL_U_PX
    focal_v_px: float = FOCAL_V_PX
    centre_u_px: float = CENTRE_U_PX
    centre_v_px: float = CENTRE_V_PX


@dataclass(frozen=True, kw_only=True, eq=False)
class SensorDesign:
    """What a team designs of a sensor, ready to be simulated.

    A marker is drawn in the plane of the gel's highest point; it is printed where the camera's ray through that place
    leaves the undeformed gel, so that it is seen at that place.

    Attributes:
        gel: the elastomer.
        sensing_triangles: node indices of the faces that sense, outward, shape [s, 3].
        camera: intrinsics.
        markers_mm: x and y in the frame of the gel, shape [m, 2].
    """

    gel: GelMesh
    sensing_triangles: IndexArray
    camera: CameraIntrinsics
    markers_mm: FloatArray

    @cached_property
    def attachment(self) -> Attachment:
        """Where the markers are; `triangles` index the gel's `surface_triangles`."""
        triangles = self.gel.surface_triangles
        through = self._drawn_m
        found = attach_along_rays(
            (0.0, 0.0, self._eye_z_m), through, self.gel.rest_position_m, triangles, self._senses()
        )
        outside = (found.faults == Fault.NONE) & ~self._in_picture(through)
        found.faults[outside] = Fault.OUT_OF_PICTURE
        return found

    @property
    def rest_pixels(self) -> FloatArray:
        """Where the camera sees the markers as drawn [pixel], shape [m, 2]."""
        return self._pixels(self._drawn_m)

    @property
    def _drawn_m(self) -> FloatArray:
        top_m = float(self.gel.rest_position_m[:, 2].max())
        return np.column_stack([self.markers_mm * MILLIMETRE_M, np.full(len(self.markers_mm), top_m)])

    @property
    def _eye_z_m(self) -> float:
        return float(self.gel.rest_position_m[:, 2].min()) - EYE_TO_BACK_MM * MILLIMETRE_M

    def _senses(self) -> NDArray[np.bool_]:
        rows = {tuple(sorted(row)) for row in self.sensing_triangles.tolist()}
        return np.array([tuple(sorted(row)) in rows for row in self.gel.surface_triangles.tolist()], dtype=np.bool_)

    def _pixels(self, points_m: FloatArray) -> FloatArray:
        """Return pixels of points in the frame of the gel; camera x and y are the negated gel axes."""
        depth = points_m[:, 2] - self._eye_z_m
        u = self.camera.focal_u_px * -points_m[:, 0] / depth + self.camera.centre_u_px
        v = self.camera.focal_v_px * -points_m[:, 1] / depth + self.camera.centre_v_px
        return np.column_stack([u, v])

    def _in_picture(self, points_m: FloatArray) -> NDArray[np.bool_]:
        u, v = self._pixels(points_m).T
        return np.asarray((u > U_RANGE_PX[0]) & (u < U_RANGE_PX[1]) & (v > V_RANGE_PX[0]) & (v < V_RANGE_PX[1]))
