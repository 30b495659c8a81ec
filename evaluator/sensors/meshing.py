"""The mesh of a gel that is scored: made by our mesher, or brought as tet.msh and checked against gel.stl."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from vitac.envs.sensor_design.surface import DrawnSurface, placed_on_base
from vitac.envs.sensor_design.tetrahedra import BASE_PLANE_MM, Tetrahedra

from .findings import Finding, Rule, SensorLimits
from .manifest import SensorManifest

if TYPE_CHECKING:
    from vitac.envs.tactile.design import SensorDesign

_METRE_MM = 1000.0
_LARGEST_COORDINATE_M = 1.0
_TETRAHEDRA_PER_NODE = 8
_MAX_PAIRS = 5_000_000


@dataclass(frozen=True, kw_only=True, eq=False)
class MeshedGel:
    """A mesh that keeps to all rules.

    Attributes:
        mesh: with its base at z = 0.
        is_own: it was brought as tet.msh.
        volume_error: against the STL, relative.
        distance_mm: between the surfaces.
    """

    mesh: Tetrahedra
    is_own: bool
    volume_error: float
    distance_mm: float

    @property
    def digest(self) -> str:
        """SHA-256 [hex] of nodes and tetrahedra."""
        return hashlib.sha256(self.mesh.as_bytes()).hexdigest()

    def design(self, manifest: SensorManifest) -> "SensorDesign":
        """Return the sensor that is simulated."""
        from vitac.envs.sensor_design.tetrahedra import make_gel
        from vitac.envs.tactile.design import SensorDesign

        gel, sensing = make_gel(self.mesh, name="the gel")
        return SensorDesign(
            gel=gel,
            sensing_triangles=sensing,
            camera=manifest.camera.intrinsics(),
            markers_mm=manifest.markers.drawn_mm(),
        )


class MeshCheck:
    """The findings about the mesh of a gel whose shape keeps to the rules, and the mesh if it does, too.

    Attributes:
        findings: in the order of the checks.
        meshed: None where a rule is broken.
    """

    def __init__(self, drawn: DrawnSurface, own: Path | None, limits: SensorLimits) -> None:
        from vitac.envs.sensor_design.mesher import max_distance_mm

        self.findings: list[Finding] = []
        self.meshed: MeshedGel | None = None
        self._limits = limits
        length, width = limits.base_length_mm, limits.base_width_mm
        surface = placed_on_base(drawn, length_mm=length, width_mm=width)
        mesh = self._made(surface) if own is None else self._read(own)
        if mesh is None:
            return
        volume_error = abs(mesh.volume_mm3 / surface.volume_mm3 - 1.0)
        distance_mm = max_distance_mm(mesh.surface, surface)
        self.findings += _measured(mesh, volume_error, distance_mm, limits)
        if all(finding.ok for finding in self.findings):
            self.meshed = MeshedGel(
                mesh=mesh, is_own=own is not None, volume_error=volume_error, distance_mm=distance_mm
            )

    def _made(self, surface: DrawnSurface) -> Tetrahedra | None:
        from vitac.envs.sensor_design.columns import WallsTangled
        from vitac.envs.sensor_design.height_field import NotAHeightField
        from vitac.envs.sensor_design.mesher import FeatureBelowResolution, MeshGoal, mesh_height_field
        from vitac.envs.tactile.design import MILLIMETRE_M, TOUCHED_M

        limits = self._limits
        goal = MeshGoal(
            length_mm=limits.base_length_mm,
            width_mm=limits.base_width_mm,
            min_nodes=limits.wanted_nodes,
            max_nodes=limits.max_nodes,
            max_distance_mm=limits.max_distance_mm,
            max_volume_error=limits.max_volume_error,
            min_quality=limits.min_quality,
            tip_depth_mm=TOUCHED_M / MILLIMETRE_M,
            min_tip_nodes=limits.wanted_tip_nodes,
        )
        try:
            return mesh_height_field(surface, goal)
        except (NotAHeightField, WallsTangled) as error:
            self._refuse(Rule.HEIGHT_FIELD, "it is none", "a height field, or a tet.msh", error)
        except FeatureBelowResolution as error:
            self._refuse(Rule.RESOLUTION, "features too small", f"{limits.max_nodes} nodes", error)
        return None

    def _read(self, path: Path) -> Tetrahedra | None:
        """Return the mesh of a tet.msh with the low corner of its box where that of the base is."""
        from vitac.envs.fem.model.mesh import MeshError
        from vitac.envs.sensor_design.tetrahedra import make_gel
        from vitac.envs.tactile.gel import GelFilesError, read_gmsh

        limits = self._limits
        try:
            nodes_m, corners = read_gmsh(path, max_bytes=limits.max_stl_bytes)
        except GelFilesError as error:
            self._refuse(Rule.TET_MSH, "unreadable", "Gmsh 4.1 ASCII", error)
            return None
        if len(nodes_m) > limits.max_nodes:
            self.findings.append(_nodes(len(nodes_m), limits))
            return None
        if fault := _unusable(nodes_m, corners, limits):
            problem = f"{path.name} {fault}; mesh gel.stl again."
            limit = "positive tetrahedra in metres"
            self.findings.append(Finding(rule=Rule.TET_MSH, ok=False, value=fault, limit=limit, problem=problem))
            return None
        to = np.array([0.5 * limits.base_length_mm, 0.5 * limits.base_width_mm, 0.0])
        nodes_mm = nodes_m * _METRE_MM
        mesh = Tetrahedra(nodes_mm=nodes_mm - nodes_mm.min(axis=0) - to, corners=corners)
        try:
            make_gel(mesh, name=path.name)
        except MeshError as error:
            self._refuse(Rule.TET_MSH, "cannot be simulated", "positive tetrahedra in metres", error)
            return None
        return mesh if self._is_body(mesh) else None

    def _is_body(self, mesh: Tetrahedra) -> bool:
        """Look whether tetrahedra meet at whole faces only and do not overlap: then so does their outer surface."""
        from vitac.envs.sensor_design.crossings import NONE, first_crossing

        surface = mesh.surface
        faults = {
            "faces of more than two tetrahedra": mesh.n_shared_faces,
            "edges of its surface where it is not closed": len(surface.open_edges) + len(surface.mixed_edges),
            "edges of its surface where more than two faces meet": len(surface.branching_edges),
            "inverted parts of its surface": int((surface.shell_volumes_mm3() > 0.0).sum()) - 1,
            "crossing faces": int(first_crossing(surface.vertices_mm, surface.triangles, _MAX_PAIRS)[0] != NONE),
        }
        for what, count in faults.items():
            if count:
                problem = "Tetrahedra must fill one body and meet at whole faces; mesh it again."
                finding = Finding(rule=Rule.TET_MSH, ok=False, value=f"{count} {what}", limit="0", problem=problem)
                self.findings.append(finding)
                return False
        self.findings.append(Finding(rule=Rule.TET_MSH, ok=True, value="can be simulated", limit="Gmsh 4.1 ASCII"))
        return True

    def _refuse(self, rule: Rule, value: str, limit: str, error: Exception) -> None:
        self.findings.append(Finding(rule=rule, ok=False, value=value, limit=limit, problem=str(error)))


def _unusable(nodes_m: NDArray[np.float64], corners: NDArray[np.int64], limits: SensorLimits) -> str | None:
    """Return what keeps positions and tetrahedra from being looked at any further."""
    if not np.isfinite(nodes_m).all() or np.abs(nodes_m).max() > _LARGEST_COORDINATE_M:
        return "has coordinates that are not metres"
    if len(corners) > _TETRAHEDRA_PER_NODE * limits.max_nodes:
        return f"has {len(corners)} tetrahedra"
    if (worst := float(Tetrahedra(nodes_mm=nodes_m * _METRE_MM, corners=corners).volumes_mm3.min())) <= 0.0:
        return f"has a tetrahedron with a volume of {worst:.3g} mm3"
    return None


def _measured(mesh: Tetrahedra, volume_error: float, distance_mm: float, limits: SensorLimits) -> Iterator[Finding]:
    quality = float(mesh.qualities.min())
    yield _nodes(len(mesh.nodes_mm), limits)
    yield Finding(
        rule=Rule.QUALITY,
        ok=quality >= limits.min_quality,
        value=f"{quality:.3f}",
        limit=f"at least {limits.min_quality}",
        problem="The worst tetrahedron is too flat; mesh it again.",
    )
    yield Finding(
        rule=Rule.VOLUME,
        ok=volume_error <= limits.max_volume_error,
        value=f"{mesh.volume_mm3:.2f} mm3, {volume_error:.3%} off",
        limit=f"at most {limits.max_volume_error:.1%} off",
        problem="The mesh is not that of gel.stl; mesh it again.",
    )
    advice = "The surface of the mesh is not that of gel.stl; mesh it again."
    yield Finding.limit_length(Rule.DISTANCE, distance_mm, limits.max_distance_mm, advice)
    yield _base_nodes(mesh, limits)


def _nodes(count: int, limits: SensorLimits) -> Finding:
    return Finding(
        rule=Rule.NODES,
        ok=limits.min_nodes <= count <= limits.max_nodes,
        value=str(count),
        limit=f"{limits.min_nodes} to {limits.max_nodes}",
        problem="Mesh it finer or coarser.",
    )


def _base_nodes(mesh: Tetrahedra, limits: SensorLimits) -> Finding:
    """Look whether the low nodes reach to the edge of the case's rectangle, and the faces between them fill it."""
    base = mesh.nodes_mm[mesh.nodes_mm[:, 2] <= BASE_PLANE_MM][:, :2]
    sides = np.array([limits.base_length_mm, limits.base_width_mm])
    half = 0.5 * sides
    off = max(float(np.abs(base.max(axis=0) - half).max()), float(np.abs(base.min(axis=0) + half).max()))
    free = float(sides.prod() + mesh.surface.area_vectors_mm2[mesh.base_faces, 2].sum())
    return Finding(
        rule=Rule.BASE_NODES,
        ok=off <= BASE_PLANE_MM and free <= 2.0 * float(sides.sum()) * BASE_PLANE_MM,
        value=f"{len(base)} nodes, outline {off:.4f} mm off, {max(free, 0.0):.2f} mm2 not in its plane",
        limit=f"at most {BASE_PLANE_MM} mm off, all in its plane",
        problem=f"Keep the outline of the base when meshing, and all its nodes within {BASE_PLANE_MM} mm of its plane.",
    )
