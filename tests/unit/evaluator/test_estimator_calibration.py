from pathlib import Path
from typing import Any

import drawn_gels
import numpy as np
import pytest
from own_sensors import design, write_sensor
from vitac.evaluator import estimator
from vitac.evaluator.episodes.episode import make_environment
from vitac.evaluator.estimator import COUNT, SEED, calibrate, calibrated
from vitac.evaluator.tracks import list_tracks, load_track

TASK = load_track("track_3").tasks["sensor-standard"]


def test_calibration_has_seeds_of_its_own() -> None:
    tracks = [load_track(name) for name in list_tracks()]
    assert SEED not in {task.episode_list.list_seed for track in tracks for task in track.tasks.values()}


@pytest.mark.slow
def test_calibration_gives_the_same_bytes_again_and_names_its_sensor() -> None:
    env = make_environment(TASK, sensor=design(drawn_gels.flat(2.0)))
    first = calibrate(env, TASK, starts=6)
    again = calibrate(make_environment(TASK, sensor=design(drawn_gels.flat(2.0))), TASK, starts=6)
    assert first.as_bytes() == again.as_bytes()
    assert (first.mesh_hash, first.starts) == (env.mesh_hash(), 6)
    assert {len(regression.means) for regression in first.regressions} == {COUNT + 3}
    assert 1 <= len(first.regressions) <= estimator.ENV_STEPS


class Counting:
    """An environment that plays nothing: episodes end after so many env steps, or never."""

    def __init__(self, ends_after: int | None) -> None:
        self._ends_after = ends_after
        self.env_steps: list[int] = []

    def mesh_hash(self) -> str:
        """Return that of no mesh."""
        return "none"

    def reset(self, **_: object) -> tuple[Any, Any]:
        """Count the env steps of another episode."""
        self.env_steps.append(0)
        return self._seen()

    def step(self, _: object) -> tuple[Any, ...]:
        """Count an env step."""
        self.env_steps[-1] += 1
        observation, info = self._seen()
        return observation, 0.0, False, False, info

    def _seen(self) -> tuple[Any, Any]:
        end_reason = "steps" if self.env_steps[-1] == self._ends_after else None
        info = {"gt_offset_mm_deg": np.array([1.0, -1.0, 2.0]), "end_reason": end_reason}
        return {"marker_flow": np.zeros((2, 2, 4, 2), np.float32)}, info


@pytest.mark.parametrize(
    ("ends_after", "played", "learned"),
    [(None, estimator.ENV_STEPS - 1, estimator.ENV_STEPS), (3, 3, 3), (1, 1, 1)],
)
def test_calibration_plays_no_env_step_of_which_it_learns_nothing(
    ends_after: int | None, played: int, learned: int
) -> None:
    env = Counting(ends_after)
    told: list[tuple[int, int]] = []
    found = calibrate(env, TASK, starts=3, on_start=lambda *how_far: told.append(how_far))  # type: ignore[arg-type]
    assert told == [(1, 3), (2, 3), (3, 3)]
    assert env.env_steps == [played] * 3
    assert len(found.regressions) == learned


def test_a_sensor_is_calibrated_once_for_both_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []

    def count(_: object, task: object, **__: object) -> str:
        made.append(str(task))
        return "coefficients"

    monkeypatch.setattr(estimator, "calibrate", count)
    monkeypatch.setattr(estimator, "_calibrated", {})
    folder = write_sensor(tmp_path, drawn_gels.flat(2.0))
    blind = load_track("track_3").tasks["sensor-blind"]
    assert calibrated(TASK, folder) is calibrated(blind, folder)
    assert len(made) == 1
