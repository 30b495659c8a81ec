"""Rules for teams' sensors: their limits, and what a check finds against them."""

from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Annotated, Self

from pydantic import Field

from ..strict_model import StrictModel, read_yaml


class Rule(StrEnum):
    """A rule that a sensor has to keep to; where it does not, the name is the reason of the refusal."""

    READABLE = "readable"
    """gel.stl is a binary or ASCII STL file."""
    TRIANGLES = "triangles"
    """The surface has few enough triangles, and few enough of them near each other."""
    FINITE = "finite"
    """All coordinates are finite numbers."""
    UNIT = "unit"
    """Its size is that of a gel in millimetres."""
    FLAT = "flat"
    """The surface has an extent in all directions."""
    CLOSED = "closed"
    """Every edge has a triangle on both sides."""
    ORIENTATION = "orientation"
    """Neighbouring triangles look to the same side of the surface."""
    EDGES = "edges"
    """No more than two triangles meet at an edge."""
    INVERTED = "inverted"
    """The triangles look outwards."""
    BODIES = "bodies"
    """The surface is one body."""
    SELF_INTERSECTION = "self_intersection"
    """No triangles cross or lie on each other."""
    BASE_LENGTH = "base_length"
    """Along x it fits the case."""
    BASE_WIDTH = "base_width"
    """Along y it fits the case."""
    BASE_FLAT = "base_flat"
    """The base is a flat rectangle."""
    BEYOND_BASE = "beyond_base"
    """Nothing stands beyond the base."""
    THICKNESS = "thickness"
    """Distance from the base to the highest point."""
    TET_MSH = "tet_msh"
    """tet.msh, where there is one, holds tetrahedra that can be simulated."""
    HEIGHT_FIELD = "height_field"
    """Without a tet.msh there is one height over every point of the base."""
    RESOLUTION = "resolution"
    """Its features are large enough for the nodes that a mesh may have."""
    NODES = "nodes"
    """Number of nodes of the mesh."""
    QUALITY = "quality"
    """Quality of the worst tetrahedron: 6 sqrt(2) volume / (longest edge)^3."""
    VOLUME = "volume"
    """Volume of the mesh compared with that of the STL."""
    DISTANCE = "distance"
    """Distance between the surfaces of the mesh and of the STL."""
    BASE_NODES = "base_nodes"
    """The base of the mesh is exactly the case's."""
    REACH = "reach"
    """A face that senses is among what the grasp can reach."""
    TIPS = "tips"
    """What touches first has nodes enough, so that `surface_diff` does not depend on the mesh; only warned of."""
    MARKERS = "markers"
    """All markers are on the sensing face, in the picture, and apart from each other."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What was found about one rule.

    Attributes:
        rule: the rule.
        ok: the sensor follows it.
        value: what was measured.
        limit: what it may be.
        problem: what to do where the sensor breaks it.
        is_warning: the sensor is scored all the same, but the problem should be known.
    """

    rule: Rule
    ok: bool
    value: str
    limit: str
    problem: str = ""
    is_warning: bool = False

    @classmethod
    def limit_length(cls, rule: Rule, value_mm: float, limit_mm: float, problem: str) -> Self:
        """Return what was found about a length with an upper limit."""
        return cls(
            rule=rule,
            ok=value_mm <= limit_mm,
            value=f"{value_mm:.3f} mm",
            limit=f"at most {limit_mm} mm",
            problem=problem,
        )


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
