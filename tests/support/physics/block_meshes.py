"""Small bodies for tests of the physics: boxes as gels and as rigid surfaces."""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from vitac.envs.fem.model.mesh import GelMesh, SurfaceMesh
from vitac.envs.tactile.gel import GelCells, GelDimensions, structured_gel

FloatArray = NDArray[np.float64]
# A cube cut into six positively oriented tetrahedra around its diagonal (Kuhn), neighbours matching.
_KUHN = ((0, 1, 3, 7), (0, 3, 2, 7), (0, 2, 6, 7), (0, 6, 4, 7), (0, 4, 5, 7), (0, 5, 1, 7))
_BOX = (
    ((0, 2, 3), (0, 3, 1)),
    ((4, 5, 7), (4, 7, 6)),
    ((0, 1, 5), (0, 5, 4)),
    ((2, 6, 7), (2, 7, 3)),
    ((0, 4, 6), (0, 6, 2)),
    ((1, 3, 7), (1, 7, 5)),
)


def box_surface(size_m: ArrayLike, low_m: ArrayLike = (0.0, 0.0, 0.0), name: str = "box") -> SurfaceMesh:
    """A box from its lowest corner; vertex i has x, y, z at the high side where bits 0, 1, 2 of i are set."""
    corners = np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)], dtype=float)
    triangles = np.array([triangle for face in _BOX for triangle in face], dtype=np.int64)
    return SurfaceMesh(vertices_m=np.asarray(low_m) + corners * np.asarray(size_m), triangles=triangles, name=name)


def hexahedral_box(size_m: tuple[float, float, float], cells: tuple[int, int, int], name: str = "block") -> GelMesh:
    """A box of hexahedra with its lowest corner at the origin, driven at its bottom; its top is the sensing face."""
    lines = GelCells(x=cells[0], y=cells[1], bevel=0, layers=cells[2], is_hexahedral=True)
    length, width, height = (1e3 * extent for extent in size_m)
    size = GelDimensions(length_mm=length, width_mm=width, thickness_mm=height, bevel_height_mm=0.0, bevel_inset_mm=0.0)
    mesh = structured_gel(name=name, size=size, cells=lines)
    rest = mesh.rest_position_m - mesh.rest_position_m.min(axis=0)
    return replace(mesh, rest_position_m=rest)


def box_gel(
    size_m: tuple[float, float, float],
    cells: tuple[int, int, int],
    *,
    driven: str = "bottom",
    jitter: float = 0.0,
    name: str = "block",
) -> GelMesh:
    """A box of Kuhn-cut cells with its lowest corner at the origin.

    Args:
        size_m: [m].
        cells: along x, y and z.
        driven: "bottom" (z = 0) or "ends" (bottom and top); the top is the sensing face.
        jitter: random displacement of the inner nodes, in parts of a cell.
        name: of the mesh.
    """
    nx, ny, nz = cells
    steps = np.array(size_m) / cells
    z, y, x = np.meshgrid(np.arange(nz + 1), np.arange(ny + 1), np.arange(nx + 1), indexing="ij")
    grid = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    inner = ((grid > 0) & (grid < cells)).all(axis=1).reshape(-1, 1)
    moved = grid + jitter * inner * np.random.default_rng(0).uniform(-1, 1, grid.shape)
    strides = np.array([1, nx + 1, (nx + 1) * (ny + 1)])
    corner = np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)]) @ strides
    origins = grid[(grid < cells).all(axis=1)] @ strides
    tetrahedra = (origins[:, None, None] + corner[np.array(_KUHN)][None]).reshape(-1, 4)
    top, bottom = grid[:, 2] == nz, grid[:, 2] == 0
    return GelMesh(
        rest_position_m=np.ascontiguousarray(moved * steps),
        tetrahedra=np.ascontiguousarray(tetrahedra.astype(np.int64)),
        driven=bottom | top if driven == "ends" else bottom,
        sensing=top,
        name=name,
    )
