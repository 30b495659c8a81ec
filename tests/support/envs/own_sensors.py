"""Sensors as teams would design them, ready to be simulated."""

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import drawn_gels
from vitac.envs.sensor_design.surface import DrawnSurface
from vitac.envs.tactile.design import SensorDesign
from vitac.evaluator.sensors.check import check_sensor

GELS: dict[str, Callable[[], DrawnSurface]] = {
    "2 mm": lambda: drawn_gels.flat(2.0),
    "4 mm": lambda: drawn_gels.flat(4.0),
    "8 mm": lambda: drawn_gels.flat(8.0),
    "ridge": drawn_gels.ridge,
    "pyramids": drawn_gels.pyramids,
    "dome": drawn_gels.dome,
}
MARKERS = "{grid: {columns: 8, rows: 6, spacing_mm: [2.4, 2.0]}}"


def design(gel: DrawnSurface, markers: str = MARKERS, camera: str = "{}") -> SensorDesign:
    """The design that a folder with these contents holds."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "gel.stl").write_bytes(drawn_gels.stl_bytes(gel))
        (folder / "sensor.yaml").write_text(f"camera: {camera}\nmarkers: {markers}\n")
        found = check_sensor(folder)
    assert found.design is not None, [finding for finding in found.findings if not finding.ok]
    return found.design
