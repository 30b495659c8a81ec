"""Copies and pickles of an environment in the middle of an episode go on with the same bits, and leave it alone."""

import copy
import pickle
from collections.abc import Callable
from typing import Any

import cloudpickle
import gymnasium
import numpy as np
import pytest
from environment_ids import EACH_ENVIRONMENT, ENV_IDS
from vitac.envs.tasks.making import ForkedVectorEnv, NumericInfos

WAYS: dict[str, Callable[[Any], Any]] = {
    "deepcopy": copy.deepcopy,
    "pickle": lambda env: pickle.loads(pickle.dumps(env)),  # noqa: S301 - what was just pickled
    "cloudpickle": lambda env: cloudpickle.loads(cloudpickle.dumps(env)),
}
BEFORE, AFTER = 1, 1
EVERYTHING: dict[str, Any] = {
    "privileged": True,
    "optional_observables": ("rgb_images",),
    "render_mode": "rgb_array",
    "randomization": "challenge",
    "contact_model": "arena-2",
    "draws": {"gel_viscous_ratio": (0.3, 0.9), "gel_relaxation_s": (0.1, 2.0)},
}
"""All that adds to an environment's state: the slow tests copy it as it is ranked."""


def actions(env: Any) -> list[Any]:
    random = np.random.default_rng(1)
    scale = 0.3 if isinstance(env.action_space, gymnasium.spaces.Box) else 1.0
    shape = env.action_space.shape
    return [random.uniform(-scale, scale, shape).astype(np.float32) for _ in range(BEFORE + AFTER)]


def bits(value: Any) -> Any:
    """All numbers of an outcome, for comparison to the last bit."""
    if isinstance(value, dict):
        return {key: bits(part) for key, part in value.items()}
    if isinstance(value, np.ndarray) and value.dtype != object:
        return value.dtype, value.shape, value.tobytes()
    if isinstance(value, np.ndarray | list | tuple):
        return [bits(part) for part in value]
    return value


def continued(env: Any) -> list[Any]:
    """What comes of the last actions, of a reset that is not seeded, and of an action after it."""
    last = actions(env)[BEFORE:]
    outcomes = [env.step(action) for action in last]
    return [bits(outcome) for outcome in (*outcomes, env.reset(), env.step(last[0]))]


def begun(env: Any) -> Any:
    env.reset(seed=5)
    for action in actions(env)[:BEFORE]:
        env.step(action)
    return env


@pytest.mark.parametrize("env_id", EACH_ENVIRONMENT)
def test_copies_go_on_with_the_same_bits(env_id: str) -> None:
    env = begun(gymnasium.make(env_id, **EVERYTHING).unwrapped)
    picture, state = env.render(), env.state_hash()
    twin, other = WAYS["pickle"](env), WAYS["deepcopy"](env)
    expected = continued(env)
    assert continued(twin) == expected
    assert twin.state_hash() == env.state_hash()
    # All others have moved since; this one was made before, too, and is where it was.
    assert other.state_hash() == state
    if picture is not None:
        assert np.array_equal(other.render(), picture)


@pytest.mark.slow
@pytest.mark.parametrize("env_id", ENV_IDS)
def test_copies_of_wrapped_environments_go_on_with_the_same_bits(env_id: str) -> None:
    env = begun(NumericInfos(gymnasium.make(env_id, max_episode_steps=BEFORE + AFTER)))
    twins = [way(env) for way in WAYS.values()]
    expected = continued(env)
    assert [continued(twin) for twin in twins] == [expected] * len(WAYS)


@pytest.mark.slow
@pytest.mark.parametrize("env_id", ENV_IDS)
def test_copies_of_vector_environments_go_on_with_the_same_bits(env_id: str) -> None:
    env = begun(gymnasium.make_vec(env_id, 2, vectorization_mode="sync"))
    twins = [WAYS[way](env) for way in ("deepcopy", "cloudpickle")]
    expected = continued(env)
    assert [continued(twin) for twin in twins] == [expected] * 2


def test_a_copy_before_the_first_reset_plays_the_same_episode() -> None:
    env = gymnasium.make(ENV_IDS[0])
    twin = copy.deepcopy(env)
    assert bits(twin.reset(seed=3)[0]) == bits(env.reset(seed=3)[0])


def test_forces_of_the_last_step_and_snapshots_are_those_of_the_copy() -> None:
    env: Any = begun(gymnasium.make("ViTac/PegInsertion-v1").unwrapped)
    twin = copy.deepcopy(env)
    np.testing.assert_array_equal(twin.scene.pair_forces().forces_n, env.scene.pair_forces().forces_n)
    snapshot, state = twin.snapshot(), twin.state_hash()
    continued(twin)
    twin.restore(snapshot)
    assert twin.state_hash() == state == env.state_hash()


def test_what_is_called_after_ipc_steps_stays_with_the_original() -> None:
    env: Any = begun(gymnasium.make("ViTac/PegInsertion-v1").unwrapped)
    calls: list[int] = []
    env.scene.after_ipc_step = lambda: calls.append(1)
    copy.deepcopy(env).step(actions(env)[0])
    assert calls == []
    env.step(actions(env)[0])
    assert calls


def test_environments_in_processes_say_how_to_copy_them() -> None:
    env = gymnasium.make_vec("ViTac/PegInsertion-v1", 1)
    assert isinstance(env, ForkedVectorEnv)
    try:
        for way in WAYS.values():
            with pytest.raises(TypeError, match="Copy a single environment"):
                way(env)
    finally:
        env.close()
