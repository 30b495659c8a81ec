"""The varying number of followed markers becomes the observation of the ranked tasks."""

import gymnasium
import numpy as np
import pytest
from vitac.envs.tactile.markers import MarkerSettings, tracked
from vitac.station.perception.markers import MarkerFlow
from vitac.station.perception.observation import NoMarkerFollowed, marker_flow


def flow(count: int) -> MarkerFlow:
    reference = np.arange(2.0 * count).reshape(count, 2)
    return MarkerFlow(reference, reference + 0.5)


def test_is_an_observation_of_the_ranked_task() -> None:
    spaces = gymnasium.make("ViTac/PegInsertion-v1", disable_env_checker=True).observation_space
    assert isinstance(spaces, gymnasium.spaces.Dict)
    observed = marker_flow(flow(61), flow(200), np.random.default_rng(1))
    assert (observed.shape, observed.dtype) == (spaces["marker_flow"].shape, spaces["marker_flow"].dtype)


@pytest.mark.parametrize("count", [1, 61, 127])
def test_few_markers_are_filled_up_as_in_simulation(count: int) -> None:
    observed, _ = marker_flow(flow(count), flow(3), np.random.default_rng(1))
    kept = np.ones(count, dtype=bool)
    simulated = tracked(np.stack(flow(count)), kept, MarkerSettings(noise_px=0.0), np.random.default_rng(1))
    assert observed.tolist() == simulated.tolist()


def test_of_many_markers_128_are_chosen_once_each() -> None:
    left, _ = marker_flow(flow(200), flow(200), np.random.default_rng(1))
    assert len({tuple(each) for each in left[0]}) == 128
    assert (left[1] - left[0] == 0.5).all()


def test_gel_without_markers_is_named() -> None:
    with pytest.raises(NoMarkerFollowed, match="Expected markers on the right gel, got none"):
        marker_flow(flow(3), flow(0), np.random.default_rng(1))
