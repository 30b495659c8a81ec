"""Checks a sensor against every rule; called by `vitac sensor` and by what takes sensors in."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import dist
from pathlib import Path
from typing import TYPE_CHECKING

from vitac.envs.untrusted_file import find_spelling
from vitac.errors import VitacError

from .findings import Finding, Rule, SensorLimits, sensor_limits
from .manifest import SENSOR_NAME, SensorManifest, read_sensor
from .package import GEL_NAME, MESH_NAME

if TYPE_CHECKING:
    from vitac.envs.sensor_design.tetrahedra import Tetrahedra
    from vitac.envs.tactile.design import SensorDesign

    from .meshing import MeshedGel

# Of the places of a grid's markers.
_ROUNDING_MM = 1e-9


class SensorRefused(VitacError):
    """A sensor breaks a rule; `vitac sensor check` lists all rules with their values."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CheckedSensor:
    """What was found about a sensor.

    Attributes:
        findings: in the order of the checks; what rests on a broken rule is not checked.
        meshed: the mesh; None where it or the shape breaks a rule.
        design: what is simulated; None where any rule is broken.
    """

    findings: tuple[Finding, ...]
    meshed: "MeshedGel | None" = None
    design: "SensorDesign | None" = None

    @property
    def ok(self) -> bool:
        """Whether the sensor follows every rule."""
        return self.design is not None


def check_sensor(path: Path, limits: SensorLimits | None = None) -> CheckedSensor:
    """Check a folder with sensor.yaml and gel.stl, or a bare STL with the default camera and markers.

    Args:
        path: folder or STL file, untrusted.
        limits: those of `limits.yaml` by default.

    Raises:
        SensorRejected: sensor.yaml cannot be used.
    """
    from .meshing import MeshCheck
    from .shape import ShapeCheck

    limits = limits or sensor_limits()
    manifest, stl, own = _files(path)
    shape = ShapeCheck(stl, limits)
    if shape.surface is None:
        return CheckedSensor(findings=tuple(shape.findings))
    mesh = MeshCheck(shape.surface, own, limits)
    findings = [*shape.findings, *mesh.findings]
    if mesh.meshed is None:
        return CheckedSensor(findings=tuple(findings))
    design = mesh.meshed.design(manifest)
    markers = _markers(design, limits)
    reach = _reach(design)
    findings += [reach, _tips(mesh.meshed.mesh, limits), markers]
    return CheckedSensor(
        findings=tuple(findings), meshed=mesh.meshed, design=design if reach.ok and markers.ok else None
    )


def accepted_sensor(path: Path) -> CheckedSensor:
    """Check a sensor that has to keep to every rule.

    Args:
        path: as for `check_sensor`.

    Raises:
        SensorRefused: it breaks one.
        SensorRejected: sensor.yaml cannot be used.
    """
    checked = check_sensor(path)
    if not checked.ok:
        broken = next(finding for finding in checked.findings if not finding.ok)
        raise SensorRefused(f"{broken.rule}: {broken.value}, expected {broken.limit}. {broken.problem}")
    return checked


def _files(path: Path) -> tuple[SensorManifest, Path, Path | None]:
    if not path.is_dir():
        return SensorManifest(), path, None
    own = find_spelling(path, MESH_NAME)
    return read_sensor(path), find_spelling(path, GEL_NAME), own if own.exists() else None


def _reach(design: "SensorDesign") -> Finding:
    """Ask for a sensing face near the highest point: of one that touches nothing, `surface_diff` says nothing."""
    from vitac.envs.tactile.design import MILLIMETRE_M, TOUCHED_M

    depth_mm = max(design.sensing_depth_m, 0.0) / MILLIMETRE_M
    return Finding(
        rule=Rule.REACH,
        ok=design.sensing_depth_m <= TOUCHED_M,
        value=f"highest sensing face {depth_mm:.3f} mm below the highest point",
        limit=f"at most {TOUCHED_M / MILLIMETRE_M:g} mm",
        problem="What touches first leans too much to sense. Draw tips that lean at most 60 degrees, or flat tops.",
    )


def _tips(mesh: "Tetrahedra", limits: SensorLimits) -> Finding:
    """Count the nodes of the parts that the grasp reaches: with few of them, another mesh touches differently."""
    from vitac.envs.sensor_design.tetrahedra import tip_sizes
    from vitac.envs.tactile.design import MILLIMETRE_M, TOUCHED_M

    sizes = tip_sizes(mesh, depth_mm=TOUCHED_M / MILLIMETRE_M)
    return Finding(
        rule=Rule.TIPS,
        ok=True,
        value=f"{len(sizes)} with {sizes[0]} nodes or more",
        limit=f"better {limits.wanted_tip_nodes} or more",
        problem=(
            "A part that touches first has so few nodes that surface_diff depends on the mesh. Draw fewer or larger "
            "tips if this matters, or bring a finer tet.msh."
        ),
        is_warning=sizes[0] < limits.wanted_tip_nodes,
    )


def _markers(design: "SensorDesign", limits: SensorLimits) -> Finding:
    """Look whether each marker is where it is drawn, and apart from others: each is seen with a noise of its own."""
    from vitac.envs.tactile.design import Fault

    markers = design.markers_mm.tolist()
    faults = [Fault(code) for code in design.attachment.faults.tolist()]
    bad = [
        f"{number} at ({x:.2f}, {y:.2f}) mm is {fault.name.lower().replace('_', ' ')}"
        for number, (fault, (x, y)) in enumerate(zip(faults, markers, strict=True), start=1)
        if fault is not Fault.NONE
    ]
    close = list(_too_close(markers, limits.min_marker_spacing_mm))
    return Finding(
        rule=Rule.MARKERS,
        ok=not bad and not close,
        value=f"{faults.count(Fault.NONE)} of {len(faults)} attached" + (f", {len(close)} too close" if close else ""),
        limit=f"all, {limits.min_marker_spacing_mm} mm apart",
        problem=f"Move or remove these markers in {SENSOR_NAME}: {'; '.join(bad + close)}.",
    )


def _too_close(markers: list[list[float]], spacing_mm: float) -> Iterator[str]:
    """Yield a marker that is too close to one before it, with the first such one."""
    for number, marker in enumerate(markers, start=1):
        for other, earlier in enumerate(markers[: number - 1], start=1):
            if (apart_mm := dist(marker, earlier)) < spacing_mm - _ROUNDING_MM:
                yield f"{number} is {apart_mm:.2f} mm from {other}"
                break
