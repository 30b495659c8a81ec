"""An array of taxels, the second kind of tactile sensor: each gives the force of the contacts on its part of a gel."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from vitac.errors import VitacError

from ..fem.model.mesh import GelMesh

FloatArray = NDArray[np.float64]
_ARRAYS_KEPT = 8


class NotAnArray(VitacError):
    """An array of taxels has no taxel or an impossible noise; the message names the value."""


@dataclass(frozen=True, kw_only=True)
class TaxelArray:
    """Equal rectangles that cover a sensing face, each with a force along three axes.

    The default has the number of taxels of iCub's fingertip, twelve on 14.5 x 13 mm (Schmitz et al., A Tactile Sensor
    for the Fingertips of the Humanoid Robot iCub, IROS 2010), on a face of 19.25 x 14.75 mm, and the three axes of
    uSkin (XELA XR1944, 16 taxels). Nobody gives the noise of such an array in newtons: ours makes 0.05 N, the smallest
    force that the fingertip detects (Jamali et al., A New Design of a Fingertip for the iCub Hand, IROS 2015), 2.5
    standard deviations. Hysteresis and cross-talk are left out.

    Attributes:
        rows: along v of the sensor's picture.
        columns: along u.
        noise_n: standard deviation of each number [N].
    """

    rows: int = 3
    columns: int = 4
    noise_n: float = 0.02

    def __post_init__(self) -> None:
        if self.rows < 1 or self.columns < 1:
            raise NotAnArray(f"Expected at least one row and one column of taxels, got {self.rows} and {self.columns}.")
        if not 0.0 <= self.noise_n < np.inf:
            raise NotAnArray(f"Expected a noise of 0 N or more, got {self.noise_n}.")

    def forces_n(self, on_nodes_n: FloatArray, gel: GelMesh, rotation: FloatArray) -> FloatArray:
        """Return the forces on the taxels [N], without noise, shape [rows, columns, 3].

        The last axis is shear along u, shear along v, and pressure, which is positive.

        Args:
            on_nodes_n: forces on the nodes of the gel in the world [N], shape [n, 3].
            gel: its mesh.
            rotation: world from gel, shape [3, 3].
        """
        # The picture's u and v run against x and y of the gel, and what presses on it acts against its z.
        along_n = -(rotation[None, :, :] * on_nodes_n[gel.sensing_nodes][:, :, None]).sum(axis=1)
        on_taxels_n = (_shares(self, gel)[:, :, None] * along_n[:, None, :]).sum(axis=0)
        return np.asarray(on_taxels_n.reshape(self.rows, self.columns, 3))


@lru_cache(maxsize=_ARRAYS_KEPT)
def _shares(array: TaxelArray, gel: GelMesh) -> FloatArray:
    """Return which part of a force on each sensing node each taxel feels, shape [s, rows x columns].

    The traction that belongs to a node is spread over the triangles around it as its shape function is.
    """
    from .camera import places_on_faces

    rest_m, faces = gel.rest_position_m, gel.surface_triangles[gel.sensing[gel.surface_triangles].all(axis=1)]
    places = places_on_faces(rest_m, faces)
    at_m = (rest_m[places.corners, :2] * places.weights[:, :, None]).sum(axis=1)
    low_m, high_m = rest_m[faces, :2].min(axis=(0, 1)), rest_m[faces, :2].max(axis=(0, 1))
    sides_m = np.sqrt(places.areas_m2)
    # The picture's u and v run against x and y of the gel.
    across = _overlaps(high_m[0] - at_m[:, 0], sides_m, high_m[0] - low_m[0], array.columns)
    down = _overlaps(high_m[1] - at_m[:, 1], sides_m, high_m[1] - low_m[1], array.rows)
    felt = (down[:, :, None] * across[:, None, :]).reshape(len(at_m), -1) * places.areas_m2[:, None]
    shares = np.zeros((len(gel.sensing_nodes), felt.shape[1]))
    nodes = np.searchsorted(gel.sensing_nodes, places.corners)
    np.add.at(shares, nodes, places.weights[:, :, None] * felt[:, None, :])
    return np.asarray(shares / np.maximum(shares.sum(axis=1, keepdims=True), np.finfo(float).tiny))


def _overlaps(at_m: FloatArray, sides_m: FloatArray, length_m: float, count: int) -> FloatArray:
    """Return which part of squares lies in each of the equal intervals of a length, shape [q, count]."""
    borders_m = np.linspace(0.0, length_m, count + 1)
    ends_m = np.clip((at_m + 0.5 * sides_m)[:, None], borders_m[:-1], borders_m[1:])
    starts_m = np.clip((at_m - 0.5 * sides_m)[:, None], borders_m[:-1], borders_m[1:])
    return np.asarray((ends_m - starts_m) / sides_m[:, None])
