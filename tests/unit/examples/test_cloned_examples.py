"""Examples that `vitac train clone` has made: their files are what it writes, and they solve some episodes."""

from pathlib import Path

import numpy as np
import pytest
from example_policies import load
from vitac.evaluator.episodes.episode import make_environment
from vitac.evaluator.submission.manifest import load_manifest
from vitac.evaluator.tracks import find_task, load_track
from vitac.training.cloning import policy as trained

EXAMPLES = {"in_hand_turn_cloned": "in-hand-turn", "slip_cloned": "slip"}
SOLVED = {"in_hand_turn_cloned": (7, 8), "slip_cloned": (1, 2)}


@pytest.fixture(params=EXAMPLES)
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def example(repository: Path, name: str) -> Path:
    track, _ = find_task(EXAMPLES[name])
    return repository / "examples" / name / track.folder


def test_is_a_valid_submission_of_what_was_trained(example: Path, name: str) -> None:
    manifest = load_manifest(example)
    assert EXAMPLES[name] in load_track(manifest.track).tasks
    assert manifest.tasks == (EXAMPLES[name],)
    assert (example / "policy.py").read_bytes() == Path(str(trained.__file__)).read_bytes()
    with np.load(example / "weights.npz", allow_pickle=False) as stored:
        assert all(np.isfinite(stored[array]).all() for array in stored.files)


def test_solves_episodes(example: Path, name: str) -> None:
    _, task = find_task(EXAMPLES[name])
    env = make_environment(task, observation_keys=load_manifest(example).observation_keys)
    policy = load(example / "policy.py").Policy()
    ends = []
    for number in SOLVED[name]:
        policy.reset(task.name)
        observation, info = env.reset(options=task.episodes[number].options)
        while info["end_reason"] is None:
            observation, *_, info = env.step(policy.act(observation))
        ends.append(info["end_reason"])
    assert ends == ["success", "success"]
