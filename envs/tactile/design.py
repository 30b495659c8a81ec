"""A sensor of somebody's own: gel, camera and markers, each marker attached to the face of the gel that carries it."""

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from vitac.errors import VitacError

from ..compilation import allocating_kernel
from ..fem.algebra import Vec3, cross, dot, load, subtract
from ..fem.model.mesh import GelMesh
from .camera import CameraIntrinsics, FacePlaces, camera_frame, places_on_faces, project
from .gel import eye_distance_m
from .markers import find_in_picture, interpolated

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

# A face whose normal has a smaller cosine with the ray is seen edge-on.
_EDGE_ON_COSINE = 0.05
# Weights may be this much below 0, so that no marker falls between two triangles.
_WEIGHT_TOLERANCE = 1e-9


class Fault(IntEnum):
    """Why a marker cannot be where it is drawn."""

    NONE = 0
    """The marker can be attached."""
    OFF_THE_GEL = 1
    """The camera's ray through it misses the gel."""
    NOT_ON_SENSING_FACE = 2
    """The ray leaves the gel through a wall or through another face that does not sense."""
    EDGE_ON = 3
    """The face is seen edge-on."""
    OUT_OF_PICTURE = 4
    """The marker is outside the camera's picture."""


class Attachment(NamedTuple):
    """Markers on triangles.

    Attributes:
        triangles: index of each marker's triangle, shape [m]; -1 where the ray misses.
        weights: barycentric, 0 to 1, shape [m, 3].
        faults: `Fault` of each marker, shape [m].
    """

    triangles: IndexArray
    weights: FloatArray
    faults: IndexArray


@allocating_kernel
def attach_along_rays(
    eye: Vec3, through: FloatArray, vertices: FloatArray, triangles: IndexArray, senses: NDArray[np.bool_]
) -> Attachment:
    """Return where rays first leave a closed body.

    Args:
        eye: where all rays begin, outside of the body.
        through: a point on each ray, shape [m, 3].
        vertices: of the body's surface, shape [v, 3].
        triangles: outward, shape [f, 3].
        senses: whether a triangle may carry markers, shape [f].
    """
    chosen = np.full(len(through), -1, dtype=np.int64)
    weights = np.zeros((len(through), 3))
    faults = np.full(len(through), 1, dtype=np.int64)
    for m in range(len(through)):
        ray = subtract(load(through, m), eye)
        nearest = np.inf
        for t in range(len(triangles)):
            a = subtract(load(vertices, triangles[t, 0]), eye)
            b = subtract(load(vertices, triangles[t, 1]), eye)
            c = subtract(load(vertices, triangles[t, 2]), eye)
            normal = cross(subtract(b, a), subtract(c, a))
            along = dot(normal, ray)
            if along <= 0.0:
                continue
            # Volumes of the tetrahedra between the ray and the edges opposite to each corner.
            w0, w1, w2 = dot(ray, cross(b, c)), dot(ray, cross(c, a)), dot(ray, cross(a, b))
            total = w0 + w1 + w2
            least = -_WEIGHT_TOLERANCE * total
            if total <= 0.0 or w0 < least or w1 < least or w2 < least:
                continue
            distance = dot(normal, a) / along
            if distance < nearest:
                nearest = distance
                chosen[m] = t
                w0, w1, w2 = max(w0, 0.0), max(w1, 0.0), max(w2, 0.0)
                total = w0 + w1 + w2
                weights[m, 0], weights[m, 1], weights[m, 2] = w0 / total, w1 / total, w2 / total
                edge_on = along < _EDGE_ON_COSINE * np.sqrt(dot(normal, normal) * dot(ray, ray))
                faults[m] = 2 if not senses[t] else 3 if edge_on else 0
    return Attachment(chosen, weights, faults)


MILLIMETRE_M = 1e-3
TOUCHED_M = 0.875e-3
"""How far the ranked grasp closes after it has touched the highest point [m]; what lies below touches nothing flat."""


class NothingReached(VitacError):
    """A gel touches only with faces that do not sense."""


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
        eye = (0.0, 0.0, -eye_distance_m(self.gel))
        attachment = attach_along_rays(eye, self._drawn_m, self.gel.rest_position_m, triangles, self._senses())
        outside = (attachment.faults == Fault.NONE) & ~find_in_picture(self.rest_pixels)
        attachment.faults[outside] = Fault.OUT_OF_PICTURE
        return attachment

    @property
    def rest_pixels(self) -> FloatArray:
        """Where the camera sees the markers as drawn [pixel], shape [m, 2]."""
        in_camera_m = camera_frame(self._drawn_m, np.eye(3), np.zeros(3), eye_distance_m(self.gel))
        return np.asarray(project(in_camera_m, self.camera))

    @property
    def printed_m(self) -> FloatArray:
        """Where the attached markers are on the undeformed gel [m], shape [a, 3]; others are left out."""
        attachment = self.attachment
        attached = attachment.faults == Fault.NONE
        corners = self.gel.surface_triangles[attachment.triangles[attached]]
        return interpolated(self.gel.rest_position_m, corners, attachment.weights[attached])

    @cached_property
    def touched(self) -> FacePlaces:
        """Places on what the grasp can reach: at most `TOUCHED_M` below the highest point of the gel, undeformed.

        Their areas are shares of the whole. Corners are places among the sensing nodes, ascending.

        Raises:
            NothingReached: no sensing face is there.
        """
        places, depths_m = self._sensing_places
        if self.sensing_depth_m > TOUCHED_M:
            raise NothingReached(
                f"Expected a sensing face at most {TOUCHED_M / MILLIMETRE_M:g} mm below the highest point of the gel, "
                f"got the highest one {self.sensing_depth_m / MILLIMETRE_M:.3f} mm below it."
            )
        reached = places.select(depths_m <= TOUCHED_M)
        return FacePlaces(
            corners=np.searchsorted(self.gel.sensing_nodes, reached.corners),
            weights=reached.weights,
            areas_m2=reached.areas_m2 / reached.areas_m2.sum(),
        )

    @property
    def sensing_depth_m(self) -> float:
        """How far the highest place on a sensing face is below the highest point of the gel [m], undeformed."""
        return float(self._sensing_places[1].min())

    def as_bytes(self) -> bytes:
        """Return what a hash of results has to cover besides the gel: sensing faces, camera and markers."""
        numbers = np.array([*self.camera, *self.markers_mm.reshape(-1)], dtype="<f8")
        return self.sensing_triangles.astype("<i8").tobytes() + numbers.tobytes()

    @cached_property
    def _sensing_places(self) -> tuple[FacePlaces, FloatArray]:
        """Places on the sensing faces, and how far each is below the highest point of the gel [m], undeformed."""
        position_m = self.gel.rest_position_m
        places = places_on_faces(position_m, self.sensing_triangles)
        heights_m = interpolated(position_m, places.corners, places.weights)[:, 2]
        return places, position_m[:, 2].max() - heights_m

    @property
    def _drawn_m(self) -> FloatArray:
        top_m = float(self.gel.rest_position_m[:, 2].max())
        return np.column_stack([self.markers_mm * MILLIMETRE_M, np.full(len(self.markers_mm), top_m)])

    def _senses(self) -> NDArray[np.bool_]:
        rows = {tuple(sorted(row)) for row in self.sensing_triangles.tolist()}
        return np.array([tuple(sorted(row)) in rows for row in self.gel.surface_triangles.tolist()], dtype=np.bool_)
