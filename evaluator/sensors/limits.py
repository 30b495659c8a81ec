"""Limits of a team's own sensor, from `limits.yaml`."""

from functools import cache
from pathlib import Path
from typing import Annotated

from pydantic import Field

from ..strict_model import StrictModel, read_yaml

Millimetres = Annotated[float, Field(gt=0)]
Count = Annotated[int, Field(gt=0)]


class SensorLimits(StrictModel):
    """What every sensor has to keep to."""

    max_stl_bytes: Count
    """Largest size of gel.stl and of tet.msh."""
    max_triangles: Count
    """Maximum number of triangles of gel.stl."""
    base_length_mm: Millimetres
    """Extent of the base along x."""
    base_width_mm: Millimetres
    """Extent of the base along y."""
    base_tolerance_mm: Millimetres
    """For both, and for how far the base may be from flat."""
    min_thickness_mm: Millimetres
    """Distance from the base to the highest point."""
    max_thickness_mm: Millimetres
    """Distance from the base to the highest point."""
    min_nodes: Count
    """Minimum number of nodes of the mesh."""
    max_nodes: Count
    """Maximum number of nodes of the mesh."""
    wanted_nodes: Count
    """The mesher takes the coarsest of its meshes with at least this number."""
    wanted_tip_nodes: Count
    """Nodes that the mesher puts in each part that the grasp reaches, within `max_nodes`."""
    min_quality: Annotated[float, Field(gt=0, lt=1)]
    """Lowest quality of a tetrahedron, 6 sqrt(2) V / (longest edge)^3."""
    max_volume_error: Annotated[float, Field(gt=0, lt=1)]
    """Largest relative difference of the volumes of mesh and STL."""
    max_distance_mm: Millimetres
    """Largest distance between the surfaces of the mesh and of the STL."""
    max_markers: Count
    """Drawn in sensor.yaml."""
    min_marker_spacing_mm: Millimetres
    """Smallest distance between the middles of two drawn markers: the camera would see closer ones as one."""


@cache
def sensor_limits() -> SensorLimits:
    """Return the limits."""
    path = Path(__file__).with_name("limits.yaml")
    return read_yaml(SensorLimits, path)
