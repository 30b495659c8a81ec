import subprocess
import sys

import numpy as np
import pytest
from shown_sensors import a_made_sensor
from vitac.evaluator.sensors.appearance import DRIVEN, SENSING, appearance
from vitac.evaluator.sensors.made import MadeSensorDamaged


@pytest.mark.parametrize("gel", ["ridge", "dome"])
def test_markers_are_where_the_simulation_sees_them(gel: str) -> None:
    made = a_made_sensor(gel)
    np.testing.assert_allclose(appearance(made).markers_px, made.design().rest_pixels, atol=1e-6)


@pytest.mark.parametrize("gel", ["ridge", "dome"])
def test_markers_are_printed_where_the_simulation_has_them(gel: str) -> None:
    made = a_made_sensor(gel)
    design = made.design()
    printed_mm = 1e3 * design.printed_m
    printed_mm[:, 2] -= 1e3 * design.gel.rest_position_m[:, 2].min()
    np.testing.assert_allclose(appearance(made).markers_mm, printed_mm, atol=1e-3)


def test_faces_are_those_that_are_driven_and_sense() -> None:
    looks, design = appearance(a_made_sensor()), a_made_sensor().design()
    assert len(looks.triangles) == len(looks.kinds) == len(design.gel.surface_triangles)
    assert looks.kinds.count(SENSING) == len(design.sensing_triangles)
    corners = np.array(looks.vertices_mm)[np.array(looks.triangles)]
    kinds = np.array(looks.kinds)
    assert corners[kinds == DRIVEN, :, 2].max() < 0.01
    assert corners[kinds == 0, :, 2].max() > 1.0
    assert corners[:, :, 2].max() == pytest.approx(a_made_sensor().facts.thickness_mm)


def test_every_tetrahedron_is_in_the_histogram_of_qualities() -> None:
    made = a_made_sensor()
    counts = appearance(made).qualities
    assert sum(counts) == made.facts.tetrahedra
    worst = next(number for number, count in enumerate(counts) if count)
    assert worst == int(10 * made.facts.worst_quality)


def test_sensor_with_another_mesh_than_its_digest_says_is_not_drawn() -> None:
    with pytest.raises(MadeSensorDamaged, match="is not that of its digest"):
        appearance(a_made_sensor().model_copy(update={"mesh_digest": "0" * 64}))


def test_the_simulation_is_not_loaded_to_draw_a_sensor() -> None:
    code = (
        "import sys; from vitac.evaluator.sensors.appearance import appearance; "
        "from vitac.evaluator.sensors.made import MadeSensor; "
        "appearance(MadeSensor.model_validate_json(sys.stdin.read())); print('numba' in sys.modules)"
    )
    content = a_made_sensor().as_bytes()
    ended = subprocess.run([sys.executable, "-c", code], input=content, capture_output=True, check=True)
    assert ended.stdout == b"False\n"
