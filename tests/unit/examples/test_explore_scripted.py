from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from example_policies import flow, load
from vitac.envs.tasks.explore.definition import EndShape
from vitac.evaluator.submission.manifest import load_manifest


@pytest.fixture(scope="module")
def example(repository: Path) -> Path:
    return repository / "examples" / "explore_scripted" / "Explore"


@pytest.fixture(scope="module")
def policy(example: Path) -> ModuleType:
    return load(example / "policy.py")


def observation(policy: ModuleType, touch: int, *, is_felt: bool) -> dict[str, Any]:
    lifted = np.array([[-3.0 if is_felt else 0.0, 0.0], [0.0, 0.0], [0.0, 0.0]])
    sensors = [flow(lifted, 0.5, 1 + side + 2 * touch) for side in (0, 1)]
    return {"marker_flow": np.stack(sensors), "relative_motion": np.array(policy.PLACES_MM[touch])}


def test_is_a_valid_submission(example: Path) -> None:
    manifest = load_manifest(example)
    assert (manifest.track, manifest.tasks, manifest.entry_point) == ("explore", ("explore",), "policy:Policy")


@pytest.mark.parametrize("shape", list(EndShape))
def test_names_the_shape_that_it_has_felt_and_is_the_less_certain_the_more_was_otherwise(
    policy: ModuleType, shape: str
) -> None:
    confidences = []
    for wrong in (None, 4):
        player = policy.Policy()
        player.reset("explore")
        for touch, felt in enumerate(policy.FELT[shape]):
            action = player.act(observation(policy, touch, is_felt=bool(felt) != (touch == wrong)))
        weights = 1 + action[2:]
        confidences.append(weights[list(EndShape).index(EndShape(shape))] / weights.sum())
        if wrong is None:
            assert list(EndShape)[int(np.argmax(weights))] == shape
    assert confidences[1] < confidences[0]


def test_goes_from_place_to_place(policy: ModuleType) -> None:
    player = policy.Policy()
    player.reset("explore")
    for touch, place in enumerate(policy.PLACES_MM[1:]):
        action = player.act(observation(policy, touch, is_felt=True))
        assert action[:2] * policy.REACH_MM + policy.PLACES_MM[touch] == pytest.approx(
            np.clip(place, np.array(policy.PLACES_MM[touch]) - 8, np.array(policy.PLACES_MM[touch]) + 8), abs=0.01
        )
