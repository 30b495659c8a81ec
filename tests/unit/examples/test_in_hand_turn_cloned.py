"""The cloned turn: its files are what the training writes, and it turns some rods to their goals."""

from pathlib import Path

import numpy as np
import pytest
from example_policies import load
from vitac.evaluator.episodes.episode import make_environment
from vitac.evaluator.submission.manifest import load_manifest
from vitac.evaluator.tracks import find_task
from vitac.training.cloning import policy as trained


@pytest.fixture(scope="module")
def example(repository: Path) -> Path:
    return repository / "examples" / "in_hand_turn_cloned" / "InHandTurn"


def test_is_a_valid_submission_of_what_was_trained(example: Path) -> None:
    manifest = load_manifest(example)
    assert (manifest.track, manifest.tasks) == ("in_hand_turn", ("in-hand-turn",))
    assert (example / "policy.py").read_bytes() == Path(str(trained.__file__)).read_bytes()
    with np.load(example / "weights.npz", allow_pickle=False) as stored:
        assert all(np.isfinite(stored[name]).all() for name in stored.files)


def test_turns_rods_to_their_goals(example: Path) -> None:
    _, task = find_task("in-hand-turn")
    env = make_environment(task, observation_keys=load_manifest(example).observation_keys)
    policy = load(example / "policy.py").Policy()
    ends = []
    for episode in task.episodes[7:9]:
        policy.reset(task.name)
        observation, info = env.reset(options=episode.options)
        while info["end_reason"] is None:
            observation, *_, info = env.step(policy.act(observation))
        ends.append(info["end_reason"])
    assert ends == ["success", "success"]
