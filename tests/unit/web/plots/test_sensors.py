import re

import pytest
from shown_sensors import a_made_sensor
from vitac.evaluator.figures.figures import SensitivityMap
from vitac.evaluator.sensors.appearance import appearance
from vitac.web.plots.sensors import find_largest, marker_picture, quality_histogram, sensitivity_maps, still

MAP = SensitivityMap(
    x_mm=(-2.0, 0.0, 2.0),
    y_mm=(-1.0, 1.0),
    normal_px_n=((1.0, 2.0, None), (4.0, 3.0, 2.0)),
    shear_px_n=((None,) * 3,) * 2,
)


def test_still_shows_the_sensing_side_within_the_drawing_and_never_the_base() -> None:
    looks = appearance(a_made_sensor("dome"))
    drawn = str(still(looks))
    assert drawn.count('class="marker"') == len(looks.markers_mm) > 0
    classes = re.findall(r'class="face (\w+)"', drawn)
    assert {"sensing", "other"} == set(classes)
    points = [tuple(map(float, pair.split(","))) for pair in re.findall(r"[-\d.]+,[-\d.]+", drawn)]
    assert min(x for x, _ in points) > 0.0
    assert max(x for x, _ in points) < 640.0
    assert min(y for _, y in points) > 0.0
    assert max(y for _, y in points) < 400.0


def test_quality_histogram_has_a_bar_for_each_class() -> None:
    figure = quality_histogram("1", (0, 0, 3, 9, 20, 30, 15, 5, 0, 0))
    assert str(figure.drawing).count('class="bar other"') == 10
    assert figure.table.rows[5] == ("0.5 to 0.6", "30")


def test_markers_are_drawn_where_the_camera_sees_them() -> None:
    figure = marker_picture("1", [(10.0, 20.5), (300.0, 200.0)])
    assert 'cx="10" cy="20.5"' in str(figure.drawing)
    assert "2 markers" in figure.summary
    assert figure.table.rows[1] == ("2", "300.0", "200.0")


def test_map_leaves_out_what_does_not_sense_and_shares_its_scale() -> None:
    normal, shear = sensitivity_maps("1", MAP, (8.0, 0.0))
    opacities = re.findall(r'fill-opacity="([\d.]+)"', str(normal.drawing))
    assert opacities == ["0.12", "0.25", "0.5", "0.38", "0.25"]
    assert "to 8 px/N" in normal.summary
    assert normal.title == "Sensitivity to normal force, 0 to 8 px/N"
    assert shear.title == "Sensitivity to shear force, 0 to 0 px/N"
    assert normal.table.rows[0] == ("-1", "1", "2", "–")
    assert "fill-opacity" not in str(shear.drawing)


def test_largest_number_of_maps() -> None:
    assert find_largest(MAP.normal_px_n, ((5.0,),)) == 5.0
    assert find_largest(MAP.shear_px_n) == find_largest() == 0.0


@pytest.mark.parametrize("gel", ["2 mm", "8 mm"])
def test_gel_of_any_thickness_fits(gel: str) -> None:
    assert str(still(appearance(a_made_sensor(gel)))).count("<polygon") > 50
