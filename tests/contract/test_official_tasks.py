"""What a track file says of a task is what its environment does."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from vitac.envs.tasks.definition import Family
from vitac.envs.tasks.settings import with_contact_model
from vitac.evaluator.episodes.episode import json_info, make_environment
from vitac.evaluator.episodes.records import canonical_json
from vitac.evaluator.logs.log import MAX_INFO_BYTES, MAX_INFO_VALUES, count_values
from vitac.evaluator.tracks import Task, list_tracks, load_track

TASKS = [
    task
    for track in list_tracks()
    for task in load_track(track).tasks.values()
    if task.definition.family is Family.TACTILE
]


@pytest.fixture(params=TASKS, ids=lambda task: task.name)
def task(request: pytest.FixtureRequest) -> Task:
    assert isinstance(request.param, Task)
    return request.param


@pytest.fixture
def env(task: Task) -> Any:
    return make_environment(task)


def test_observation_table_is_the_observation_space(task: Task, env: Any) -> None:
    listed = {row.name: (row.shape, row.dtype) for row in task.observables}
    assert listed == {key: (space.shape, str(space.dtype)) for key, space in env.observation_space.spaces.items()}


def test_action_table_and_limit_are_the_settings(task: Task, env: Any) -> None:
    (scale,) = (value for name, value in vars(env.settings).items() if name.startswith("action_scale"))
    assert tuple(row.scale for row in task.actions) == scale
    assert task.max_steps == env.settings.max_steps


def test_official_settings_are_the_defaults_and_those_that_the_track_names(task: Task, env: Any) -> None:
    own = {name: value for name, value in task.settings.items() if name != "contact_model"}
    expected = replace(type(env.settings)(), **own)
    named: Any = task.settings.get("contact_model")
    assert env.settings == with_contact_model(expected, named)


def test_every_listed_episode_starts_as_the_list_says(task: Task, env: Any) -> None:
    """In the first episode of each shape a policy sees what the table lists, and the gripper has not moved.

    Infos, which vary by some digits only, stay far below what is read of a log: one that the evaluator writes itself
    must never be refused.
    """
    for shape in task.episode_list.shapes:
        episode = next(episode for episode in task.episodes if episode.shape == shape)
        observation, info = env.reset(options=episode.options)
        assert info["end_reason"] is None
        assert set(observation) == {row.name for row in task.observables}
        assert not np.any(observation.get("relative_motion", 0))
    *_, info = env.step(np.full(len(task.actions), 0.123456789, dtype=np.float32))
    written = json_info(info)
    assert 3.5 * len(canonical_json(written)) < MAX_INFO_BYTES
    assert 3.5 * count_values(written, MAX_INFO_VALUES) < MAX_INFO_VALUES


def test_relative_motion_does_not_tell_the_keys_apart() -> None:
    """The jump of the 2025 code (`reference_quirks`) is off: a key that is not moved has not moved."""
    task = next(task for task in TASKS if task.name == "lock-opening")
    env: Any = make_environment(task)
    for episode in task.episodes[::40]:
        env.reset(options=episode.options)
        observation, *_ = env.step(np.zeros(2, dtype=np.float32))
        assert observation["relative_motion"].tolist() == [0.0, 0.0, 0.0]
