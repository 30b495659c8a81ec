"""One tactile sensor: its reference after the grasp, how far its surface has moved since, and its marker flow."""

import numpy as np
from numpy.typing import NDArray

from ..errors import VitacError
from ..fem.model.mesh import GelMesh
from .camera import camera_frame, mean_distance_m
from .markers import MarkerSettings, SensingSurface, marker_flow

FloatArray = NDArray[np.float64]


class NoReferenceCaptured(VitacError):
    """A sensor was read before its reference was captured; call `capture_reference` after the grasp."""


class TactileSensor:
    """Sees the sensing nodes of a gel from the camera that moves with it.

    The camera's pose is not fitted to boundary nodes: the driven nodes reach their targets exactly, so the pose that
    made the targets is the sensor's pose (challenge-facts 2.4 fits six of them instead, with the same result).
    """

    def __init__(self, mesh: GelMesh, settings: MarkerSettings) -> None:
        self._sensing_nodes = mesh.sensing_nodes
        self._surface = SensingSurface.of_gel(mesh)
        self._settings = settings
        self._reference_m: FloatArray | None = None

    def view_m(self, nodes_m: FloatArray, rotation: FloatArray, centre_m: FloatArray) -> FloatArray:
        """Return the sensing nodes in the camera frame [m], shape [s, 3].

        Args:
            nodes_m: world positions of all gel nodes [m], shape [n, 3].
            rotation: world from gel, shape [3, 3].
            centre_m: gel centre in the world [m], shape [3].
        """
        return camera_frame(nodes_m[self._sensing_nodes], rotation, centre_m)

    def capture_reference(self, view_m: FloatArray) -> None:
        """Take this view as the undisturbed one."""
        self._reference_m = view_m

    def surface_diff_m(self, view_m: FloatArray) -> float:
        """Return the mean distance [m] of the sensing nodes from the reference, in the camera frame."""
        return mean_distance_m(self._reference(), view_m)

    def marker_flow(self, view_m: FloatArray, random: np.random.Generator) -> FloatArray:
        """Return the reference and current marker positions, shape [2, 128, 2] [pixel]."""
        return marker_flow(self._surface, self._reference(), view_m, settings=self._settings, random=random)

    def _reference(self) -> FloatArray:
        if self._reference_m is None:
            raise NoReferenceCaptured("Expected a captured reference; call capture_reference after the grasp.")
        return self._reference_m
