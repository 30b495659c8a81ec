"""Episodes whose quantities are drawn: recorded, played again and continued from snapshots to the same bits."""

from typing import Any

import numpy as np
import pytest
from vitac.evaluator.episodes.episode import json_info, make_environment, resimulate
from vitac.evaluator.tracks import Task, find_task

TASKS = [
    *("peg-insertion-robust", "lock-opening-robust", "fusion-robust"),
    *("explore-robust", "moving-hole-robust", "slip-robust"),
    *("in-hand-turn-robust", "assembly-robust"),
    pytest.param("soft-plug-robust", marks=pytest.mark.slow),
    pytest.param("cable-end-robust", marks=pytest.mark.slow),
]


@pytest.fixture(params=TASKS)
def task(request: pytest.FixtureRequest) -> Task:
    return find_task(request.param)[1]


def actions_of(env: Any) -> np.ndarray:
    return np.random.default_rng(2).uniform(-0.5, 0.5, (2, *env.action_space.shape)).astype(np.float32)


def test_recorded_actions_give_the_same_states_and_draws_in_another_environment(task: Task) -> None:
    first: Any = make_environment(task, observation_keys=("marker_flow",))
    actions = actions_of(first)
    episode = task.episodes[1]
    played = resimulate(first, episode, actions)
    second: Any = make_environment(task, observation_keys=("relative_motion",))
    second.reset(options=task.episodes[2].options)
    again = resimulate(second, episode, actions)
    assert again.state_hashes == played.state_hashes
    assert again.infos == played.infos
    for info in played.infos:
        drawn = info["draws"]
        assert isinstance(drawn, dict)
        assert drawn.keys() == task.draws.keys()
        values = {name: float(str(value)) for name, value in drawn.items()}
        assert all(low <= values[name] <= high for name, (low, high) in task.draws.items())


def test_an_episode_continues_from_a_snapshot_to_the_same_bits_after_another_one(task: Task) -> None:
    seen_keys = sorted({"marker_flow", "rgb_picture"} & {row.name for row in task.observables})
    env: Any = make_environment(task, observation_keys=seen_keys)
    actions = actions_of(env)
    env.reset(options=task.episodes[1].options)
    env.step(actions[0])
    snapshot, seen = env.snapshot(), []
    for _ in range(2):
        for action in actions[1:]:
            observation, *_, info = env.step(action)
        observed = [observation[key].tobytes() for key in seen_keys]
        seen.append((env.state_hash(), *observed, json_info(info)["draws"]))
        env.reset(options=task.episodes[2].options)
        env.restore(snapshot)
    assert seen[0] == seen[1]
