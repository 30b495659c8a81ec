"""Has the sandbox make a sensor once for all tests of this process that upload the same one."""

from pathlib import Path
from typing import Any

from vitac.evaluator.sensors.made import MadeSensor
from vitac.evaluator.sensors.manifest import SENSOR_NAME
from vitac.evaluator.sensors.package import GEL_NAME, MESH_NAME
from vitac.evaluator.submission.sensor import make_sensor

_made: dict[tuple[bytes | None, ...], MadeSensor] = {}


def make_each_once(folder: Path, **options: Any) -> MadeSensor:
    """In the place of `make_sensor`: what that made of the same files before; a refusal is found anew."""
    paths = [folder / name for name in (SENSOR_NAME, GEL_NAME, MESH_NAME)]
    files = tuple(path.read_bytes() if path.is_file() else None for path in paths)
    if files not in _made:
        _made[files] = make_sensor(folder, **options)
    return _made[files]
