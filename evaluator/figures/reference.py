"""Figures of the reference gel, beside which those of every sensor are shown."""

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from ..sensors.appearance import Appearance, appearance
from ..sensors.check import SensorCheck
from ..sensors.made import made_sensor
from ..sensors.manifest import SensorManifest
from .figures import SensorFigures

if TYPE_CHECKING:
    from vitac.envs.fem.model.mesh import GelMesh
    from vitac.envs.tactile.design import SensorDesign

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
    return appearance(made_sensor(SensorCheck(findings=(), meshed=meshed, design=design)))


def design_of_gel(gel: "GelMesh") -> "SensorDesign":
    """Return a gel with the default camera and markers, driven and sensing where its geometry says so."""
    from vitac.envs.sensor_design.faces import make_gel
    from vitac.envs.sensor_design.tetrahedra import Tetrahedra
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
