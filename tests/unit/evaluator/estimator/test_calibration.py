from pathlib import Path

import drawn_gels
import pytest
from own_sensors import design, write_sensor
from vitac.evaluator.episodes.episode import make_environment
from vitac.evaluator.estimator import calibration
from vitac.evaluator.estimator.calibration import SEED, calibrate, calibrated
from vitac.evaluator.estimator.features import COUNT
from vitac.evaluator.tracks import list_tracks, load_track

TASK = load_track("track_3").tasks["sensor-standard"]


def test_calibration_has_seeds_of_its_own() -> None:
    tracks = [load_track(name) for name in list_tracks()]
    assert SEED not in {task.episode_list.list_seed for track in tracks for task in track.tasks.values()}


def test_calibration_gives_the_same_bytes_again_and_names_its_sensor() -> None:
    env = make_environment(TASK, sensor=design(drawn_gels.flat(2.0)))
    first = calibrate(env, TASK, starts=6)
    again = calibrate(make_environment(TASK, sensor=design(drawn_gels.flat(2.0))), TASK, starts=6)
    assert first.as_bytes() == again.as_bytes()
    assert (first.mesh_hash, first.starts) == (env.mesh_hash(), 6)
    assert {len(regression.means) for regression in first.regressions} == {COUNT + 3}
    assert 1 <= len(first.regressions) <= calibration.ENV_STEPS


def test_a_sensor_is_calibrated_once_for_both_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []

    def count(_: object, task: object, **__: object) -> str:
        made.append(str(task))
        return "coefficients"

    monkeypatch.setattr(calibration, "calibrate", count)
    monkeypatch.setattr(calibration, "_calibrated", {})
    folder = write_sensor(tmp_path, drawn_gels.flat(2.0))
    blind = load_track("track_3").tasks["sensor-blind"]
    assert calibrated(TASK, folder) is calibrated(blind, folder)
    assert len(made) == 1
