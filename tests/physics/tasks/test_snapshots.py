"""Going back to a state of an episode: what follows is the same to the last bit."""

import pickle
from typing import Any

import gymnasium
import numpy as np
import pytest
from environment_ids import EACH_ENVIRONMENT
from vitac.envs.tasks.task_env import ForeignSnapshot, NotReset


def made(env_id: str, **arguments: Any) -> Any:
    return gymnasium.make(env_id, disable_env_checker=True, observation_keys=("marker_flow",), **arguments).unwrapped


def played(env: Any, actions: np.ndarray) -> list[Any]:
    """All that can be seen of env steps, as bytes and numbers that compare."""
    seen = []
    for action in actions:
        observation, reward, terminated, truncated, info = env.step(action)
        told = {key: np.asarray(value).tolist() for key, value in info.items()}
        seen.append(([array.tobytes() for array in observation.values()], reward, terminated, truncated, told))
        seen.append(env.state_hash())
    return seen


@pytest.fixture(params=EACH_ENVIRONMENT)
def env(request: pytest.FixtureRequest) -> Any:
    return made(request.param)


def actions_of(env: Any, count: int) -> np.ndarray:
    return np.random.default_rng(2).uniform(-1, 1, (count, *env.action_space.shape)).astype(np.float32)


def test_continues_to_the_same_bits_as_often_as_asked_also_after_an_episode_of_another_shape(env: Any) -> None:
    env.reset(seed=3)
    actions = actions_of(env, 3)
    played(env, actions[:1])
    snapshot = env.snapshot()
    first = played(env, actions[1:])
    env.restore(snapshot)
    assert played(env, actions[1:]) == first
    env.reset(seed=4)
    env.restore(snapshot)
    assert played(env, actions[1:]) == first


def test_another_action_shows_the_same_after_going_back_as_in_an_episode_without(env: Any) -> None:
    """Both actions take as many IPC steps, so nothing may be remembered by their number."""
    action = np.full(env.action_space.shape, 0.5, dtype=np.float32)
    env.reset(seed=3)
    snapshot = env.snapshot()
    played(env, np.array([action]))
    env.restore(snapshot)
    again = played(env, np.array([-action]))
    env.reset(seed=3)
    assert again == played(env, np.array([-action]))


def test_following_episodes_are_those_after_the_snapshot(env: Any) -> None:
    env.reset(seed=3)
    snapshot = env.snapshot()
    starts = []
    for _ in range(2):
        env.restore(snapshot)
        env.reset()
        starts.append(env.state_hash())
    assert starts[0] == starts[1]


def test_generator_of_a_listed_episode_goes_back_too() -> None:
    env = made("ViTac/PegInsertion-v1")
    env.reset(options={"rng_seed": (5, 1)})
    snapshot = env.snapshot()
    flows = []
    for _ in range(2):
        env.restore(snapshot)
        flows.append(env.step(np.zeros(3, dtype=np.float32))[0]["marker_flow"])
    np.testing.assert_array_equal(*flows)


def test_episode_that_was_not_snapshot_is_as_if_there_were_none() -> None:
    plain, kept = made("ViTac/PegInsertion-v1"), made("ViTac/PegInsertion-v1")
    actions = actions_of(plain, 2)
    for env in (plain, kept):
        env.reset(seed=8)
    kept.snapshot()
    assert played(plain, actions) == played(kept, actions)


def test_counters_do_not_go_back() -> None:
    env = made("ViTac/PegInsertion-v1")
    env.reset(seed=3)
    snapshot, before = env.snapshot(), env.ipc_steps
    env.step(np.zeros(3, dtype=np.float32))
    after = env.ipc_steps
    env.restore(snapshot)
    assert env.ipc_steps == after > before
    env.step(np.zeros(3, dtype=np.float32))
    assert env.ipc_steps == after + (after - before)


def test_snapshot_of_another_environment_is_refused_and_changes_neither() -> None:
    ours, theirs = made("ViTac/PegInsertion-v1"), made("ViTac/PegInsertion-v1")
    for env in (ours, theirs):
        env.reset(seed=3)
    theirs.step(np.full(3, 0.5, dtype=np.float32))
    before = ours.state_hash(), theirs.state_hash()
    with pytest.raises(ForeignSnapshot, match=r"another environment of ViTac/PegInsertion-v1\. Expected one of this"):
        ours.restore(theirs.snapshot())
    assert (ours.state_hash(), theirs.state_hash()) == before


def test_snapshot_does_not_leave_its_process() -> None:
    env = made("ViTac/PegInsertion-v1")
    env.reset(seed=3)
    with pytest.raises(TypeError, match="Send the seed and the actions"):
        pickle.dumps(env.snapshot())


def test_snapshot_needs_an_episode() -> None:
    with pytest.raises(NotReset, match="call reset first"):
        made("ViTac/PegInsertion-v1").snapshot()
