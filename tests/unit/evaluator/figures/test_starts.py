from functools import cache

import numpy as np
import own_sensors
import pytest
from vitac.evaluator.episodes.episode import make_environment
from vitac.evaluator.estimator.calibration import calibrate
from vitac.evaluator.figures.figures import StartFigures, Variation
from vitac.evaluator.figures.starts import Measurement, grasp_figures, measured_episodes, refined_design
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
