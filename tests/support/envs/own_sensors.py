"""Sensors as teams would design them, ready to be simulated."""

from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import drawn_gels
import numpy as np
from numpy.typing import NDArray
from vitac.envs.sensor_design.surface import DrawnSurface
from vitac.envs.sensor_design.tetrahedra import Tetrahedra
from vitac.envs.tactile.design import SensorDesign
from vitac.evaluator.sensors.check import check_sensor
from vitac.evaluator.sensors.findings import sensor_limits

FloatArray = NDArray[np.float64]
Cells = tuple[int, int, int]
Void = tuple[tuple[int, int], tuple[int, int], tuple[int, int]]

GELS: dict[str, Callable[[], DrawnSurface]] = {
    "2 mm": lambda: drawn_gels.flat(2.0),
    "4 mm": lambda: drawn_gels.flat(4.0),
    "8 mm": lambda: drawn_gels.flat(8.0),
    "ridge": drawn_gels.ridge,
    "gable": drawn_gels.gable,
    "pyramids": drawn_gels.pyramids,
    "dome": drawn_gels.dome,
}
MARKERS = "{grid: {columns: 8, rows: 6, spacing_mm: [2.4, 2.0]}}"


# The six tetrahedra of a cube, whose corners are numbered by x + 2 y + 4 z.
_CUBE = ((0, 1, 3, 7), (0, 3, 2, 7), (0, 2, 6, 7), (0, 6, 4, 7), (0, 4, 5, 7), (0, 5, 1, 7))
_CELLS: Cells = (9, 7, 4)
# Cells without material: from and to along x, y and z.
_VOID: Void = ((3, 6), (2, 5), (1, 3))


def design(
    gel: DrawnSurface,
    markers: str = MARKERS,
    camera: str = "{}",
    mesh: str | None = None,
    wanted_nodes: int | None = None,
) -> SensorDesign:
    """The design that a folder with these contents holds; with at least so many nodes, the tips are finer, too."""
    limits = sensor_limits()
    if wanted_nodes is not None:
        finer = {"wanted_nodes": wanted_nodes, "wanted_tip_nodes": 2 * limits.wanted_tip_nodes, "max_nodes": 1500}
        limits = limits.model_copy(update=finer)
    with TemporaryDirectory() as name:
        found = check_sensor(write_sensor(Path(name), gel, f"camera: {camera}\nmarkers: {markers}\n", mesh), limits)
    assert found.design is not None, [finding for finding in found.findings if not finding.ok]
    return found.design


@cache
def designed(name: str) -> SensorDesign:
    """The design of one of `GELS`, made once for all tests of this process."""
    return design(GELS[name]())


def write_sensor(folder: Path, gel: DrawnSurface, yaml: str = "{}", mesh: str | None = None) -> Path:
    """The folder, with the files of a sensor in it."""
    (folder / "gel.stl").write_bytes(drawn_gels.stl_bytes(gel))
    (folder / "sensor.yaml").write_text(yaml)
    if mesh is not None:
        (folder / "tet.msh").write_text(mesh)
    return folder


def msh(mesh: Tetrahedra, *, scale: float = 1e-3, by_mm: tuple[float, float, float] = (0, 0, 0)) -> str:
    """A tet.msh."""
    nodes, cells = len(mesh.nodes_mm), len(mesh.corners)
    tags = [str(tag) for tag in range(1, nodes + 1)]
    positions = [" ".join(map(repr, row)) for row in ((mesh.nodes_mm + by_mm) * scale).tolist()]
    rows = [f"{number} {a} {b} {c} {d}" for number, (a, b, c, d) in enumerate((mesh.corners + 1).tolist(), start=1)]
    lines = ["$MeshFormat", "4.1 0 8", "$EndMeshFormat", "$Nodes", f"1 {nodes} 1 {nodes}", f"3 1 0 {nodes}"]
    lines += [*tags, *positions, "$EndNodes", "$Elements", f"1 {cells} 1 {cells}", f"3 1 4 {cells}", *rows]
    return "\n".join([*lines, "$EndElements", ""])


def block(counts: Cells = _CELLS, *, thickness_mm: float = 4.0, void: Void | None = None) -> Tetrahedra:
    """Tetrahedra that fill a box on the base but for a void, of so many cells along x, y and z."""
    extent_mm = _extent_mm(thickness_mm)
    lines = [np.linspace(0.0, extent, count + 1) for extent, count in zip(extent_mm, counts, strict=True)]
    nodes = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3) - extent_mm * [0.5, 0.5, 0.0]
    corners = []
    for cell in np.ndindex(counts):
        if void is not None and all(a <= i < b for i, (a, b) in zip(cell, void, strict=True)):
            continue
        steps = [(k & 1, k >> 1 & 1, k >> 2) for k in range(8)]
        cube = [int(np.ravel_multi_index(tuple(np.add(cell, step)), tuple(np.array(counts) + 1))) for step in steps]
        corners += [[cube[k] for k in tetrahedron] for tetrahedron in _CUBE]
    used, kept = np.unique(corners, return_inverse=True)
    return Tetrahedra(nodes_mm=nodes[used], corners=kept.reshape(-1, 4).astype(np.int64))


def with_nodes_inside(mesh: Tetrahedra, count: int) -> Tetrahedra:
    """The same with a node in the middle of each of the first tetrahedra, which become four."""
    nodes, corners = list(mesh.nodes_mm), mesh.corners[count:].tolist()
    for split in mesh.corners[:count].tolist():
        corners += [[len(nodes) if k == left_out else split[k] for k in range(4)] for left_out in range(4)]
        nodes.append(mesh.nodes_mm[split].mean(axis=0))
    return Tetrahedra(nodes_mm=np.array(nodes), corners=np.array(corners, dtype=np.int64))


def hollow() -> tuple[DrawnSurface, Tetrahedra]:
    """A box of 4 mm with a closed cavity in it, and tetrahedra that fill it."""
    extent_mm = _extent_mm(4.0)
    low, high = (extent_mm * [limits[k] / count for limits, count in zip(_VOID, _CELLS, strict=True)] for k in (0, 1))
    box = drawn_gels.stretched(drawn_gels.flat(4.0), tuple((high - low) / extent_mm))
    middle = 0.5 * (low + high) - 0.5 * extent_mm
    void = drawn_gels.turned_inside_out(drawn_gels.moved(box, by=(middle[0], middle[1], low[2])))
    return drawn_gels.together(drawn_gels.flat(4.0), void), block(void=_VOID)


def _extent_mm(thickness_mm: float) -> FloatArray:
    return np.array([drawn_gels.LENGTH_MM, drawn_gels.WIDTH_MM, thickness_mm])


def hollow_design() -> SensorDesign:
    """The design of a gel with a cavity, from its tet.msh."""
    gel, mesh = hollow()
    # Rays through the cavity end in it, so the markers stand beside it.
    return design(
        gel,
        "{points_mm: [" + ", ".join(f"[{x}, {y}]" for x in (-8, -6, 6, 8) for y in (-5, -2, 2, 5)) + "]}",
        mesh=msh(mesh),
    )
