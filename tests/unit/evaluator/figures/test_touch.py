from dataclasses import replace
from functools import cache

import numpy as np
import own_sensors
import pytest
from vitac.envs.tactile.design import SensorDesign
from vitac.evaluator.figures.figures import TouchFigures
from vitac.evaluator.figures.touch import touch_figures


@cache
def design(name: str) -> SensorDesign:
    return own_sensors.design(own_sensors.GELS[name]())


@cache
def figures(name: str) -> TouchFigures:
    return of(design(name))


def of(sensor: SensorDesign, youngs_modulus_pa: float = 3e5) -> TouchFigures:
    return touch_figures(sensor, youngs_modulus_pa=youngs_modulus_pa, poisson_ratio=0.3)


def test_map_of_a_flat_gel_is_whole_and_nearly_symmetric() -> None:
    found = figures("4 mm").sensitivity
    normal = np.array(found.normal_px_n, dtype=float)
    assert normal.shape == (len(found.y_mm), len(found.x_mm)) == (11, 13)
    # Half of what presses on a corner's place falls beside the gel.
    corners = {(row, column) for row in (0, 10) for column in (0, 12)}
    assert {(int(row), int(column)) for row, column in np.argwhere(np.isnan(normal))} == corners
    assert np.nanmin(normal) > 0.0
    np.testing.assert_allclose(np.nanmean(normal[:, :6]), np.nanmean(normal[:, 7:]), rtol=0.05)
    np.testing.assert_allclose(np.nanmean(normal[:5]), np.nanmean(normal[6:]), rtol=0.05)


def test_places_beside_the_sensing_faces_are_left_out() -> None:
    gel = design("4 mm").gel
    centres_m = gel.rest_position_m[design("4 mm").sensing_triangles].mean(axis=1)
    half = replace(design("4 mm"), sensing_triangles=design("4 mm").sensing_triangles[centres_m[:, 0] > 0.0])
    found = of(half).sensitivity
    assert {row[0] for row in found.normal_px_n} == {None}
    assert {row[0] for row in found.shear_px_n} == {None}
    assert None not in {row[-2] for row in found.normal_px_n}


def test_softer_gel_is_more_sensitive_and_resolves_more() -> None:
    stiff, soft = figures("4 mm"), of(design("4 mm"), 1.5e5)
    assert soft.normal_px_n == pytest.approx(2.0 * stiff.normal_px_n, rel=1e-3)
    assert soft.shear_px_n == pytest.approx(2.0 * stiff.shear_px_n, rel=1e-3)
    assert soft.pin_mm == pytest.approx(0.5 * stiff.pin_mm, rel=1e-3)
    assert soft.edge_mm == pytest.approx(tuple(0.5 * value for value in stiff.edge_mm), rel=1e-3)


def test_thicker_gel_is_more_sensitive_to_shear() -> None:
    assert figures("2 mm").shear_px_n < figures("4 mm").shear_px_n < figures("8 mm").shear_px_n


def test_twice_the_markers_halve_the_variance() -> None:
    sensor = design("4 mm")
    twice = replace(sensor, markers_mm=np.concatenate([sensor.markers_mm, sensor.markers_mm]))
    assert of(twice).pin_mm == pytest.approx(figures("4 mm").pin_mm / np.sqrt(2.0), rel=1e-3)
    assert of(twice).normal_px_n == pytest.approx(figures("4 mm").normal_px_n * np.sqrt(2.0), rel=1e-3)
