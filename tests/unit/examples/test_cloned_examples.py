"""Examples that `vitac train clone` has made: their files are what it writes, and each solves an episode."""

from pathlib import Path

import numpy as np
import pytest
from example_policies import load
from vitac.evaluator.episodes.episode import make_environment
from vitac.evaluator.submission.manifest import load_manifest
from vitac.evaluator.tracks import Task, find_task
from vitac.training.cloning import policy as trained


@pytest.fixture
def task(name: str) -> Task:
    return find_task(name.removesuffix("_cloned").replace("_", "-"))[1]


@pytest.fixture
def example(repository: Path, name: str) -> Path:
    [manifest] = (repository / "examples" / name).glob("*/submission.yaml")
    return manifest.parent


@pytest.mark.parametrize(
    "name", ["assembly_cloned", "cable_end_cloned", "in_hand_turn_cloned", "slip_cloned", "soft_plug_cloned"]
)
def test_is_a_valid_submission_of_what_was_trained(example: Path, task: Task) -> None:
    manifest = load_manifest(example)
    assert (find_task(task.name)[0].name, manifest.tasks) == (manifest.track, (task.name,))
    assert (example / "policy.py").read_bytes() == Path(str(trained.__file__)).read_bytes()
    with np.load(example / "weights.npz", allow_pickle=False) as stored:
        assert all(np.isfinite(stored[array]).all() for array in stored.files)


@pytest.mark.parametrize(
    ("name", "number"),
    [
        ("assembly_cloned", 0),
        pytest.param("cable_end_cloned", 1, marks=pytest.mark.slow),
        ("in_hand_turn_cloned", 7),
        ("slip_cloned", 86),
        pytest.param("soft_plug_cloned", 38, marks=pytest.mark.slow),
    ],
)
def test_solves_an_episode(example: Path, task: Task, number: int) -> None:
    env = make_environment(task, observation_keys=load_manifest(example).observation_keys)
    policy = load(example / "policy.py").Policy()
    policy.reset(task.name)
    observation, info = env.reset(options=task.episodes[number].options)
    while info["end_reason"] is None:
        observation, *_, info = env.step(policy.act(observation))
    assert info["end_reason"] == "success"
