from dataclasses import replace
from functools import cache

import numpy as np
import own_sensors
import pytest
from measured_figures import GRASP
from vitac.envs.tactile.design import SensorDesign
from vitac.evaluator.episodes.episode import make_environment
from vitac.evaluator.estimator import calibrate
from vitac.evaluator.figures.figures import FiguresPart, SensorFigures, StartFigures, TouchFigures, Variation, merged
from vitac.evaluator.figures.starts import (
    Measurement,
    grasp_figures,
    measured_episodes,
    mesh_error,
    refined_design,
    touch_figures,
)
from vitac.evaluator.figures.table import make_rows, reference_figures
from vitac.evaluator.tracks import Task, load_track

TASK = load_track("track_3").tasks["sensor-blind"]


@cache
def measurement() -> Measurement:
    env = make_environment(TASK, sensor=own_sensors.designed("ridge"))
    return Measurement(TASK, own_sensors.designed("ridge"), calibrate(env, TASK, starts=2))


@cache
def start() -> StartFigures:
    return measurement().start(TASK.episodes[2])


def test_each_start_of_the_list_is_measured_once_and_shards_have_about_as_many() -> None:
    chosen = [TASK.episodes[number - 1] for number in measured_episodes(TASK)]
    assert len({(episode.shape, episode.offset) for episode in chosen}) == len(chosen) == 90
    counts = np.bincount([(episode.number - 1) // TASK.shard_size for episode in chosen])
    assert counts.max() - counts.min() <= 1


def test_a_list_of_many_starts_is_measured_at_as_many() -> None:
    block = TASK.episode_list.blocks[0]
    offsets = tuple((0.01 * number, 4.0, 1.0) for number in range(200))
    blocks = (block.model_copy(update={"offsets": offsets, "repeats": 1}),)
    task: Task = TASK.model_copy(update={"episode_list": TASK.episode_list.model_copy(update={"blocks": blocks})})
    assert len(measured_episodes(task)) == 90


@pytest.mark.slow
def test_information_grows_with_every_picture() -> None:
    found = start().information
    assert found is not None
    traces = [xx + yy + tt for xx, _, _, yy, _, tt in found]
    assert 0.0 < traces[0] < traces[1] < traces[2]
    for xx, xy, xt, yy, yt, tt in found:
        assert np.linalg.eigvalsh([[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]]).min() >= -1e-6 * (xx + yy + tt)


def test_every_variation_is_played() -> None:
    assert set(start().successes) == set(Variation)
    assert 0.3 < start().smallest_det_f < 1.0
    assert start().cpu_s > 0.0
    assert start().episode == 3


def test_sensor_as_a_whole_is_measured_in_its_own_environment() -> None:
    whole = measurement().whole()
    assert whole.starts == ()
    assert whole.grasp == grasp_figures(make_environment(TASK, sensor=own_sensors.designed("ridge")))
    assert whole.touch is not None
    assert (whole.touch.normal_px_n or 0.0) > 0.0


def test_refined_design_keeps_shape_faces_and_markers() -> None:
    fine = refined_design(own_sensors.designed("ridge"), 1.5)
    assert len(fine.gel.rest_position_m) == int(1.5 * len(own_sensors.designed("ridge").gel.rest_position_m))
    assert fine.gel.volumes_m3.sum() == pytest.approx(own_sensors.designed("ridge").gel.volumes_m3.sum())
    assert not fine.attachment.faults.any()
    np.testing.assert_allclose(fine.rest_pixels, own_sensors.designed("ridge").rest_pixels)


@cache
def figures(name: str) -> TouchFigures:
    return of(own_sensors.designed(name))


def of(sensor: SensorDesign, youngs_modulus_pa: float = 3e5) -> TouchFigures:
    return touch_figures(sensor, youngs_modulus_pa=youngs_modulus_pa, poisson_ratio=0.3)


def known(value: float | None) -> float:
    assert value is not None
    return value


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


@pytest.mark.slow
def test_mesh_error_falls_with_the_mesh_and_is_nothing_against_itself() -> None:
    own = own_sensors.designed("4 mm")
    middle, fine = refined_design(own, 2.0), refined_design(own, 8.0)
    material = {"youngs_modulus_pa": 3e5, "poisson_ratio": 0.3}
    assert mesh_error(own, own, **material) == 0.0
    coarse_error, middle_error = (known(mesh_error(mesh, fine, **material)) for mesh in (own, middle))
    assert 0.1 < middle_error < 0.8 * coarse_error < 0.5


def test_places_beside_the_sensing_faces_are_left_out() -> None:
    whole = own_sensors.designed("4 mm")
    centres_m = whole.gel.rest_position_m[whole.sensing_triangles].mean(axis=1)
    half = replace(whole, sensing_triangles=whole.sensing_triangles[centres_m[:, 0] > 0.0])
    found = of(half).sensitivity
    assert {row[0] for row in found.normal_px_n} == {None}
    assert {row[0] for row in found.shear_px_n} == {None}
    assert None not in {row[-2] for row in found.normal_px_n}


def test_gel_that_senses_in_no_place_has_no_medians_and_shows_so() -> None:
    """As four ridges with tops of half a millimetre, which keep every rule."""
    drawn = own_sensors.designed("4 mm")
    centres_mm = 1e3 * drawn.gel.rest_position_m[drawn.sensing_triangles].mean(axis=1)
    narrow = replace(drawn, sensing_triangles=drawn.sensing_triangles[np.abs(centres_mm[:, 0] - 1.0) < 0.6])
    found = of(narrow)
    assert {value for row in found.sensitivity.normal_px_n for value in row} == {None}
    assert (found.normal_px_n, found.shear_px_n, found.pin_mm) == (None, None, None)
    assert all(value > 0.0 for value in found.edge_mm)
    shown = merged([FiguresPart(starts=(), touch=found, grasp=GRASP)], [])
    assert shown is not None
    assert SensorFigures.model_validate_json(shown.model_dump_json()) == shown
    rows = {row.name: row for row in make_rows(shown, reference_figures())}
    assert (rows["resolution of a pin"].value, rows["sensitivity, shear"].value) == (None, None)
    assert known(rows["resolution of a pin"].reference) > 0.0


def test_softer_gel_is_more_sensitive_and_resolves_more() -> None:
    stiff, soft = figures("4 mm"), of(own_sensors.designed("4 mm"), 1.5e5)
    assert soft.normal_px_n == pytest.approx(2.0 * known(stiff.normal_px_n), rel=1e-3)
    assert soft.shear_px_n == pytest.approx(2.0 * known(stiff.shear_px_n), rel=1e-3)
    assert soft.pin_mm == pytest.approx(0.5 * known(stiff.pin_mm), rel=1e-3)
    assert soft.edge_mm == pytest.approx(tuple(0.5 * value for value in stiff.edge_mm), rel=1e-3)


def test_thicker_gel_is_more_sensitive_to_shear() -> None:
    thin, middle, thick = (known(figures(name).shear_px_n) for name in ("2 mm", "4 mm", "8 mm"))
    assert thin < middle < thick


def test_twice_the_markers_halve_the_variance() -> None:
    sensor = own_sensors.designed("4 mm")
    twice = replace(sensor, markers_mm=np.concatenate([sensor.markers_mm, sensor.markers_mm]))
    assert of(twice).pin_mm == pytest.approx(known(figures("4 mm").pin_mm) / np.sqrt(2.0), rel=1e-3)
    assert of(twice).normal_px_n == pytest.approx(known(figures("4 mm").normal_px_n) * np.sqrt(2.0), rel=1e-3)
