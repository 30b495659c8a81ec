"""The example of Track 2 with the real physics and cameras: in the sandbox, and where its eyes are wrong."""

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from example_policies import imported
from vitac.envs.tasks.fusion_insertion.env import FusionInsertionEnv
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.evaluator.evaluation.local import evaluate
from vitac.evaluator.tracks import find_task

CUBOID, HEXAGON = (-1.3, 2.1, 9.1, 7.9, 0), (-1.9, 0.3, -1.9, 5.4, 1)
KEYS = ("relative_motion", "rgb_picture", "depth_picture", "marker_flow")


@pytest.fixture(scope="module")
def folder(repository: Path) -> Path:
    return repository / "examples" / "track_2_fusion" / "Track_2"


@pytest.fixture
def example(folder: Path) -> Iterator[SimpleNamespace]:
    with imported(folder) as modules:
        yield modules


def played(policy: Any, start: tuple[float, ...]) -> tuple[str, int]:
    """How an episode ended, and after how many env steps."""
    env = FusionInsertionEnv(depth_mode="gt", observation_keys=KEYS)
    observation, info = env.reset(options={"start": start, "rng_seed": (0, 1)})
    policy.reset("fusion-insertion")
    while info["end_reason"] is None:
        observation, *_, info = env.step(policy.act(observation))
    return info["end_reason"], info["steps"]


@pytest.mark.slow
def test_inserts_both_pegs_in_the_sandbox_by_what_its_manifest_names(folder: Path) -> None:
    track, task = find_task("fusion-insertion")
    evaluation = evaluate(submission_dir=folder, track=track, task=task, episodes=(3, 4))
    assert evaluation.failure is None
    assert [record.outcome for record in evaluation.records] == [EpisodeOutcome.SUCCESS] * 2
    assert {record.shape for record in evaluation.records} == {"hexagon", "cuboid"}
    assert max(record.env_steps for record in evaluation.records) <= 30


@pytest.mark.parametrize("displaced_mm", [(2.4, 0.0), (0.0, -2.4)])
@pytest.mark.parametrize("start", [CUBOID, HEXAGON])
def test_finds_a_hole_by_touch_that_lies_elsewhere(
    example: SimpleNamespace, start: tuple[float, ...], displaced_mm: tuple[float, float]
) -> None:
    for shape, middle in example.solids.HOLES.items():
        example.solids.HOLES[shape] = middle + np.array(displaced_mm)
    policy = example.policy.Policy()
    assert played(policy, start)[0] == "success"
    assert policy.tries > 0


def test_travels_higher_where_the_rim_is_higher_than_it_looked(
    example: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen_at = example.policy.place_base
    monkeypatch.setattr(example.policy, "place_base", lambda y, z: seen_at(y, z - 1.0))
    policy = example.policy.Policy()
    assert played(policy, CUBOID)[0] == "success"
    assert policy.hover > 0.6
