from types import ModuleType
from typing import Any

import numpy as np
import pytest
from example_policies import flow
from vitac.envs.tasks.explore.definition import EndShape

EXAMPLE = "explore_scripted"


def observation(policy: ModuleType, touch: int, *, is_felt: bool) -> dict[str, Any]:
    lifted = np.array([[-3.0 if is_felt else 0.0, 0.0], [0.0, 0.0], [0.0, 0.0]])
    sensors = [flow(lifted, 0.5, 1 + side + 2 * touch) for side in (0, 1)]
    return {"marker_flow": np.stack(sensors), "relative_motion": np.array(policy.PLACES_MM[touch])}


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
