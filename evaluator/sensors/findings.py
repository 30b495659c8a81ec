"""What is found about a sensor: one finding for each rule, with its value and its limit."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Self


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
