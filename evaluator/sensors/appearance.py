"""How a made sensor looks: faces of its gel, quality of its mesh, markers in the picture. Called by the pages.

Nothing of the simulation is loaded.
"""

from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from ..strict_model import StrictModel
from .made import MadeSensor

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Point = tuple[float, float, float]

DRIVEN, SENSING = 1, 2
"""Kinds of faces; all others are 0."""
QUALITY_BINS = 10
# From the optical centre to the base of every gel.
_EYE_TO_BASE_MM = 18.0


class Appearance(StrictModel):
    """What is drawn of a sensor; the gel stands on its base at z = 0, in millimetres."""

    vertices_mm: tuple[Point, ...]
    triangles: tuple[tuple[int, int, int], ...]
    kinds: tuple[Annotated[int, Field(ge=0, le=2)], ...]
    """0, `DRIVEN` or `SENSING` of each triangle."""
    qualities: tuple[int, ...]
    """Tetrahedra with a quality of 0 to 0.1, of 0.1 to 0.2 and so on."""
    markers_px: tuple[tuple[float, float], ...]
    """Where the camera sees the markers of the undeformed gel."""
    markers_mm: tuple[Point, ...]
    """Where they are printed on it."""


def appearance(made: MadeSensor) -> Appearance:
    """Return how a sensor looks.

    Raises:
        MadeSensorDamaged: the mesh is not the one of its digest.
    """
    import numpy as np
    from vitac.envs.sensor_design.tetrahedra import make_gel

    mesh = made.mesh()
    gel, sensing = make_gel(mesh, name="the gel")
    triangles = gel.surface_triangles
    kinds = np.where(gel.driven[triangles].all(axis=1), DRIVEN, 0)
    rows = {tuple(sorted(row)) for row in sensing.tolist()}
    kinds[[tuple(sorted(row)) in rows for row in triangles.tolist()]] = SENSING
    used, numbers = np.unique(triangles, return_inverse=True)
    counts = np.bincount(
        np.minimum((QUALITY_BINS * mesh.qualities).astype(int), QUALITY_BINS - 1), minlength=QUALITY_BINS
    )
    return Appearance(
        vertices_mm=tuple((x, y, z) for x, y, z in mesh.nodes_mm[used].round(3).tolist()),
        triangles=tuple((a, b, c) for a, b, c in numbers.reshape(-1, 3).tolist()),
        kinds=tuple(kinds.tolist()),
        qualities=tuple(counts.tolist()),
        markers_px=tuple(_markers_px(made)),
        markers_mm=_find_markers(made, mesh.nodes_mm[triangles]),
    )


def _markers_px(made: MadeSensor) -> list[tuple[float, float]]:
    """Return the markers' pixels: they are drawn in the plane of the highest point, with x and y against the gel's."""
    focal_u, focal_v, centre_u, centre_v = made.camera
    depth_mm = _EYE_TO_BASE_MM + made.facts.thickness_mm
    return [(centre_u - focal_u * x / depth_mm, centre_v - focal_v * y / depth_mm) for x, y in made.markers_mm]


def _find_markers(made: MadeSensor, faces: "NDArray[np.float64]") -> tuple[Point, ...]:
    """Return where the camera's rays through the drawn markers leave the gel, as `attach_along_rays` computes it.

    Args:
        made: the sensor.
        faces: corners of the gel's outward faces [mm], shape [f, 3, 3].
    """
    import numpy as np

    eye = np.array([0.0, 0.0, -_EYE_TO_BASE_MM])
    a, b, c = (faces - eye).transpose(1, 0, 2)
    drawn = [(x, y, made.facts.thickness_mm) for x, y in made.markers_mm]
    rays = np.array(drawn).reshape(-1, 3) - eye
    normals = np.cross(b - a, c - a)
    along = rays @ normals.T
    weights = np.stack([rays @ np.cross(b, c).T, rays @ np.cross(c, a).T, rays @ np.cross(a, b).T])
    hits = (along > 0.0) & (weights >= -1e-9 * weights.sum(axis=0)).all(axis=0)
    distances = np.where(hits, (normals * a).sum(axis=1) / np.where(hits, along, 1.0), np.inf).min(
        axis=1, initial=np.inf
    )
    places = (eye + distances[:, None] * rays)[np.isfinite(distances)]
    return tuple((x, y, z) for x, y, z in places.round(3).tolist())
