import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import drawn_gels
import numpy as np
import pytest
from evaluation_records import make_record
from own_sensors import write_sensor
from unpacked_files import unpack
from vitac.evaluator import playback as making
from vitac.evaluator.episodes.episode import make_environment, resimulate
from vitac.evaluator.episodes.records import ActionSequence, EpisodeOutcome, EpisodeRecord
from vitac.evaluator.playback import (
    CAMERAS_FILE,
    SCENE_FILE,
    STILL_FILE,
    NotPlayable,
    PlaybackOrder,
    StatesDiffer,
    find_start,
    make,
    replay,
    serve,
)
from vitac.evaluator.sensors.check import accepted_sensor
from vitac.evaluator.sensors.made import made_sensor
from vitac.evaluator.tracks import find_task

Recorded = Callable[..., EpisodeRecord]


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the still, which takes two seconds."""
    monkeypatch.setattr(making, "can_draw", lambda: False)


def an_order(record: EpisodeRecord, folder: Path) -> PlaybackOrder:
    track, _ = find_task(record.task)
    return PlaybackOrder(track=track.name, record=record, folder=folder)


def ignore(_: int) -> None:
    """Tells nobody."""


def messages(order: PlaybackOrder) -> list[dict[str, Any]]:
    answers = io.StringIO()
    serve(order.model_dump_json().encode(), answers)
    return [json.loads(line) for line in answers.getvalue().splitlines()]


@pytest.mark.usefixtures("undrawn")
def test_the_files_show_the_recorded_actions(recorded: Recorded, tmp_path: Path) -> None:
    record = recorded(env_steps=2)
    make(an_order(record, tmp_path), ignore)
    found = unpack((tmp_path / SCENE_FILE).read_bytes())
    np.testing.assert_array_equal(found.arrays["action_values"], record.actions.to_array().round(2))
    assert found.header["env_id"] == "ViTac/PegInsertion-v1"
    assert not (tmp_path / CAMERAS_FILE).exists()


@pytest.mark.usefixtures("undrawn")
def test_an_episode_with_cameras_has_a_file_of_their_pictures(recorded: Recorded, tmp_path: Path) -> None:
    make(an_order(recorded(env_steps=1, task_name="fusion-insertion"), tmp_path), ignore)
    assert unpack((tmp_path / CAMERAS_FILE).read_bytes()).arrays["colours"].shape[0] == 2


@pytest.mark.slow
def test_the_still_is_drawn_where_that_is_possible(
    recorded: Recorded, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record = recorded(env_steps=1)
    make(an_order(record, tmp_path), ignore)
    assert (tmp_path / STILL_FILE).read_bytes().startswith(b"RIFF")
    (tmp_path / "other").mkdir()
    monkeypatch.setattr(making, "can_draw", lambda: False)
    make(an_order(record, tmp_path / "other"), ignore)
    assert not (tmp_path / "other" / STILL_FILE).exists()


def test_an_episode_of_no_env_step_is_one_moment(recorded: Recorded) -> None:
    _, task = find_task("peg-insertion")
    playback = replay(task, recorded(env_steps=0), ignore)
    assert [moment.env_step for moment in playback.moments] == [0]


@pytest.mark.parametrize("wrong", [0, 1, 2])
def test_another_state_than_the_recorded_one_is_not_shown(recorded: Recorded, wrong: int) -> None:
    _, task = find_task("peg-insertion")
    record = recorded(env_steps=2)
    hashes = list(record.state_hashes)
    hashes[wrong] = "f" * 64
    with pytest.raises(StatesDiffer, match=f"after env step {wrong} is not the recorded one"):
        replay(task, record.model_copy(update={"state_hashes": tuple(hashes)}), ignore)


def test_an_episode_that_ends_before_its_record_is_not_shown(
    recorded: Recorded, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, task = find_task("peg-insertion")
    record = recorded(env_steps=2)
    short = task.model_copy(update={"settings": {"max_steps": 1}})
    with pytest.raises(StatesDiffer, match="Expected 2 env steps as recorded, got 1"):
        replay(short, record, ignore)


def test_an_environment_of_another_kind_is_not_shown(recorded: Recorded, monkeypatch: pytest.MonkeyPatch) -> None:
    _, task = find_task("peg-insertion")
    record = recorded(env_steps=1)
    monkeypatch.setattr(making, "make_environment", lambda _, **__: object())
    with pytest.raises(NotPlayable, match=r"Episodes of ViTac/PegInsertion-v1 are not shown in 3D"):
        replay(task, record, ignore)


def test_the_start_is_the_recorded_one_with_the_seed_of_the_list(recorded: Recorded) -> None:
    _, task = find_task("peg-insertion")
    assert find_start(task, recorded(number=7)) == task.episodes[6]
    assert find_start(task, recorded(number=7), list_seed=5).list_seed == 5


@pytest.mark.usefixtures("undrawn")
def test_progress_and_end_are_told_line_by_line(recorded: Recorded, tmp_path: Path) -> None:
    told = messages(an_order(recorded(env_steps=2), tmp_path))
    assert [message["env_steps"] for message in told[:-1]] == [0, 1, 2]
    assert told[-1] == {"is_made": True}


def test_why_there_is_none_is_told(recorded: Recorded, tmp_path: Path) -> None:
    record = recorded(env_steps=1).model_copy(update={"state_hashes": ("f" * 64, "f" * 64)})
    told = messages(an_order(record, tmp_path))
    assert "not the recorded one" in told[-1]["error"]
    assert not (tmp_path / SCENE_FILE).exists()


def test_episode_with_a_sensor_of_a_team_is_shown_with_its_gel(tmp_path: Path) -> None:
    made = made_sensor(accepted_sensor(write_sensor(tmp_path, drawn_gels.flat(2.0))))
    track, task = find_task("sensor-blind")
    episode = task.episodes[2]
    played = resimulate(make_environment(task, sensor=made.design()), episode, np.zeros((1, 3), dtype=np.float32))
    record = make_record(
        episode.number,
        EpisodeOutcome.ACTIONS_ENDED,
        1,
        task=task.name,
        shape=episode.shape,
        initial_offset=episode.offset,
        actions=ActionSequence.from_array(np.zeros((1, 3), dtype=np.float32)),
        state_hashes=played.state_hashes,
        infos=played.infos,
    )
    order = PlaybackOrder(track=track.name, record=record, sensor=made, folder=tmp_path)
    assert messages(order)[-1] == {"is_made": True}
    found = unpack((tmp_path / SCENE_FILE).read_bytes())
    heights_mm = found.arrays["gel_nodes_mm"].reshape(-1, 3)[:, 2]
    assert heights_mm.max() - heights_mm.min() == pytest.approx(2.0, abs=1e-3)
    assert (tmp_path / STILL_FILE).exists()
    without = order.model_copy(update={"sensor": None})
    assert "is not the recorded one" in messages(without)[-1]["error"]
