"""Checks of a drawn gel, gel.stl, before it is meshed; each fault has its own rule."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from vitac.envs.sensor_design.surface import WELDS_MM, DrawnSurface

from .findings import Finding, Rule, SensorLimits

_SMALLEST_GEL_MM, _LARGEST_GEL_MM = 15.0, 40.0
_SMALLEST_EXTENT_MM = 0.01
# Open edges that run along each other so closely are two sides of one.
_CRACK_MM = 0.05
# Of numbers that can be squared and multiplied; single precision ends at 3.4e38.
_LARGEST_COORDINATE = 1e30
# Narrow tests of pairs of triangles, about 0.1 us each.
_MAX_PAIRS = 20_000_000
_UNITS_MM = {"metres": 1000.0, "centimetres": 10.0, "inches": 25.4, "micrometres": 1e-3}

Check = Callable[[DrawnSurface, SensorLimits], Finding]


class ShapeCheck:
    """The findings about one gel.stl, and its surface if it follows all rules.

    Attributes:
        findings: in the order of the checks; after a broken rule come only those that do not rest on it.
        surface: None where a rule is broken.
    """

    def __init__(self, path: Path, limits: SensorLimits) -> None:
        self.findings: list[Finding] = []
        self.surface: DrawnSurface | None = None
        corners = self._read(path, limits)
        if corners is None:
            return
        surface = DrawnSurface.from_corners(corners)
        for stage in _STAGES:
            findings = [check(surface, limits) for check in stage]
            self.findings += findings
            if not all(finding.ok for finding in findings):
                return
        self.surface = surface

    def _read(self, path: Path, limits: SensorLimits) -> NDArray[np.float64] | None:
        from vitac.envs.geometry.stl import StlError, TooManyTriangles, read_corners

        limit = f"at most {limits.max_triangles}"
        try:
            corners = read_corners(path, max_bytes=limits.max_stl_bytes, max_triangles=limits.max_triangles)
        except TooManyTriangles as error:
            self.findings.append(Finding(rule=Rule.TRIANGLES, ok=False, value="more", limit=limit, problem=str(error)))
            return None
        except StlError as error:
            value, limit = "unreadable", "an STL file"
            self.findings.append(Finding(rule=Rule.READABLE, ok=False, value=value, limit=limit, problem=str(error)))
            return None
        self.findings.append(Finding(rule=Rule.READABLE, ok=True, value="STL", limit="an STL file"))
        self.findings.append(Finding(rule=Rule.TRIANGLES, ok=True, value=str(len(corners)), limit=limit))
        bad = int((~(np.abs(corners) <= _LARGEST_COORDINATE)).any(axis=(1, 2)).sum())
        self.findings.append(
            Finding(
                rule=Rule.FINITE,
                ok=bad == 0,
                value=f"{bad} triangles that are not",
                limit="0",
                problem="A coordinate is infinite, too large or no number; export the STL again.",
            )
        )
        return corners if bad == 0 else None


def _unit(surface: DrawnSurface, _: SensorLimits) -> Finding:
    extent = float(surface.extent_mm.max()) if len(surface.triangles) else 0.0
    fits = [name for name, mm in _UNITS_MM.items() if _SMALLEST_GEL_MM <= extent * mm <= _LARGEST_GEL_MM]
    guess = f"; are its coordinates in {fits[0]}?" if fits else ";"
    return Finding(
        rule=Rule.UNIT,
        ok=_SMALLEST_GEL_MM <= extent <= _LARGEST_GEL_MM,
        value=f"{extent:.5g} long",
        limit=f"{_SMALLEST_GEL_MM:g} to {_LARGEST_GEL_MM:g} long",
        problem=f"Expected millimetres{guess} Export the STL in millimetres.",
    )


def _flat(surface: DrawnSurface, _: SensorLimits) -> Finding:
    smallest = float(surface.extent_mm.min())
    return Finding(
        rule=Rule.FLAT,
        ok=smallest >= _SMALLEST_EXTENT_MM,
        value=f"{smallest:.3f} mm thin",
        limit=f"at least {_SMALLEST_EXTENT_MM} mm",
        problem="It is a sheet, expected a body.",
    )


def _closed(surface: DrawnSurface, _: SensorLimits) -> Finding:
    welded = f", with corners within {surface.weld_mm:g} mm as one" if surface.weld_mm > WELDS_MM[0] else ""
    open_edges = surface.open_edges
    advice = _crack(surface) if len(open_edges) else ""
    return _count(Rule.CLOSED, surface, open_edges, f"open edges{welded}", f"Close the holes of the surface{advice}")


def _crack(surface: DrawnSurface) -> str:
    """Return what lies so near the first open edge that it hints at a crack."""
    open_edges = surface.open_edges
    others = np.setdiff1d(open_edges, open_edges[0])
    (start, along), to = surface.vertices_mm[open_edges[0]], surface.vertices_mm[others]
    along = along - start
    part = np.clip(((to - start) * along).sum(axis=1) / (along * along).sum(), 0.0, 1.0)
    apart_mm = np.sqrt(((to - start - part[:, None] * along) ** 2).sum(axis=1))
    if not len(others) or (nearest_mm := float(apart_mm.min())) > _CRACK_MM:
        return ""
    return (
        ", or give both sides of a crack the same corners: that of another open edge at "
        f"{_place(to[apart_mm.argmin()])} mm is {nearest_mm:.2g} mm away from the first one, and corners within "
        f"{WELDS_MM[-1]:g} mm are taken as one"
    )


def _orientation(surface: DrawnSurface, _: SensorLimits) -> Finding:
    advice = "Some triangles look inwards and others outwards; make the normals consistent"
    what = "edges between triangles that do not agree"
    return _count(Rule.ORIENTATION, surface, surface.mixed_edges, what, advice)


def _branching(surface: DrawnSurface, _: SensorLimits) -> Finding:
    advice = "More than two triangles meet at an edge; unite the parts to one body"
    return _count(Rule.EDGES, surface, surface.branching_edges, "edges of more than two triangles", advice)


def _inverted(surface: DrawnSurface, _: SensorLimits) -> Finding:
    return Finding(
        rule=Rule.INVERTED,
        ok=bool((surface.shell_volumes_mm3() > 0.0).any()),
        value=f"volume {surface.volume_mm3:.2f} mm3",
        limit="above 0",
        problem="All triangles look inwards; flip the normals.",
    )


def _bodies(surface: DrawnSurface, _: SensorLimits) -> Finding:
    volumes = surface.shell_volumes_mm3()
    bodies = [shell for shell in range(len(volumes)) if not _is_cavity(surface, volumes, shell)]
    return Finding(
        rule=Rule.BODIES,
        ok=len(bodies) == 1,
        value=str(len(bodies)),
        limit="1",
        problem="Remove loose parts, or unite them with the gel.",
    )


def _is_cavity(surface: DrawnSurface, volumes: NDArray[np.float64], shell: int) -> bool:
    """Return whether a shell looks inwards and lies inside the largest one."""
    outer = int(volumes.argmax())
    if shell == outer or volumes[shell] >= 0.0:
        return False
    point = surface.corners_mm[surface.shells == shell][0, 0]
    return _winding_number(surface.corners_mm[surface.shells == outer] - point) > 0.5


def _winding_number(corners: NDArray[np.float64]) -> float:
    """Return how often a surface goes around the origin (van Oosterom & Strackee 1983, equation 8)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    la, lb, lc = (np.sqrt((side * side).sum(axis=1)) for side in (a, b, c))
    numerator = (a * np.cross(b, c)).sum(axis=1)
    pairs = (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la + (c * a).sum(axis=1) * lb
    return float(np.arctan2(numerator, la * lb * lc + pairs).sum() / (2.0 * np.pi))


def _self_intersection(surface: DrawnSurface, _: SensorLimits) -> Finding:
    from vitac.envs.sensor_design.crossings import NONE, TOO_MANY, first_crossing

    clear = np.flatnonzero(~surface.is_low)
    first, second = first_crossing(surface.vertices_mm, surface.triangles[clear], _MAX_PAIRS, WELDS_MM[-1])
    if first == TOO_MANY:
        return Finding(
            rule=Rule.TRIANGLES,
            ok=False,
            value=f"more than {_MAX_PAIRS} pairs of near triangles",
            limit=f"at most {_MAX_PAIRS}",
            problem="Too many triangles lie near each other to be checked; export it coarser.",
        )
    middle_mm = surface.corners_mm[clear[first]].mean(axis=0)
    return Finding(
        rule=Rule.SELF_INTERSECTION,
        ok=first == NONE,
        value="none" if first == NONE else f"triangles {clear[first]} and {clear[second]}",
        limit="none",
        problem=f"Triangles cross near {_place(middle_mm)} mm; unite the parts to one body.",
    )


def _place(point_mm: NDArray[np.float64]) -> str:
    return "(" + ", ".join(f"{value:.5g}" for value in point_mm) + ")"


def _base_corners(surface: DrawnSurface, limits: SensorLimits) -> tuple[NDArray[np.float64], float]:
    """Return the corners of the base's triangles, shape [f, 3, 3], and their area in the plane [mm2]."""
    low = surface.corners_mm[:, :, 2].max(axis=1) <= surface.vertices_mm[:, 2].min() + limits.base_tolerance_mm
    is_base = low & (surface.area_vectors_mm2[:, 2] < 0.0)
    return surface.corners_mm[is_base], -float(surface.area_vectors_mm2[is_base, 2].sum())


def _base_extent(surface: DrawnSurface, limits: SensorLimits) -> NDArray[np.float64]:
    corners = _base_corners(surface, limits)[0].reshape(-1, 3)[:, :2]
    return np.asarray(corners.max(axis=0) - corners.min(axis=0)) if len(corners) else np.zeros(2)


def _base_length(surface: DrawnSurface, limits: SensorLimits) -> Finding:
    return _base_side(Rule.BASE_LENGTH, surface, limits, axis=0)


def _base_width(surface: DrawnSurface, limits: SensorLimits) -> Finding:
    return _base_side(Rule.BASE_WIDTH, surface, limits, axis=1)


def _base_side(rule: Rule, surface: DrawnSurface, limits: SensorLimits, *, axis: int) -> Finding:
    expected = (limits.base_length_mm, limits.base_width_mm)[axis]
    side_mm = float(_base_extent(surface, limits)[axis])
    return Finding(
        rule=rule,
        ok=_within(side_mm, expected, limits.base_tolerance_mm),
        value=f"{side_mm:.3f} mm",
        limit=f"{expected} mm ± {limits.base_tolerance_mm}",
        problem=(
            f"The case takes a base of {limits.base_length_mm} mm along x and {limits.base_width_mm} mm along y, with "
            "the sensing face towards +z; turn or change the gel."
        ),
    )


def _base_flat(surface: DrawnSurface, limits: SensorLimits) -> Finding:
    extent = _base_extent(surface, limits)
    rectangle = float(extent[0] * extent[1])
    share = _base_corners(surface, limits)[1] / rectangle if rectangle else 0.0
    slack = limits.base_tolerance_mm / limits.base_width_mm
    return Finding(
        rule=Rule.BASE_FLAT,
        ok=abs(share - 1.0) <= slack,
        value=f"{share:.2%} of its rectangle within {limits.base_tolerance_mm} mm",
        limit=f"100 % ± {slack:.2%}",
        problem="The lowest face is glued into the case: make it one flat rectangle without openings.",
    )


def _beyond_base(surface: DrawnSurface, limits: SensorLimits) -> Finding:
    base = _base_corners(surface, limits)[0].reshape(-1, 3)[:, :2]
    body = surface.vertices_mm[:, :2]
    beyond = float(max((base.min(axis=0) - body.min(axis=0)).max(), (body.max(axis=0) - base.max(axis=0)).max()))
    advice = "Parts of the gel stand out beyond its base; pull them in."
    return Finding.limit_length(Rule.BEYOND_BASE, max(beyond, 0.0), limits.base_tolerance_mm, advice)


def _thickness(surface: DrawnSurface, limits: SensorLimits) -> Finding:
    thickness = float(surface.extent_mm[2])
    return Finding(
        rule=Rule.THICKNESS,
        ok=limits.min_thickness_mm - 1e-4 <= thickness <= limits.max_thickness_mm + 1e-4,
        value=f"{thickness:.3f} mm",
        limit=f"{limits.min_thickness_mm:g} to {limits.max_thickness_mm:g} mm",
        problem="Change the gel's height.",
    )


def _within(value: float, expected: float, tolerance: float) -> bool:
    # STL coordinates are single precision, which adds up to 2 um at this size.
    return abs(value - expected) <= tolerance + 2e-6


def _count(rule: Rule, surface: DrawnSurface, edges: NDArray[np.int64], what: str, advice: str) -> Finding:
    ends = (_place(end) for end in surface.vertices_mm[edges[:1].reshape(-1)])
    where = ". The first one is from {} to {} mm.".format(*ends) if len(edges) else "."
    return Finding(rule=rule, ok=not len(edges), value=f"{len(edges)} {what}", limit="0", problem=f"{advice}{where}")


_STAGES: tuple[tuple[Check, ...], ...] = (
    (_unit,),
    (_flat,),
    (_closed, _orientation, _branching),
    (_inverted,),
    (_bodies, _self_intersection),
    (_base_flat,),
    (_base_length, _base_width, _beyond_base, _thickness),
)
