import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from example_policies import flow, load
from vitac.evaluator.submission.manifest import load_manifest
from vitac.evaluator.tracks import load_track


@pytest.fixture
def composed(repository: Path, tmp_path: Path) -> Path:
    load(repository / "examples" / "track_1_heuristic" / "compose.py").compose(tmp_path / "new")
    return tmp_path / "new" / "Track_1"


@pytest.fixture
def policy(composed: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """As the sandbox imports it: the submission's folder is on the path."""
    monkeypatch.syspath_prepend(str(composed))
    yield load(composed / "policy.py").Policy()
    for name in [name for name in sys.modules if name.split(".")[0] in ("peg_insertion", "lock_opening")]:
        del sys.modules[name]


def test_plays_all_tasks_of_the_track(composed: Path) -> None:
    assert load_manifest(composed).tasks == tuple(load_track("track_1").tasks)


def test_holds_one_manifest(composed: Path) -> None:
    assert [path.parent for path in composed.rglob("submission.yaml")] == [composed]


def test_each_episode_is_played_by_the_policy_of_its_task(policy: Any) -> None:
    still = np.stack([flow(np.zeros((3, 2))) for _ in range(2)])
    for task in load_track("track_1").tasks.values():
        policy.reset(task.name)
        (motion,) = (row for row in task.observables if row.name == "relative_motion")
        observation = {"marker_flow": still, "relative_motion": np.zeros(motion.shape, np.float32)}
        action = policy.act(observation)
        assert (action.dtype, action.shape) == (np.float32, (len(task.actions),))
        alone = policy.policies[task.name]
        alone.reset(task.name)
        assert np.array_equal(alone.act(observation), action)
