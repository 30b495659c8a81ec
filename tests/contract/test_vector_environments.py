"""What every registered environment keeps in gymnasium's vector environments and in ours."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import gymnasium
import numpy as np
import pytest
from environment_ids import EACH_ENVIRONMENT
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv
from vitac.envs.tasks.making import ForkedVectorEnv, NumericInfos
from vitac.envs.tasks.task_env import ActionError

KINDS = {"sync": SyncVectorEnv, "async": AsyncVectorEnv, None: ForkedVectorEnv}
COPIES = 2
SEEDS = 2
ARGUMENTS: dict[str, Any] = {"max_steps": 1, "observation_keys": ("marker_flow",)}


@contextmanager
def vector(env_id: str, mode: str | None, copies: int = COPIES, **arguments: Any) -> Iterator[Any]:
    env = gymnasium.make_vec(env_id, copies, vectorization_mode=mode, **{**ARGUMENTS, **arguments})
    try:
        yield env
    finally:
        env.close()


def played(env: Any, seed: int, steps: int) -> list[tuple[Any, ...]]:
    """What comes of a reset and of random actions after it."""
    random = np.random.default_rng(seed)
    outcomes: list[tuple[Any, ...]] = [env.reset(seed=seed)]
    for _ in range(steps):
        outcomes.append(env.step(random.uniform(-1, 1, env.action_space.shape).astype(np.float32)))
    return outcomes


def entries(info: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Entries that are numbers, and how the episodes ended."""
    return ((key, value) for key, value in info.items() if value.dtype != object or key == "end_reason")


@pytest.mark.slow
@pytest.mark.parametrize("env_id", EACH_ENVIRONMENT)
def test_all_kinds_play_the_same_episodes_through_autoreset(env_id: str) -> None:
    runs = []
    for mode, kind in KINDS.items():
        with vector(env_id, mode) as env:
            assert type(env) is kind
            runs.append([outcome for seed in range(SEEDS) for outcome in played(env, seed, 2)])
    ends = sum(int((outcome[2] | outcome[3]).sum()) for outcome in runs[0] if len(outcome) == 5)
    assert ends == SEEDS * COPIES, "every episode ends with its first env step, and the second one starts another"
    for run in runs[1:]:
        for one, other in zip(runs[0], run, strict=True):
            for key, value in one[0].items():
                np.testing.assert_array_equal(value, other[0][key])
            assert [np.asarray(part).tolist() for part in one[1:-1]] == [
                np.asarray(part).tolist() for part in other[1:-1]
            ]
            for key, value in entries(one[-1]):
                np.testing.assert_array_equal(value, other[-1][key], err_msg=key)


@pytest.mark.slow
@pytest.mark.parametrize("env_id", EACH_ENVIRONMENT)
def test_infos_have_one_shape_through_thirty_steps_of_mixed_shapes(env_id: str) -> None:
    shapes: dict[str, set[tuple[int, ...]]] = {}
    played_shapes: set[float] = set()
    arguments = {"privileged": True, "observation_keys": ("shape",)}
    with vector(env_id, "sync", 1, **arguments) as env:
        for observation, *_, info in played(env, 5, 30):
            played_shapes.update(observation["shape"].ravel().tolist())
            for key, value in info.items():
                shapes.setdefault(key, set()).add(value.shape)
        has_several_shapes = len(env.envs[0].unwrapped.shape_type) > 1
    assert (len(played_shapes) > 1) == has_several_shapes
    assert {key: found for key, found in shapes.items() if len(found) > 1} == {}


def test_starts_that_were_asked_for_are_kept_by_autoreset() -> None:
    arguments = {"shapes": ("concave1",), "random_xy_mm": 3.0, "privileged": True, "observation_keys": ("shape",)}
    with vector("ViTac/PegInsertion-v1", "sync", 2, **arguments) as env:
        outcomes = played(env, 3, 12)
    assert {number for outcome in outcomes for number in outcome[0]["shape"].ravel().tolist()} == {2.0}
    starts = [outcome[-1]["gt_offset_mm_deg"][outcome[-1]["steps"] == 0] for outcome in outcomes]
    assert sum(len(start) for start in starts) > 4
    assert np.abs(np.concatenate(starts)[:, :2]).max() <= 3.0


@pytest.mark.parametrize("mode", ["SameStep", "Disabled"])
def test_our_environments_start_the_next_episode_as_asked_and_as_gymnasiums_do(mode: str) -> None:
    runs = []
    for env in (
        gymnasium.make_vec("ViTac/PegInsertion-v1", 2, autoreset_mode=mode, **ARGUMENTS),
        gymnasium.make_vec(
            "ViTac/PegInsertion-v1", 2, "sync", vector_kwargs={"autoreset_mode": AutoresetMode(mode)}, **ARGUMENTS
        ),
    ):
        env.reset(seed=4)
        observed, _, _, truncated, info = env.step(np.zeros((2, 3), dtype=np.float32))
        assert truncated.all()
        last = info["final_obs"][1] if mode == "SameStep" else {key: value[1] for key, value in observed.items()}
        if mode == "Disabled":
            observed, _ = env.reset(options={"reset_mask": truncated})
        runs.append((observed["marker_flow"].tolist(), last["marker_flow"].tolist()))
        env.close()
    assert runs[0] == runs[1]


def test_wrappers_are_put_around_each_environment() -> None:
    wrappers = (NumericInfos, gymnasium.wrappers.FlattenObservation)
    keys = ("marker_flow", "relative_motion")
    with vector("ViTac/PegInsertion-v1", None, 2, env_wrappers=wrappers, observation_keys=keys) as env:
        observation, info = env.reset(seed=0)
    assert observation.shape == (2, 2 * 2 * 128 * 2 + 4)
    assert info["end_reason"].tolist() == [0, 0]


def test_our_processes_are_forked_after_loading() -> None:
    with vector("ViTac/PegInsertion-v1", None, 2) as env:
        assert env.num_envs == 2
        assert [process._start_method for process in env.processes] == ["fork", "fork"]
        observation, _ = env.reset(seed=0)
        assert observation["marker_flow"].shape == (2, 2, 2, 128, 2)


@pytest.mark.filterwarnings("ignore::UserWarning")  # gymnasium's own log
def test_a_failure_in_a_process_is_told_with_its_own_words() -> None:
    env = gymnasium.make_vec("ViTac/PegInsertion-v1", 2, **ARGUMENTS)
    env.reset(seed=0)
    with pytest.raises(ActionError, match="is not finite; expected -1 to 1"):
        env.step(np.full((2, 3), np.nan, dtype=np.float32))
    env.close(terminate=True)
