import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from example_policies import flow, load
from vitac.cli.client.pieces import pack
from vitac.evaluator.submission.archive import unpack
from vitac.evaluator.submission.manifest import load_unpacked_manifest
from vitac.evaluator.submission.sources import submission_digest
from vitac.evaluator.tracks import load_track

SINGLE_TASK = {"peg_insertion": "peg_insertion_heuristic", "lock_opening": "lock_opening_heuristic"}


@pytest.fixture
def example(repository: Path) -> Path:
    return repository / "examples" / "track_1_heuristic"


@pytest.fixture
def policy(example: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """As the sandbox imports it: the submission's folder is on the path."""
    monkeypatch.syspath_prepend(str(example / "Track_1"))
    yield load(example / "Track_1" / "policy.py").Policy()
    for name in [name for name in sys.modules if name.split(".")[0] in SINGLE_TASK]:
        del sys.modules[name]


def test_can_be_submitted_as_it_is(example: Path, tmp_path: Path) -> None:
    """An upload's rules hold for what `vitac submit` packs."""
    pack(example, tmp_path / "packed.zip")
    unpacked = unpack(tmp_path / "packed.zip", tmp_path / "unpacked")
    assert load_unpacked_manifest(unpacked).tasks == tuple(load_track("track_1").tasks)
    assert submission_digest(tmp_path / "packed.zip") == submission_digest(example)


@pytest.mark.parametrize(("part", "single"), SINGLE_TASK.items())
def test_parts_are_the_single_task_examples(example: Path, part: str, single: str) -> None:
    assert contents(example / "Track_1" / part) == contents(example.parent / single / "Track_1"), (
        f"copy the files of examples/{single}/Track_1 to {part}"
    )


def contents(folder: Path) -> dict[str, bytes]:
    """Every file by its name, but for the manifest and what Python caches."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.suffix in (".py", ".json")}


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
