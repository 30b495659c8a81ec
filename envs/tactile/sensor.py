"""One tactile sensor: its reference after the grasp, how far its surface has moved since, and its marker flow."""

import numpy as np
from numpy.typing import NDArray
from vitac.errors import VitacError

from ..fem.model.mesh import GelMesh
from .camera import (
    CHALLENGE_CAMERA,
    CameraIntrinsics,
    CameraMount,
    camera_frame,
    mean_distance_m,
    project,
    weighted_distance_m,
)
from .design import SensorDesign
from .gel import eye_distance_m
from .markers import (
    MarkerSettings,
    SensingSurface,
    attach_nodes,
    draw_markers,
    find_in_picture,
    interpolated,
    tracked,
)

FloatArray = NDArray[np.float64]


class NoReferenceCaptured(VitacError):
    """A sensor was read before its reference was captured; call `capture_reference` after the grasp."""


class TactileSensor:
    """Sees the sensing nodes of a gel from the camera that moves with it.

    The camera's pose is not fitted to boundary nodes: the driven nodes reach their targets exactly, so the pose that
    made the targets is the sensor's pose (the 2025 code fits six of them instead, with the same result).

    Attributes:
        gel: the elastomer.
        camera: intrinsics.
        settings: of its markers.
        sees_outside: whether a marker is observed that has left the picture, as the challenge does.
        mount: of the camera, where it is another than the challenge's.
    """

    def __init__(self, mesh: GelMesh, settings: MarkerSettings) -> None:
        self.gel = mesh
        self.settings = settings
        self.camera: CameraIntrinsics = CHALLENGE_CAMERA
        self.sees_outside = True
        self.mount: CameraMount | None = None
        self._eye_distance_m = eye_distance_m(mesh)
        self._reference_m: FloatArray | None = None
        self.lost_px: FloatArray = np.empty((2, 0, 2))
        """Reference and current position of the markers that the last observation lost, shape [2, l, 2]."""

    def view_m(self, nodes_m: FloatArray, rotation: FloatArray, centre_m: FloatArray) -> FloatArray:
        """Return the sensing nodes in the camera frame [m], shape [s, 3].

        Args:
            nodes_m: world positions of all gel nodes [m], shape [n, 3].
            rotation: world from gel, shape [3, 3].
            centre_m: gel centre in the world [m], shape [3].
        """
        return camera_frame(nodes_m[self.gel.sensing_nodes], rotation, centre_m, self._eye_distance_m)

    def capture_reference(self, view_m: FloatArray) -> None:
        """Take this view as the undisturbed one."""
        self._reference_m = view_m

    @property
    def reference_m(self) -> FloatArray:
        """The undisturbed view, camera frame [m], shape [s, 3].

        Raises:
            NoReferenceCaptured: there is none yet.
        """
        return self._reference()

    def surface_diff_m(self, view_m: FloatArray) -> float:
        """Return the mean distance [m] of the sensing face from the reference, in the camera frame.

        It is that of the nodes, as the challenge has it; of a gel of hexahedra, whose nodes stand unevenly, by area.
        """
        if self.gel.is_hexahedral:
            return weighted_distance_m(self._reference(), view_m, self._surface.node_shares)
        return mean_distance_m(self._reference(), view_m)

    def marker_flow(self, view_m: FloatArray, random: np.random.Generator) -> FloatArray:
        """Return the reference and current marker positions, shape [2, 128, 2] [pixel]."""
        flow, kept = draw_markers(self._surface, self._reference(), view_m, self.settings, random)
        return self._track(flow, kept, random)

    def _track(self, flow: FloatArray, kept: NDArray[np.bool_], random: np.random.Generator) -> FloatArray:
        if self.mount is not None:
            flow = self.mount.see(flow)
        if not self.sees_outside:
            kept = kept & find_in_picture(flow[1])
        self.lost_px = flow[:, ~kept]
        return tracked(flow, kept, self.settings, random)

    @property
    def _surface(self) -> SensingSurface:
        return SensingSurface.from_gel(self.gel)

    def _reference(self) -> FloatArray:
        if self._reference_m is None:
            raise NoReferenceCaptured("Expected a captured reference; call capture_reference after the grasp.")
        return self._reference_m


class CoarseSensor(TactileSensor):
    """A gel in few elements, seen as one in more: at the nodes of the finer one, which its sensing face carries."""

    def __init__(self, coarse: GelMesh, fine: GelMesh, settings: MarkerSettings) -> None:
        super().__init__(coarse, settings)
        self._seen_surface = SensingSurface.from_gel(fine)
        self._corners, self._weights = attach_nodes(fine, coarse)

    def view_m(self, nodes_m: FloatArray, rotation: FloatArray, centre_m: FloatArray) -> FloatArray:
        """Return the finer gel's sensing nodes in the camera frame [m], shape [s, 3]; see `TactileSensor`."""
        return interpolated(super().view_m(nodes_m, rotation, centre_m), self._corners, self._weights)

    @property
    def _surface(self) -> SensingSurface:
        return self._seen_surface


class MarkersNotAttached(VitacError):
    """Markers of a design are not on its sensing faces; `vitac sensor check` names them."""


class DesignedSensor(TactileSensor):
    """A sensor of a team's own: its markers stay where they are printed, and the area of what can touch counts.

    The motion of its surface is the mean over the undeformed area of the sensing faces that the grasp can reach: faces
    far below the highest ones touch nothing, and how little they move depends on the mesh.
    Every observation loses markers and adds noise as for all sensors, but never loses the last marker.
    """

    def __init__(self, design: SensorDesign, settings: MarkerSettings) -> None:
        super().__init__(design.gel, settings)
        attachment = design.attachment
        if attachment.faults.any():
            raise MarkersNotAttached(
                f"{int((attachment.faults != 0).sum())} of {len(attachment.faults)} markers "
                "are not on a sensing face of the gel."
            )
        self.camera = design.camera
        self._touched = design.touched
        corners = design.gel.surface_triangles[attachment.triangles]
        self._corners = np.searchsorted(design.gel.sensing_nodes, corners)
        self._weights = attachment.weights

    def surface_diff_m(self, view_m: FloatArray) -> float:
        """Return the mean distance [m] of what the grasp can reach from where it was in the reference."""
        corners, weights, shares = self._touched
        before_m, now_m = (interpolated(side_m, corners, weights) for side_m in (self._reference(), view_m))
        return weighted_distance_m(before_m, now_m, shares)

    def marker_flow(self, view_m: FloatArray, random: np.random.Generator) -> FloatArray:
        """Return the reference and current marker positions, shape [2, 128, 2] [pixel]."""
        seen = [
            project(interpolated(side_m, self._corners, self._weights), self.camera)
            for side_m in (self._reference(), view_m)
        ]
        kept = random.random(len(self._corners)) >= self.settings.loss_probability
        kept[0] |= not kept.any()
        return self._track(np.stack(seen), kept, random)


IndexArray = NDArray[np.int64]
