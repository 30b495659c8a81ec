"""Meshes of gels, soft and rigid parts, and the bodies that they are placed as."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from vitac.errors import VitacError

from ..linear.ordering import Elimination, plan_elimination

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]
MaskArray = NDArray[np.bool_]

# A gel or a rigid part of this task family is millimetres to decimetres large; outside this range the unit is wrong.
SMALLEST_EXTENT_M = 5e-4
LARGEST_EXTENT_M = 0.5
# 6 sqrt(2) V / (longest edge)^3: 1 for a regular tetrahedron, 0 for a flat one.
SMALLEST_TETRAHEDRON_QUALITY = 1e-4
# Boundary faces of a tetrahedron, outward for a positively oriented one.
_FACES = ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))
_EDGES = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))
_TETRAHEDRA_OF_HEXAHEDRON = 5
# Natural coordinates of a hexahedron's nodes, and of the points where two of Gauss' points in each direction stand.
_SIGNS = np.array([(x, y, z) for z in (-1.0, 1.0) for y in (-1.0, 1.0) for x in (-1.0, 1.0)])
_GAUSS = 1.0 / np.sqrt(3.0)
# Part of a hexahedron's volume by which its tetrahedra may miss it: its faces need not be plane.
_CUT_ERROR = 0.25
# Bend of a surface at an edge up to which its two triangles are of one plane: a part of 0.5 m moves by less than 1 um.
_FLAT_RAD = 1e-6


class MeshError(VitacError):
    """A mesh cannot be simulated; the message names the mesh, the element and the value, and what to change."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GelMesh:
    """Mesh of an elastomer, of tetrahedra or of hexahedra.

    Attributes:
        rest_position_m: undeformed node positions [m], shape [n, 3].
        tetrahedra: node indices of positively oriented tetrahedra, shape [t, 4].
        hexahedra: node indices of hexahedra, shape [c, 8], that stand for the tetrahedra where there are any: these
            cut each into five, in the order of the hexahedra, and serve its surface and drawings only. Nodes in the
            order of x fastest, then y, then z: edges are about along the mesh's axes.
        driven: nodes whose motion is prescribed (the back face), shape [n]; none in a part that can move freely.
        sensing: nodes of the sensing surface, shape [n]; none in such a part.
        name: how messages call the mesh (a file name where it has one).

    Raises:
        MeshError: an array has the wrong shape, a coordinate is not finite or not in metres, a tetrahedron is
            inverted or flat, the tetrahedra do not cut the hexahedra, a node belongs to no tetrahedron, none is free,
            or nodes are driven but none is sensing, or the other way round.
    """

    rest_position_m: FloatArray
    tetrahedra: IndexArray
    driven: MaskArray
    sensing: MaskArray
    name: str
    hexahedra: IndexArray = field(default_factory=lambda: np.empty((0, 8), dtype=np.int64))

    def __post_init__(self) -> None:
        nodes = len(self.rest_position_m)
        _check_positions(self.name, self.rest_position_m)
        _check_indices(self.name, "tetrahedron", self.tetrahedra, 4, nodes)
        for label, mask in (("driven", self.driven), ("sensing", self.sensing)):
            if mask.shape != (nodes,) or mask.dtype != np.bool_:
                raise MeshError(
                    f"{self.name}: the {label} mask has shape {mask.shape} and type {mask.dtype}, "
                    f"expected one boolean for each of the {nodes} nodes."
                )
            if not mask.any() and (self.driven.any() or self.sensing.any()):
                raise MeshError(
                    f"{self.name}: no node is {label}; mark at least one of the {nodes} nodes; a part that can "
                    "move freely has neither driven nor sensing ones."
                )
        if self.driven.all():
            raise MeshError(f"{self.name}: all {nodes} nodes are driven, so none is left to solve for; free some.")
        self._check_tetrahedra()
        if self.is_hexahedral:
            self._check_hexahedra()

    def _check_tetrahedra(self) -> None:
        corners = self.rest_position_m[self.tetrahedra]
        volumes = signed_volumes_m3(corners)
        lengths = np.stack(
            [np.sqrt(((corners[:, i] - corners[:, j]) ** 2).sum(axis=1)) for i, j in _EDGES],
            axis=1,
        )
        longest = lengths.max(axis=1)
        # Products rather than a power: the C library's pow may give other bits on another machine.
        quality = 6.0 * np.sqrt(2.0) * volumes / (longest * longest * longest)
        worst = int(quality.argmin())
        if quality[worst] < SMALLEST_TETRAHEDRON_QUALITY:
            fault = "inverted" if volumes[worst] < 0 else "degenerate"
            raise MeshError(
                f"{self.name}: tetrahedron {worst} (nodes {self.tetrahedra[worst].tolist()}) is {fault}: volume "
                f"{volumes[worst]:.3e} m^3, quality {quality[worst]:.3e}, expected at least "
                f"{SMALLEST_TETRAHEDRON_QUALITY:g}; reorder its nodes or remesh."
            )
        unreferenced = np.setdiff1d(np.arange(len(self.rest_position_m)), self.tetrahedra)
        if len(unreferenced):
            raise MeshError(
                f"{self.name}: node {unreferenced[0]} at {self.rest_position_m[unreferenced[0]].tolist()} m belongs to "
                f"no tetrahedron ({len(unreferenced)} such nodes); remove it from the mesh."
            )

    def _check_hexahedra(self) -> None:
        _check_indices(self.name, "hexahedron", self.hexahedra, 8, len(self.rest_position_m))
        expected = np.repeat(self.hexahedra, _TETRAHEDRA_OF_HEXAHEDRON, axis=0)
        if len(expected) != len(self.tetrahedra) or not (self.tetrahedra[:, :, None] == expected[:, None]).any(2).all():
            raise MeshError(
                f"{self.name}: {len(self.tetrahedra)} tetrahedra do not cut {len(self.hexahedra)} hexahedra; expected "
                f"{_TETRAHEDRA_OF_HEXAHEDRON} of the corners of each, in the order of the hexahedra."
            )
        of_tetrahedra = self.volumes_m3.reshape(-1, _TETRAHEDRA_OF_HEXAHEDRON).sum(axis=1)
        wrong = np.abs(self.blocks.volume_m3 - of_tetrahedra) > _CUT_ERROR * of_tetrahedra
        wrong |= (self.blocks.size_m <= 0.0).any(axis=1)
        if wrong.any():
            worst = int(wrong.argmax())
            raise MeshError(
                f"{self.name}: hexahedron {worst} (nodes {self.hexahedra[worst].tolist()}) holds "
                f"{self.blocks.volume_m3[worst]:.3e} m^3 and is {self.blocks.size_m[worst].tolist()} m large, its "
                f"tetrahedra hold {of_tetrahedra[worst]:.3e} m^3; order its nodes with x fastest, then y, then z."
            )

    @cached_property
    def blocks(self) -> "Blocks":
        """What follows from the rest shape of the hexahedra."""
        return measure_blocks(self.rest_position_m[self.hexahedra])

    @property
    def is_hexahedral(self) -> bool:
        """Whether hexahedra carry its elastic energy."""
        return len(self.hexahedra) > 0

    @property
    def elements(self) -> IndexArray:
        """What carries its elastic energy: hexahedra where there are any, else tetrahedra; shape [e, 8 or 4]."""
        return self.hexahedra if self.is_hexahedral else self.tetrahedra

    def node_masses_kg(self, density_kg_m3: float) -> FloatArray:
        """Return the lumped mass of each node [kg], shape [n]: an equal part of every element around it."""
        volumes_m3 = self.blocks.volume_m3 if self.is_hexahedral else self.volumes_m3
        masses = np.zeros(len(self.rest_position_m))
        np.add.at(masses, self.elements, 1.0 / self.elements.shape[1] * density_kg_m3 * volumes_m3[:, None])
        return masses

    @cached_property
    def surface_triangles(self) -> IndexArray:
        """Boundary faces, outward, shape [f, 3], in the order of their tetrahedra."""
        faces = self.tetrahedra[:, _FACES].reshape(-1, 3)
        keys = np.sort(faces, axis=1)
        _, first, counts = np.unique(keys, axis=0, return_index=True, return_counts=True)
        return np.ascontiguousarray(faces[np.sort(first[counts == 1])])

    @cached_property
    def surface_nodes(self) -> IndexArray:
        """Nodes of the boundary faces, ascending, shape [p]."""
        return np.unique(self.surface_triangles)

    @cached_property
    def surface(self) -> tuple[FloatArray, IndexArray]:
        """The boundary as a mesh of its own: rest positions [m] of shape [p, 3] and triangles of shape [f, 3]."""
        triangles = np.searchsorted(self.surface_nodes, self.surface_triangles).astype(np.int64)
        return self.rest_position_m[self.surface_nodes], triangles

    @cached_property
    def surface_edges(self) -> IndexArray:
        """Edges of `surface`, shape [e, 2]."""
        return unique_edges(self.surface[1])

    @cached_property
    def surface_neighbours(self) -> IndexArray:
        """Triangle beyond each edge of `surface`, shape [f, 3]."""
        return find_neighbours(self.surface[1])

    @cached_property
    def volumes_m3(self) -> FloatArray:
        """Rest volumes of the tetrahedra [m^3], shape [t]."""
        return signed_volumes_m3(self.rest_position_m[self.tetrahedra])

    @cached_property
    def rest_gradients_1_m(self) -> FloatArray:
        """Rest gradients of the tetrahedra's linear shape functions [1/m], shape [t, 4, 3].

        The gradient of node a is the inward normal of the face opposite to it, over 6 V.
        """
        corners = self.rest_position_m[self.tetrahedra]
        e1, e2, e3 = (corners[:, i] - corners[:, 0] for i in (1, 2, 3))
        six_volumes = (e1 * np.cross(e2, e3)).sum(axis=1)[:, None]
        inner = np.stack([np.cross(e2, e3), np.cross(e3, e1), np.cross(e1, e2)], axis=1) / six_volumes[:, None]
        return np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1)

    @cached_property
    def elimination(self) -> Elimination:
        """How the free nodes are eliminated so that little fills in."""
        free = np.flatnonzero(~self.driven)
        number = np.full(len(self.driven), -1, dtype=np.int64)
        number[free] = np.arange(len(free))
        corners = range(self.elements.shape[1])
        edges = np.concatenate([self.elements[:, pair] for pair in combinations(corners, 2)])
        edges = np.unique(np.sort(number[edges], axis=1), axis=0)
        edges = edges[edges[:, 0] >= 0]
        return plan_elimination(free, edges, self.rest_position_m[free])

    def released(self) -> "GelMesh":
        """Return the mesh with neither driven nor sensing nodes, for a part that can move freely."""
        none = np.zeros(len(self.driven), dtype=np.bool_)
        return replace(self, driven=none, sensing=none)

    @property
    def is_free(self) -> bool:
        """Whether no node is driven, so that only forces move it."""
        return not self.driven.any()

    @cached_property
    def driven_nodes(self) -> IndexArray:
        """Indices of the driven nodes, ascending, shape [d]."""
        return np.flatnonzero(self.driven)

    @cached_property
    def sensing_nodes(self) -> IndexArray:
        """Indices of the sensing nodes, ascending, shape [s]."""
        return np.flatnonzero(self.sensing)


class Blocks(NamedTuple):
    """Rest shape of hexahedra.

    Attributes:
        volume_m3: [m^3], shape [c].
        size_m: mean length of the edges along the mesh's axes [m], shape [c, 3].
        weights: of their nodes, shape [c, 7, 8]: in the three columns of the mean deformation gradient [1/m], and in
            the four hourglass vectors, see `elastic.hexahedra`.
    """

    volume_m3: FloatArray
    size_m: FloatArray
    weights: FloatArray


def measure_blocks(corners_m: FloatArray) -> Blocks:
    """Return the rest shape of hexahedra with corners of shape [c, 8, 3]; Gauss' points integrate it exactly."""
    volume, mean = np.zeros(len(corners_m)), np.zeros(corners_m.shape)
    for point in product((-_GAUSS, _GAUSS), repeat=3):
        along = 1.0 + _SIGNS * np.array(point)
        others = along[:, [1, 2, 0]] * along[:, [2, 0, 1]]
        slopes = 0.125 * _SIGNS * others
        # Columns of the Jacobian of the place by the natural coordinates, and its cofactors.
        x, y, z = ((slopes[:, k, None] * corners_m).sum(axis=1) for k in range(3))
        cofactors = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)], axis=1)
        volume += (x * cofactors[:, 0]).sum(axis=1)
        mean += (slopes[None, :, :, None] * cofactors[:, None]).sum(axis=2)
    mean /= volume[:, None, None]
    x, y, z = _SIGNS.T
    hourglasses = np.stack([y * z, x * z, x * y, x * y * z])
    affine = (hourglasses[None, :, :, None] * corners_m[:, None]).sum(axis=2)
    corrected = hourglasses[None] - (affine[:, :, None, :] * mean[:, None, :, :]).sum(axis=3)
    return Blocks(
        volume_m3=volume,
        size_m=0.25 * (_SIGNS[None] * corners_m).sum(axis=1),
        weights=np.concatenate([mean.transpose(0, 2, 1), 0.125 * corrected], axis=1),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceMesh:
    """Closed triangle surface of a rigid part.

    Attributes:
        vertices_m: vertex positions in the body frame [m], shape [v, 3].
        triangles: vertex indices, counter-clockwise seen from outside, shape [f, 3].
        name: how messages call the mesh.

    Raises:
        MeshError: an array has the wrong shape, a coordinate is not finite or not in metres, a triangle is degenerate,
            the surface is not closed or inconsistently oriented, or it encloses a negative volume.
    """

    vertices_m: FloatArray
    triangles: IndexArray
    name: str

    def __post_init__(self) -> None:
        _check_positions(self.name, self.vertices_m)
        _check_indices(self.name, "triangle", self.triangles, 3, len(self.vertices_m))
        corners = self.vertices_m[self.triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        areas = 0.5 * np.sqrt((normals**2).sum(axis=1))
        smallest = int(areas.argmin())
        if areas[smallest] < 1e-14:
            raise MeshError(
                f"{self.name}: triangle {smallest} (vertices {self.triangles[smallest].tolist()}) is degenerate: area "
                f"{areas[smallest]:.3e} m^2; remove it or merge its vertices."
            )
        self._check_closed()
        if self.volume_m3 <= 0:
            raise MeshError(
                f"{self.name}: the surface encloses {self.volume_m3:.3e} m^3; its triangles must be counter-clockwise "
                "seen from outside."
            )

    @cached_property
    def edges(self) -> IndexArray:
        """Edges, shape [e, 2]."""
        return unique_edges(self.triangles)

    @cached_property
    def neighbours(self) -> IndexArray:
        """Triangle beyond each edge, shape [f, 3]."""
        return find_neighbours(self.triangles)

    @cached_property
    def convex_edges(self) -> IndexArray:
        """Edges that stand out, shape [e, 2]: nothing touches inside of a flat or a hollow one alone."""
        corners = self.vertices_m[self.triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.sqrt((normals**2).sum(axis=1, keepdims=True))
        along = np.roll(corners, -1, axis=1) - corners
        along /= np.sqrt((along**2).sum(axis=2, keepdims=True))
        # Sine of the angle by which the surface bends away at each edge of each triangle.
        bend = (np.cross(normals[:, None, :], normals[self.neighbours]) * along).sum(axis=2)
        edges = np.stack([self.triangles, np.roll(self.triangles, -1, axis=1)], axis=2)[bend > _FLAT_RAD]
        return np.unique(np.sort(edges, axis=1), axis=0)

    @cached_property
    def moments(self) -> tuple[float, FloatArray, FloatArray]:
        """Volume [m^3], first moment [m^4] of shape [3] and second moment integral of X X^T [m^5] of shape [3, 3].

        Exact: the sum over the signed tetrahedra between the origin and each surface triangle, where
        integral X X^T = V_tet / 20 (sum_i v_i v_i^T + s s^T), s = sum_i v_i.
        """
        corners = self.vertices_m[self.triangles]
        volumes = (np.cross(corners[:, 0], corners[:, 1]) * corners[:, 2]).sum(axis=1) / 6.0
        sums = corners.sum(axis=1)
        first = (volumes[:, None] * sums).sum(axis=0) / 4.0
        outer = (corners[:, :, :, None] * corners[:, :, None, :]).sum(axis=1) + sums[:, :, None] * sums[:, None, :]
        return (
            float(volumes.sum()),
            first,
            (volumes[:, None, None] * outer).sum(axis=0) / 20.0,
        )

    @property
    def volume_m3(self) -> float:
        """Enclosed volume [m^3], by the divergence theorem."""
        return self.moments[0]

    def _check_closed(self) -> None:
        directed = np.concatenate([self.triangles[:, [i, (i + 1) % 3]] for i in range(3)])
        forward = {(int(a), int(b)) for a, b in directed}
        for a, b in directed:
            if (int(b), int(a)) not in forward:
                raise MeshError(
                    f"{self.name}: the surface is open at the edge between vertices {a} and {b} (only one triangle, or "
                    "two of opposite orientation); close it or turn the triangle."
                )


def unique_edges(triangles: IndexArray) -> IndexArray:
    """Return the undirected edges of a triangle list, each once, smaller index first, ascending, shape [e, 2]."""
    directed = np.concatenate([triangles[:, [i, (i + 1) % 3]] for i in range(3)])
    return np.unique(np.sort(directed, axis=1), axis=0)


def find_neighbours(triangles: IndexArray) -> IndexArray:
    """Return the triangle beyond each edge of a closed surface, shape [f, 3]: edge i goes from corner i to i + 1."""
    first, second = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    points = int(triangles.max()) + 1
    there, back = points * first + second, points * second + first
    order = np.argsort(there)
    return np.asarray(order[np.searchsorted(there[order], back)] // 3).reshape(-1, 3)


def signed_volumes_m3(corners_m: FloatArray) -> FloatArray:
    """Return the volumes [m^3] of tetrahedra with corners of shape [t, 4, 3]; positive when positively oriented."""
    a, b, c = (corners_m[:, i] - corners_m[:, 0] for i in (1, 2, 3))
    return np.asarray((np.cross(a, b) * c).sum(axis=1) / 6.0)


def _check_positions(name: str, positions_m: FloatArray) -> None:
    if positions_m.ndim != 2 or positions_m.shape[1] != 3 or len(positions_m) < 4 or positions_m.dtype != np.float64:
        raise MeshError(
            f"{name}: positions have shape {positions_m.shape} and type {positions_m.dtype}, expected float64 [n, 3] "
            "with n of at least 4."
        )
    finite = np.isfinite(positions_m).all(axis=1)
    if not finite.all():
        node = int(np.flatnonzero(~finite)[0])
        raise MeshError(f"{name}: node {node} has the non-finite position {positions_m[node].tolist()} m.")
    extent = float((positions_m.max(axis=0) - positions_m.min(axis=0)).max())
    if not SMALLEST_EXTENT_M <= extent <= LARGEST_EXTENT_M:
        unit = "millimetres" if extent > LARGEST_EXTENT_M else "kilometres or another unit"
        raise MeshError(
            f"{name}: the mesh is {extent:g} m large, expected {SMALLEST_EXTENT_M:g} to {LARGEST_EXTENT_M:g} m; "
            f"are its coordinates in {unit}? They must be in metres."
        )


def _check_indices(name: str, element: str, indices: IndexArray, corners: int, nodes: int) -> None:
    if indices.ndim != 2 or indices.shape[1] != corners or len(indices) == 0 or indices.dtype != np.int64:
        raise MeshError(
            f"{name}: the {element} array has shape {indices.shape} and type {indices.dtype}, expected int64 "
            f"[n, {corners}] with at least one row."
        )
    outside = (indices < 0) | (indices >= nodes)
    if outside.any():
        row = int(np.flatnonzero(outside.any(axis=1))[0])
        raise MeshError(
            f"{name}: {element} {row} names the nodes {indices[row].tolist()}, expected nodes 0 to {nodes - 1}."
        )
    ordered = np.sort(indices, axis=1)
    repeated = (ordered[:, 1:] == ordered[:, :-1]).any(axis=1)
    if repeated.any():
        row = int(np.flatnonzero(repeated)[0])
        raise MeshError(f"{name}: {element} {row} names a node twice: {indices[row].tolist()}.")


# Materials of bodies that are given no other.
GEL_MATERIAL = "gel"
PART_MATERIAL = "part"


@dataclass(frozen=True, kw_only=True)
class PronyBranch:
    """A spring and a damper in series beside a gel's elasticity, see `elastic.viscosity`.

    Attributes:
        modulus_ratio: shear modulus of the spring over that of the gel at rest [-].
        relaxation_time_s: in which its force falls to 1/e [s].
    """

    modulus_ratio: float
    relaxation_time_s: float


@dataclass(frozen=True, kw_only=True, eq=False)
class GelBody:
    """A gel or an elastic part in a scene, placed by world = rotation @ rest + translation.

    Attributes:
        mesh: of tetrahedra or hexahedra.
        rotation: shape [3, 3].
        translation_m: [m], shape [3].
        youngs_modulus_pa: Young's modulus [Pa].
        poisson_ratio: Poisson's ratio [-].
        density_kg_m3: density [kg/m^3].
        friction: friction coefficient [-], for contact models that take the mean of two bodies.
        material: its name, for contact models with friction coefficients by pair of materials.
        viscosity: branches beside the elasticity, whose constants are those of a gel at rest; for hexahedra.
        yeoh: C20 and C30 over C10, see `elastic.yeoh`; for hexahedra.
        stiffening: factor of Young's modulus of each hexahedron, shape [c], in an elastic part of several materials;
            None for one. Viscosity and Yeoh's terms are those of the body.
        motion: where its driven nodes are at a time [s] after the scene was built, from where they were placed [m],
            shape [3]; None where they stay or a gripper moves them. It can be pickled.
    """

    mesh: GelMesh
    rotation: FloatArray
    translation_m: FloatArray
    youngs_modulus_pa: float = 3e5
    poisson_ratio: float = 0.3
    density_kg_m3: float = 1000.0
    friction: float = 87.5
    material: str = GEL_MATERIAL
    viscosity: tuple[PronyBranch, ...] = ()
    yeoh: tuple[float, float] = (0.0, 0.0)
    stiffening: FloatArray | None = None
    motion: Callable[[float], FloatArray] | None = None


class PointMass(NamedTuple):
    """A weight inside a rigid part.

    Attributes:
        mass_kg: [kg].
        point_m: where it is in the part's frame [m], shape [3].
    """

    mass_kg: float
    point_m: FloatArray


class PointLoad(NamedTuple):
    """A force from outside on a rigid part.

    Attributes:
        force_n: in the world [N], shape [3].
        point_m: where it acts, in the part's frame [m], shape [3].
    """

    force_n: FloatArray
    point_m: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class RigidBody:
    """A rigid part in a scene (an affine body), placed by world = rotation @ body + translation.

    Attributes:
        mesh: closed surface.
        rotation: shape [3, 3].
        translation_m: [m], shape [3].
        density_kg_m3: density [kg/m^3].
        friction: friction coefficient [-], for contact models that take the mean of two bodies.
        material: its name, for contact models with friction coefficients by pair of materials.
        fixed: whether nothing that touches it moves it.
        motion: where a fixed one is at a time [s] after the scene was built, from where it was placed [m], shape [3];
            None for one that never moves. It meets no other fixed part, and can be pickled.
        point_masses: of a movable one, beside its density.
        load: what pulls at a movable one at the end of an IPC step, by the time [s] after the scene was built; None
            for nothing. It can be pickled.
    """

    mesh: SurfaceMesh
    rotation: FloatArray
    translation_m: FloatArray
    density_kg_m3: float = 500.0
    friction: float = 1.0
    material: str = PART_MATERIAL
    fixed: bool = False
    motion: Callable[[float], FloatArray] | None = None
    point_masses: tuple[PointMass, ...] = ()
    load: Callable[[float], PointLoad] | None = None
