import json
from pathlib import Path

import drawn_gels
import numpy as np
import pytest
from own_sensors import write_sensor
from vitac.evaluator.sensors.check import CheckedSensor, accepted_sensor
from vitac.evaluator.sensors.made import (
    MAX_BYTES,
    MadeSensor,
    MadeSensorDamaged,
    made_sensor,
    read_design,
    read_made_sensor,
)


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> CheckedSensor:
    yaml = "{camera: {focal_px: [330, 320]}, markers: {points_mm: [[0, 0], [2.5, -3.25]]}}"
    return accepted_sensor(write_sensor(tmp_path_factory.mktemp("sensor"), drawn_gels.bevelled(), yaml))


@pytest.fixture(scope="module")
def made(found: CheckedSensor) -> MadeSensor:
    return made_sensor(found)


def test_stored_sensor_is_the_checked_one_to_the_last_bit(found: CheckedSensor, made: MadeSensor) -> None:
    design = read_made_sensor(made.as_bytes()).design()
    assert found.design is not None
    assert design.gel.rest_position_m.tobytes() == found.design.gel.rest_position_m.tobytes()
    np.testing.assert_array_equal(design.gel.tetrahedra, found.design.gel.tetrahedra)
    assert design.as_bytes() == found.design.as_bytes()


def test_facts_are_those_of_the_mesh(found: CheckedSensor, made: MadeSensor) -> None:
    assert found.meshed is not None
    assert made.mesh_digest == found.meshed.digest
    assert made.facts.nodes == len(found.meshed.mesh.nodes_mm)
    assert (made.facts.thickness_mm, made.facts.markers, made.facts.is_own_mesh) == (4.0, 2, False)
    assert made.facts.volume_mm3 == pytest.approx(2051.083, abs=0.01)


def test_file_of_a_made_sensor_is_simulated(made: MadeSensor, tmp_path: Path) -> None:
    path = tmp_path / "made.json"
    path.write_bytes(made.as_bytes())
    assert read_design(path).as_bytes() == made.design().as_bytes()


def test_digest_changes_with_a_marker(made: MadeSensor) -> None:
    assert made.model_copy(update={"markers_mm": ((0.0, 0.0),)}).digest != made.digest


def changed(made: MadeSensor, **values: object) -> bytes:
    return json.dumps(json.loads(made.as_bytes()) | values).encode()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"format": 2}, "cannot be read"),
        ({"mesh_digest": "x"}, "cannot be read"),
        ({"extra": 1}, "cannot be read"),
        ({"markers_mm": [[0, 0]] * 129}, "larger than any may be"),
    ],
)
def test_what_is_no_made_sensor_is_refused(made: MadeSensor, values: dict[str, object], message: str) -> None:
    with pytest.raises(MadeSensorDamaged, match=message):
        read_made_sensor(changed(made, **values))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"mesh_digest": "0" * 64}, "not that of its digest"),
        ({"nodes_mm": "AAAA"}, "cannot be read"),
        ({"corners": "not base64"}, "cannot be read"),
    ],
)
def test_damaged_mesh_is_not_simulated(made: MadeSensor, values: dict[str, object], message: str) -> None:
    with pytest.raises(MadeSensorDamaged, match=message):
        read_made_sensor(changed(made, **values)).design()


def test_too_large_a_file_is_refused(made: MadeSensor) -> None:
    with pytest.raises(MadeSensorDamaged, match="larger than any may be"):
        read_made_sensor(made.as_bytes() + b" " * MAX_BYTES)


def test_sensor_that_breaks_a_rule_is_never_made() -> None:
    with pytest.raises(ValueError, match="keeps to every rule"):
        made_sensor(CheckedSensor(findings=()))
