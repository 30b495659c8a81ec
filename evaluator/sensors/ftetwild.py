"""Meshes a gel with fTetWild, where the team has installed `pytetwild`: only to look at, never scored."""

from contextlib import chdir
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from vitac.errors import VitacError

from .findings import SensorLimits

if TYPE_CHECKING:
    from vitac.envs.sensor_design.tetrahedra import Tetrahedra

# Edges are about this long, as a part of the box's diagonal: about 250 nodes.
_EDGE_LENGTH = 0.12


class MesherMissing(VitacError):
    """A mesher of others is not installed; the message says how to install it."""


class MesherFailed(VitacError):
    """A mesher of others gave no mesh; check gel.stl first, or take ours."""


def mesh_with_ftetwild(stl: Path, limits: SensorLimits) -> "Tetrahedra":
    """Return the mesh that fTetWild makes of an STL file, with its base at z = 0.

    It has other nodes on every run, so the service never uses it.

    Args:
        stl: a gel that keeps to the rules for shapes.
        limits: of sensors.

    Raises:
        MesherMissing: pytetwild is not installed.
        MesherFailed: it gave no tetrahedra.
        StlError: the file cannot be read.
    """
    import numpy as np
    from vitac.envs.geometry.stl import read_corners
    from vitac.envs.sensor_design.surface import DrawnSurface, placed_on_base
    from vitac.envs.sensor_design.tetrahedra import Tetrahedra

    try:
        from pytetwild import tetrahedralize
    except ImportError as error:
        raise MesherMissing(f"fTetWild is not installed ({error}); install it with `pip install pytetwild`.") from error
    corners = read_corners(stl, max_bytes=limits.max_stl_bytes, max_triangles=limits.max_triangles)
    drawn = DrawnSurface.from_corners(corners)
    surface = placed_on_base(drawn, length_mm=limits.base_length_mm, width_mm=limits.base_width_mm)
    faces = surface.triangles.astype(np.int32)
    with TemporaryDirectory() as scratch, chdir(scratch):  # It leaves files where it runs.
        nodes, cells = tetrahedralize(surface.vertices_mm, faces, edge_length_fac=_EDGE_LENGTH)
    if len(cells) == 0:
        raise MesherFailed("fTetWild gave no tetrahedra; run `vitac sensor check` on the gel.")
    mesh = Tetrahedra(nodes_mm=np.asarray(nodes, np.float64), corners=np.asarray(cells, np.int64))
    if mesh.volume_mm3 > 0.0:
        return mesh
    return Tetrahedra(nodes_mm=mesh.nodes_mm, corners=np.ascontiguousarray(mesh.corners[:, [0, 2, 1, 3]]))
