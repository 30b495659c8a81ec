"""Plays one episode with a policy, or again with recorded actions."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, Protocol, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import JsonValue
from vitac.envs.maniskill.definition import is_maniskill
from vitac.errors import VitacError

from ..agent.protocol import CloudSpec
from ..agent.session import Isolation
from ..agent.verdicts import PolicyFailed
from ..tracks import Episode, Task
from ..tracks.definition import WhileThinking
from .records import (
    ActionSequence,
    ContactForces,
    EpisodeOutcome,
    EpisodeRecord,
    FailureStage,
    Observation,
    PolicyFailure,
    Reading,
    SampledPicture,
    Timings,
    make_reading,
)
from .traces import ForceTrace, PictureSample

if TYPE_CHECKING:
    from vitac.envs.tactile.design import SensorDesign


_INFO_KEYS_NOT_RECORDED = frozenset({"step_reports"})


class EnvironmentBroken(VitacError):
    """An environment did not keep its contract with the evaluator; this is a fault of ours, never of a team."""


class Environment(Protocol):
    """What the evaluator needs of an environment, beyond gymnasium's `reset` and `step`.

    Counts and times [s] are sums since it was made.
    """

    solver_version: str
    ipc_steps: int
    physics_cpu_s: float
    marker_cpu_s: float

    def reset(self, *, options: Mapping[str, object]) -> tuple[Observation, dict[str, Any]]:
        """Start an episode."""

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Play one env step; continue after an end, so that recorded actions can all be played."""

    def state_hash(self) -> str:
        """Return the SHA-256 [hex] of the physical state."""

    def picture_hash(self) -> str | None:
        """Return the SHA-256 [hex] of what the task's cameras see now; None where it has none."""

    def mesh_hash(self) -> str:
        """Return the SHA-256 [hex] of the meshes and materials in use."""


class PlayingPolicy(Protocol):
    """A policy within one episode. Its times [s] are those of the episode so far."""

    @property
    def cpu_s(self) -> float:
        """CPU time of the policy."""

    @property
    def channel_s(self) -> float:
        """Time between question and answer that the policy did not compute."""

    @property
    def answers_s(self) -> Sequence[float]:
        """Of a policy elsewhere the time of each answer."""

    @property
    def output(self) -> str:
        """The end of what it has printed in the episode."""

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the action for an observation.

        Raises:
            PolicyFailed: it crashed, broke a limit or answered wrongly.
            EpisodeCut: it is remote, and its line was cut.
        """


class Session(Protocol):
    """A policy that is loaded and waits to play episodes."""

    @property
    def isolation(self) -> Isolation | None:
        """How strongly it is isolated; None where it is ours."""

    def begin_shard(self) -> None:
        """Count the time of another shard from here on."""

    def episode(
        self, *, task: str, action_shape: tuple[int, ...], clouds: Sequence[CloudSpec] = ()
    ) -> AbstractContextManager[PlayingPolicy]:
        """Return a fresh process of the policy for one episode.

        Raises:
            PolicyFailed: its reset failed.
        """


OpenSession = Callable[[], Session]
MakeEnvironment = Callable[["Task", Path | None, Sequence[str] | None], Environment]


def make_environment(
    task: Task,
    assets_dir: Path | None = None,
    observation_keys: Sequence[str] | None = None,
    *,
    sensor: "SensorDesign | None" = None,
    settings: Mapping[str, object] | None = None,
) -> Environment:
    """Return the environment of a task, as policies are scored in it (nothing privileged).

    Args:
        task: whose environment.
        assets_dir: folder with the challenge's own meshes; our own generated ones by default.
        observation_keys: what is observed; all that the track lists by default.
        sensor: design of both sensors; the challenge's by default.
        settings: in place of the task's own, for measurements.
    """
    if is_maniskill(task.env_id):
        return _make_maniskill(task, observation_keys)
    import gymnasium
    import vitac.envs  # noqa: F401 - registers the environment ids

    arguments: dict[str, Any] = {"assets_dir": assets_dir, "observation_keys": observation_keys}
    arguments |= {**task.environment_arguments, **(settings or {})}
    if sensor is not None:
        arguments["sensor"] = sensor
    env = gymnasium.make(task.env_id, disable_env_checker=True, privileged=False, **arguments)
    return cast(Environment, env.unwrapped)


def _make_maniskill(task: Task, observation_keys: Sequence[str] | None) -> Environment:
    """Return an environment of ManiSkill, which the challenge's own meshes and sensors play no part in."""
    from vitac.envs.maniskill.env import ManiSkillEnv

    return ManiSkillEnv(
        task.env_id, max_steps=task.max_steps, observation_keys=observation_keys, settings=dict(task.settings)
    )


@dataclass(kw_only=True)
class _Trace:
    """What has happened so far in an episode."""

    sample: PictureSample
    forces: ForceTrace = field(default_factory=ForceTrace)
    actions: list[NDArray[np.float32]] = field(default_factory=list)
    state_hashes: list[str] = field(default_factory=list)
    infos: list[dict[str, JsonValue]] = field(default_factory=list)
    total_reward: float = 0.0
    outcome: EpisodeOutcome | None = None
    failure: PolicyFailure | None = None
    policy_s: float = 0.0
    channel_s: float = 0.0
    answers_s: Sequence[float] = ()
    output: str = ""


def run_episode(
    *, env: Environment, task: Task, episode: Episode, open_session: OpenSession, reading: Reading | None = None
) -> EpisodeRecord:
    """Play one episode to its end, or to the failure of the policy.

    Args:
        env: the task's environment; it is reset here.
        task: what is played.
        episode: the fixed start.
        open_session: gives the loaded policy; a `PolicyFailed` out of it means that it cannot be loaded.
        reading: what the policy reads; all that the track lists by default.

    Raises:
        EnvironmentBroken: the environment gave keys that the policy does not read, or did not end.
        EpisodeCut: the policy is remote, and its line was cut.
    """
    started, physics_s, markers_s = perf_counter(), env.physics_cpu_s, env.marker_cpu_s
    trace = _Trace(sample=PictureSample(env, episode))
    observation, _ = env.reset(options=episode.options)
    trace.state_hashes.append(trace.sample.look(env_step=0))
    _play_or_fail(env, task, open_session, observation, trace, reading or make_reading(task))
    timings = Timings(
        physics_s=env.physics_cpu_s - physics_s,
        markers_s=env.marker_cpu_s - markers_s,
        policy_s=trace.policy_s,
        channel_s=trace.channel_s,
        answers_s=tuple(round(answer_s, 6) for answer_s in trace.answers_s),
        wall_s=perf_counter() - started,
    )
    return _record(task, episode, trace, timings)


def json_info(info: Mapping[str, Any]) -> dict[str, JsonValue]:
    """Return an env step's info as JSON values; arrays become lists. Solver reports are omitted."""
    return {key: _json_value(key, value) for key, value in info.items() if key not in _INFO_KEYS_NOT_RECORDED}


def _play_or_fail(
    env: Environment, task: Task, open_session: OpenSession, observation: Observation, trace: _Trace, reading: Reading
) -> None:
    stage = FailureStage.LOAD
    try:
        session = open_session()
        stage = FailureStage.EPISODE
        with open_episode(session, task, reading) as policy:
            try:
                _play(env, task, policy, observation, trace, reading)
            finally:
                trace.policy_s, trace.channel_s, trace.output = policy.cpu_s, policy.channel_s, policy.output
                trace.answers_s = policy.answers_s
    except PolicyFailed as failed:
        if trace.outcome is not None:
            return  # It failed after its last action; what it did in the episode stands.
        trace.outcome = EpisodeOutcome.POLICY_FAILED
        trace.failure = PolicyFailure(
            stage=stage, code=failed.verdict, message=failed.message, output_tail=failed.output_tail
        )


def _play(
    env: Environment, task: Task, policy: PlayingPolicy, observation: Observation, trace: _Trace, reading: Reading
) -> None:
    while trace.outcome is None:
        if len(trace.actions) == task.max_steps:
            raise EnvironmentBroken(
                f"{task.env_id} did not end within {task.max_steps} env steps; its limit must hold."
            )
        action = policy.act(public_part(task, reading, observation))
        observation, reward, terminated, truncated, info = env.step(action)
        trace.actions.append(np.array(action, dtype=np.float32))
        trace.state_hashes.append(trace.sample.look(env_step=len(trace.actions)))
        trace.infos.append(json_info(info))
        trace.forces.add(info)
        trace.total_reward += float(reward)
        if terminated or truncated:
            trace.outcome = EpisodeOutcome(info["end_reason"])


@contextmanager
def open_episode(session: Session, task: Task, reading: Reading) -> Iterator[PlayingPolicy]:
    """Give a fresh process of the policy that plays a task, with the task's delay.

    Raises:
        PolicyFailed: its reset failed.
    """
    with session.episode(task=task.name, action_shape=(len(task.actions),), clouds=reading.clouds) as policy:
        yield delayed(policy, task)


def delayed(policy: PlayingPolicy, task: Task) -> PlayingPolicy:
    """Return a policy as its task plays it: with its delay, if it has one."""
    return _LatePolicy(policy, task) if task.delay_steps else policy


class _LatePolicy:
    """A policy whose answer to an observation is played some env steps later, as simulated time goes on meanwhile.

    It is asked again with the observation after its action. So the same actions follow whatever the machine's speed.
    """

    def __init__(self, policy: PlayingPolicy, task: Task) -> None:
        self._policy = policy
        self._task = task
        self._env_step = 0
        self._held = np.zeros(len(task.actions), np.float32)
        self._answer = self._held

    @property
    def cpu_s(self) -> float:
        """CPU time of the policy."""
        return self._policy.cpu_s

    @property
    def channel_s(self) -> float:
        """Time between question and answer that the policy did not compute."""
        return self._policy.channel_s

    @property
    def answers_s(self) -> Sequence[float]:
        """Of a policy elsewhere the time of each answer."""
        return self._policy.answers_s

    @property
    def output(self) -> str:
        """The end of what it has printed in the episode."""
        return self._policy.output

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return what is done in the next env step: what is done meanwhile, or the answer once its time has come.

        Raises:
            PolicyFailed: it crashed, broke a limit or answered wrongly.
            EpisodeCut: it is remote, and its line was cut.
        """
        since_question = self._env_step % (self._task.delay_steps + 1)
        self._env_step += 1
        if since_question == 0:
            self._answer = self._policy.act(observation)
        if since_question < self._task.delay_steps:
            return self._held
        if self._task.while_thinking is WhileThinking.HOLD:
            self._held = self._answer
        return self._answer


def public_part(task: Task, reading: Reading, observation: Observation) -> Observation:
    """Return the observation, after making sure that it holds what is to be sent and nothing else."""
    if set(observation) != set(reading.sent):
        raise EnvironmentBroken(
            f"{task.env_id} gave observation keys {sorted(observation)}, expected exactly {sorted(reading.sent)}; "
            "a policy must never see a key that the track does not list or that it does not read."
        )
    return observation


def _record(task: Task, episode: Episode, trace: _Trace, timings: Timings) -> EpisodeRecord:
    actions = np.array(trace.actions, dtype=np.float32).reshape(len(trace.actions), len(task.actions))
    assert trace.outcome is not None  # noqa: S101 - _play_or_fail ends with one
    return EpisodeRecord(
        episode=episode.number,
        task=task.name,
        shape=episode.shape,
        initial_offset=episode.offset,
        outcome=trace.outcome,
        env_steps=len(trace.actions),
        total_reward=trace.total_reward,
        actions=ActionSequence.from_array(actions),
        state_hashes=tuple(trace.state_hashes),
        infos=tuple(trace.infos),
        picture=trace.sample.picture,
        forces=trace.forces.figures(),
        failure=trace.failure,
        timings=timings,
        output=trace.output,
    )


def _json_value(key: str, value: object) -> JsonValue:
    if isinstance(value, np.ndarray):
        return cast(JsonValue, value.tolist())
    if isinstance(value, np.generic):
        return cast(JsonValue, value.item())
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, Mapping):
        return {name: _json_value(key, item) for name, item in value.items()}
    if isinstance(value, tuple | list):
        return [_json_value(key, item) for item in value]
    raise EnvironmentBroken(
        f"info[{key!r}] is a {type(value).__name__}; only arrays, numbers, text, lists and mappings can be recorded."
    )


@dataclass(frozen=True, kw_only=True)
class Resimulated:
    """An episode played again.

    `state_hashes` starts with the reset's. `end_step` counts from 1; it and `outcome` are None where nothing ended it.
    `picture` and `forces` are of the env steps up to its end.
    """

    state_hashes: tuple[str, ...]
    infos: tuple[dict[str, JsonValue], ...]
    total_reward: float
    outcome: EpisodeOutcome | None
    end_step: int | None
    picture: SampledPicture | None
    forces: ContactForces | None
    timings: Timings


def resimulate(env: Environment, episode: Episode, actions: NDArray[np.float32]) -> Resimulated:
    """Play all recorded actions, also those after the env step that ends the episode.

    Args:
        env: environment of the task.
        episode: the start.
        actions: raw float32 actions, shape [env steps, action size].

    Returns:
        What happened; the reward is that up to the end of the episode.
    """
    started, physics_s, markers_s = perf_counter(), env.physics_cpu_s, env.marker_cpu_s
    sample, forces = PictureSample(env, episode), ForceTrace()
    env.reset(options=episode.options)
    state_hashes, infos = [sample.look(env_step=0)], []
    total_reward, outcome, end_step = 0.0, None, None
    for step, action in enumerate(actions, start=1):
        _, reward, terminated, truncated, info = env.step(action)
        state_hashes.append(sample.look(step) if end_step is None else env.state_hash())
        infos.append(json_info(info))
        if end_step is None:
            total_reward += float(reward)
            forces.add(info)
            if terminated or truncated:
                outcome, end_step = EpisodeOutcome(info["end_reason"]), step
    return Resimulated(
        state_hashes=tuple(state_hashes),
        infos=tuple(infos),
        total_reward=total_reward,
        outcome=outcome,
        end_step=end_step,
        picture=sample.picture,
        forces=forces.figures(),
        timings=Timings(
            physics_s=env.physics_cpu_s - physics_s,
            markers_s=env.marker_cpu_s - markers_s,
            wall_s=perf_counter() - started,
        ),
    )
