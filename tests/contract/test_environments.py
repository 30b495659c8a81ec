"""What every registered environment keeps."""

import re
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any

import gymnasium
import numpy as np
import pytest
from environment_ids import EACH_ENVIRONMENT, ENV_IDS
from gymnasium.utils.env_checker import check_env
from trajectories import digests, trajectory_digest
from vitac.envs.tasks.settings import ResetOptionsError
from vitac.envs.tasks.task_env import ActionError
from vitac.errors import VitacError
from vitac.evaluator.tracks.definition import environment_definition

EVERY_TASKS_KEYS = {"marker_flow"}


@pytest.fixture(params=EACH_ENVIRONMENT, scope="module")
def env_id(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def env(env_id: str) -> Iterator[Any]:
    """An environment that all its tests go on with; `outcomes` starts an episode."""
    made = gymnasium.make(env_id, disable_env_checker=True)
    yield made.unwrapped
    made.close()


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a reset or an env step has left."""

    observation: dict[str, Any]
    info: dict[str, Any]
    state_hash: str
    ipc_steps: int


@pytest.fixture(scope="module")
def outcomes(env: Any) -> list[Outcome]:
    """What a reset leaves, and an env step after it."""
    made = []
    for call, arguments in (("reset", {"seed": 1}), ("step", {"action": np.ones(env.action_space.shape, np.float32)})):
        before = env.ipc_steps
        observation, *_, info = getattr(env, call)(**arguments)
        ipc_steps = env.ipc_steps - before
        made.append(Outcome(observation=observation, info=info, state_hash=env.state_hash(), ipc_steps=ipc_steps))
    return made


def test_registering_imports_neither_the_simulation_nor_the_service() -> None:
    script = (
        "import sys, vitac.envs, gymnasium\n"
        "heavy = [m for m in ('numba', 'sapien', 'torch', 'fastapi', 'sqlalchemy') if m in sys.modules]\n"
        "assert not heavy, heavy\n"
        "assert all(i in gymnasium.registry for i in vitac.envs.ENVIRONMENTS)\n"
    )
    subprocess.run([sys.executable, "-W", "error", "-c", script], check=True)


def test_gymnasium_finds_no_fault(env: Any) -> None:
    # Its unseeded resets go on from this one, so that every run checks the same episodes.
    env.reset(seed=0)
    check_env(env, skip_render_check=True)


def test_policy_sees_nothing_privileged(env: Any, outcomes: list[Outcome]) -> None:
    public = {entry.name for entry in env.task.observables if not entry.privileged}
    assert public >= EVERY_TASKS_KEYS
    assert not any(name.startswith("gt_") for name in public)
    for outcome in outcomes:
        assert set(outcome.observation) == public
        assert outcome.observation in env.observation_space


def test_privileged_keys_are_added_to_the_public_ones(env_id: str) -> None:
    env: Any = gymnasium.make(env_id, disable_env_checker=True, privileged=True).unwrapped
    observation, _ = env.reset(seed=1)
    assert set(observation) > {entry.name for entry in env.task.public_observables}
    assert observation in env.observation_space


def test_docstring_tables_list_every_observation_and_action(env_id: str) -> None:
    optional = environment_definition(env_id, {}).optional_observables
    env: Any = gymnasium.make(
        env_id,
        disable_env_checker=True,
        privileged=True,
        optional_observables=[entry.name for entry in optional],
    ).unwrapped
    docstring = type(env).__doc__ or ""
    rows = dict(re.findall(r"^ *\| (\w+) \| (\([\d, ]+\)) \|", docstring, re.MULTILINE))
    assert {key: str(space.shape) for key, space in env.observation_space.spaces.items()} == rows
    actions = re.findall(r"^ *\| (\d+) \| (\w+) \|", docstring, re.MULTILINE)
    assert [int(index) for index, _ in actions] == list(range(*env.action_space.shape))


def test_spaces_are_finite_numbers_of_at_most_32_bits(env: Any) -> None:
    assert env.action_space.dtype == np.float32
    assert (env.action_space.low == -1).all()
    assert (env.action_space.high == 1).all()
    for space in env.observation_space.spaces.values():
        assert space.dtype in (np.float32, np.uint8)
        assert np.isfinite(space.low).all()


def test_info_carries_step_reports_and_the_end_reason(outcomes: list[Outcome]) -> None:
    assert outcomes[0].info["end_reason"] is None
    for outcome in outcomes:
        assert len(outcome.info["step_reports"]) == outcome.ipc_steps > 0
    assert all(report.status != "not_converged" for report in outcomes[0].info["step_reports"])


def test_hashes_are_sha256_and_the_state_hash_moves(env: Any, outcomes: list[Outcome]) -> None:
    before, after = (outcome.state_hash for outcome in outcomes)
    assert re.fullmatch("[0-9a-f]{64}", before)
    assert re.fullmatch("[0-9a-f]{64}", env.mesh_hash())
    assert after != before


@pytest.mark.usefixtures("outcomes")
def test_refusals_are_ours_name_the_environment_and_play_nothing(env: Any, env_id: str) -> None:
    before = env.state_hash()
    with pytest.raises(ActionError, match=env_id):
        env.step(np.zeros(7, dtype=np.float32))
    with pytest.raises(ResetOptionsError, match=env_id):
        env.reset(options={"colour": "red"})
    for type_ in ("bool", "str", "complex64", "object"):
        with pytest.raises(
            ActionError, match=rf"Action for {env_id} is an array of type .*, expected an array of real"
        ):
            env.step(np.zeros(env.action_space.shape).astype(type_))
    with pytest.raises(ActionError, match="is a masked array of type float64, expected an array of real numbers"):
        env.step(np.ma.array(np.ones(env.action_space.shape), mask=True))
    assert env.state_hash() == before
    assert issubclass(ActionError, VitacError)


@pytest.mark.slow
def test_same_seed_and_actions_repeat_bit_for_bit_in_parallel_processes() -> None:
    with ProcessPoolExecutor(4, mp_context=get_context("spawn")) as pool:
        others = {env_id: pool.map(trajectory_digest, [env_id] * 4, [5] * 4, [2] * 4) for env_id in ENV_IDS}
        here = digests()
        assert {env_id: list(found) for env_id, found in others.items()} == {
            env_id: [here[env_id]] * 4 for env_id in ENV_IDS
        }
