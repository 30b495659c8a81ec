import importlib.util
from pathlib import Path
from types import ModuleType

from vitac.evaluator.sensors.check import accepted_sensor

EXAMPLE = "track_3_dome"


def script(example: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("draw_dome", example / "draw.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_gel_is_the_one_that_the_script_draws(example: Path) -> None:
    draw = script(example)
    assert (example / "Track_3" / "gel.stl").read_bytes() == draw.stl(draw.corners())


def test_sensor_keeps_to_every_rule(example: Path) -> None:
    found = accepted_sensor(example / "Track_3")
    assert found.meshed is not None
    assert len(found.meshed.mesh.nodes_mm) < 400
    assert found.meshed.digest == "4565d0dbdeff59a7a82b94059f9241e283320ad1ef8651354665cc941fedffcd"
