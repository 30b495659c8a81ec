"""The figures of a sensor as rows beside those of the reference gel; printed by the command line, shown by pages."""

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from ..sensors.appearance import Appearance, appearance
from ..sensors.check import CheckedSensor
from ..sensors.made import made_sensor
from ..sensors.manifest import SensorManifest
from .figures import SensorFigures

if TYPE_CHECKING:
    from vitac.envs.fem.model.mesh import GelMesh
    from vitac.envs.tactile.design import SensorDesign


class FigureRow(NamedTuple):
    """One figure; `reference` is that of the reference gel, None where it has none."""

    name: str
    value: float | None
    reference: float | None
    unit: str


def make_rows(figures: SensorFigures, reference: SensorFigures) -> Iterator[FigureRow]:
    """Yield every figure of a sensor."""
    values, others = _values(figures), _values(reference)
    for name, (value, unit) in values.items():
        yield FigureRow(name, value, others.get(name, (None, unit))[0], unit)


def list_missing_rows(figures: SensorFigures) -> Iterator[str]:
    """Yield a sentence for every figure that is not there: what it is, and why."""
    touch, unmeasured = figures.touch, "no start was measured"
    if None in (touch.normal_px_n, touch.shear_px_n, touch.pin_mm, *touch.edge_mm):
        yield "Sensitivity or resolution has no median: no place of the map senses."
    if figures.information is None:
        reason = "at no start did all IPC steps converge" if figures.starts else unmeasured
        yield f"Information and bounds are not there: {reason}."
    if not figures.robustness:
        yield f"The standard score under variations is not there: {unmeasured}."
    if figures.cpu_s is None:
        yield f"The CPU time of an episode is not there: {unmeasured}."


def _values(figures: SensorFigures) -> dict[str, tuple[float | None, str]]:
    touch, grasp, information = figures.touch, figures.grasp, figures.information
    values: dict[str, tuple[float | None, str]] = {
        "sensitivity, normal": (touch.normal_px_n, "px/N"),
        "sensitivity, shear": (touch.shear_px_n, "px/N"),
        "resolution of a pin": (touch.pin_mm, "mm at 1 N"),
        "resolution of an edge across x": (touch.edge_mm[0], "mm at 1 N"),
        "resolution of an edge across y": (touch.edge_mm[1], "mm at 1 N"),
        "indentation at the grasp": (grasp.indentation_mm, "mm"),
        "force at the grasp": (grasp.force_n, "N"),
        "smallest det F": (grasp.smallest_det_f, ""),
    }
    if information is not None:
        for number, bits in enumerate(information.bits, start=1):
            values[f"information before env step {number}"] = (bits, "bit")
        for axis, bound, unit in zip(("x", "y", "theta"), information.bounds, ("mm", "mm", "deg"), strict=True):
            values[f"bound of {axis} before env step {len(information.bits)}"] = (bound, unit)
    for row in figures.robustness:
        values[f"standard score, {row.variation.label}"] = (100 * row.success_rate, "%")
    if figures.cpu_s is not None:
        values["CPU time of an episode"] = (figures.cpu_s, "s")
    return values


FILE = Path(__file__).with_name("reference.json")
LOOKS = Path(__file__).with_name("reference_looks.json")
"""Both made by `benchmarks/reference/sensor_figures.py`."""


@cache
def reference_figures() -> SensorFigures:
    """Return the figures of the gel of Tracks 1 and 2 with the default camera and markers."""
    return SensorFigures.model_validate_json(FILE.read_bytes())


@cache
def reference_looks() -> Appearance:
    """Return how that gel looks with the default camera and markers."""
    return Appearance.model_validate_json(LOOKS.read_bytes())


def reference_design() -> "SensorDesign":
    """Return that gel as a sensor of Track 3."""
    from vitac.envs.tactile.gel import gelsight_mini_mesh

    return design_of_gel(gelsight_mini_mesh())


def make_reference_looks() -> Appearance:
    """Return how that gel looks as it is made now."""
    from vitac.envs.sensor_design.tetrahedra import Tetrahedra

    from ..sensors.meshing import MeshedGel

    design = reference_design()
    nodes_mm = 1e3 * design.gel.rest_position_m
    nodes_mm[:, 2] -= nodes_mm[:, 2].min()
    mesh = Tetrahedra(nodes_mm=nodes_mm, corners=design.gel.tetrahedra)
    meshed = MeshedGel(mesh=mesh, is_own=False, volume_error=0.0, distance_mm=0.0)
    return appearance(made_sensor(CheckedSensor(findings=(), meshed=meshed, design=design)))


def design_of_gel(gel: "GelMesh") -> "SensorDesign":
    """Return a gel with the default camera and markers, driven and sensing where its geometry says so."""
    from vitac.envs.sensor_design.tetrahedra import Tetrahedra, make_gel
    from vitac.envs.tactile.design import SensorDesign

    nodes_mm = 1e3 * gel.rest_position_m
    nodes_mm[:, 2] -= nodes_mm[:, 2].min()
    placed, sensing = make_gel(Tetrahedra(nodes_mm=nodes_mm, corners=gel.tetrahedra), name=gel.name)
    manifest = SensorManifest()
    return SensorDesign(
        gel=placed,
        sensing_triangles=sensing,
        camera=manifest.camera.intrinsics(),
        markers_mm=manifest.markers.drawn_mm(),
    )
