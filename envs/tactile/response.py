"""How the markers of a sensor move under small forces on its sensing faces: linear elasticity at rest."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from vitac.errors import VitacError

from ..fem.elastic.neo_hookean import lame_parameters_pa
from ..fem.linear.elimination import factorise, new_factor, substitute
from ..fem.linear.system import NO_PLACE, gel_block_places, system_layout
from ..fem.model.mesh import GelMesh
from .camera import (
    camera_frame,
    places_on_faces,
    project,
)
from .design import SensorDesign
from .gel import eye_distance_m
from .markers import interpolated

FloatArray = NDArray[np.float64]


IndexArray = NDArray[np.int64]


# Step of the differences by which the camera's projection is linearised; its curvature is far below it.
_STEP_M = 1e-6


class NotStiff(VitacError):
    """A gel's stiffness matrix is singular; look for parts that hang on nothing."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Response:
    """Motion of the markers in the picture for a unit force on each sensing node.

    Attributes:
        px_per_n: of all markers' u, then v [px/N], for forces along x, y and z of the gel, shape [2 m, s, 3].
        points_mm: places on the sensing faces, x and y [mm], shape [q, 2].
        areas_mm2: their shares of the faces' area [mm2], shape [q].
        weights: how a force at each place spreads over the sensing nodes, shape [q, s].
    """

    px_per_n: FloatArray
    points_mm: FloatArray
    areas_mm2: FloatArray
    weights: FloatArray

    def motion_px_n(self, pressure: FloatArray) -> FloatArray:
        """Return the motion of the markers under pressures that sum to 1 N [px/N], shape [2 m, 3, p].

        Args:
            pressure: of p loads at the q places, in any unit, shape [q, p]; each is scaled to 1 N.
        """
        forces = pressure * self.areas_mm2[:, None]
        nodal = np.einsum("qs,qp->sp", self.weights, forces / forces.sum(axis=0))
        return np.asarray(np.einsum("isk,sp->ikp", self.px_per_n, nodal))


def compute_response(design: SensorDesign, *, youngs_modulus_pa: float, poisson_ratio: float) -> Response:
    """Return how the markers of a sensor respond to forces.

    Each marker coordinate is a linear function of the nodes' displacements, so one solution with the stiffness matrix
    for each gives its motion under a force on any node (Maxwell and Betti).

    Args:
        design: of the sensor.
        youngs_modulus_pa: of the gel [Pa].
        poisson_ratio: of the gel.

    Raises:
        NotStiff: the stiffness matrix is singular.
    """
    gel = design.gel
    layout = system_layout([gel.elimination], 0)
    entries = np.zeros(layout.size)
    number = np.full(len(gel.rest_position_m), NO_PLACE, dtype=np.int64)
    number[gel.elimination.nodes] = np.arange(len(gel.elimination.nodes))
    blocks = _stiffness_blocks_n_m(gel, youngs_modulus_pa, poisson_ratio)
    for a in range(4):
        for b in range(4):
            rows, columns = number[gel.tetrahedra[:, a]], number[gel.tetrahedra[:, b]]
            places = gel_block_places(layout.neighbours, rows, columns)
            kept = places != NO_PLACE
            np.add.at(entries, places[kept, None] + np.arange(9), blocks[a][b][kept].reshape(-1, 9))
    factor = new_factor(layout)
    if not factorise(layout, entries, factor, True):
        raise NotStiff(f"The stiffness matrix of {gel.name} is not positive definite; mesh the gel again.")
    slopes = _marker_slopes_px_m(design)
    sensing = number[gel.sensing_nodes]
    px_per_n = np.zeros((len(slopes), len(sensing), 3))
    for row, slope in enumerate(slopes):
        x = np.ascontiguousarray(slope[gel.elimination.nodes].reshape(-1))
        substitute(layout, factor, x)
        px_per_n[row] = np.where((sensing != NO_PLACE)[:, None], x.reshape(-1, 3)[sensing], 0.0)
    points_mm, areas_mm2, weights = _places(design)
    return Response(px_per_n=px_per_n, points_mm=points_mm, areas_mm2=areas_mm2, weights=weights)


def _stiffness_blocks_n_m(gel: GelMesh, youngs_modulus_pa: float, poisson_ratio: float) -> list[list[FloatArray]]:
    """Return K_ab = V (lambda g_a g_b^T + mu g_b g_a^T + mu (g_a . g_b) I) of all tetrahedra, shape [t, 3, 3] each.

    The neo-Hookean material at rest is that of linear elasticity (T. J. R. Hughes, The Finite Element Method (2000),
    section 2.7).
    """
    mu, lam = lame_parameters_pa(youngs_modulus_pa, poisson_ratio)
    gradients, volumes = gel.rest_gradients_1_m, gel.volumes_m3[:, None, None]

    def block(a: int, b: int) -> FloatArray:
        outer = gradients[:, a, :, None] * gradients[:, b, None, :]
        inner = (gradients[:, a] * gradients[:, b]).sum(axis=1)[:, None, None] * np.eye(3)
        return np.asarray(volumes * (lam * outer + mu * outer.transpose(0, 2, 1) + mu * inner))

    return [[block(a, b) for b in range(4)] for a in range(4)]


def _marker_slopes_px_m(design: SensorDesign) -> FloatArray:
    """Return how the markers' u, then v, change with the position of every node [px/m], shape [2 m, n, 3]."""
    gel, attachment = design.gel, design.attachment
    corners = gel.surface_triangles[attachment.triangles]
    centres_m = interpolated(gel.rest_position_m, corners, attachment.weights)
    markers = np.arange(len(corners))
    slopes = np.zeros((2, len(corners), len(gel.rest_position_m), 3))
    for axis in range(3):
        step_m = np.zeros(3)
        step_m[axis] = _STEP_M
        ahead, behind = (_pixels(design, centres_m + way * step_m) for way in (1.0, -1.0))
        slope_px_m = (ahead - behind) / (2.0 * _STEP_M)
        for k in range(3):
            for direction in range(2):
                np.add.at(
                    slopes[direction, :, :, axis],
                    (markers, corners[:, k]),
                    attachment.weights[:, k] * slope_px_m[:, direction],
                )
    return slopes.reshape(-1, *slopes.shape[2:])


def _pixels(design: SensorDesign, points_m: FloatArray) -> FloatArray:
    return np.asarray(
        project(camera_frame(points_m, np.eye(3), np.zeros(3), eye_distance_m(design.gel)), design.camera)
    )


def _places(design: SensorDesign) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return places on the sensing faces, their areas, and the weights of the sensing nodes; see `Response`."""
    gel = design.gel
    places = places_on_faces(gel.rest_position_m, design.sensing_triangles)
    points_mm = 1e3 * interpolated(gel.rest_position_m, places.corners, places.weights)[:, :2]
    weights = np.zeros((len(points_mm), len(gel.sensing_nodes)))
    columns = np.searchsorted(gel.sensing_nodes, places.corners)
    np.put_along_axis(weights, columns, places.weights, axis=1)
    return points_mm, 1e6 * places.areas_m2, weights
