"""The policy of a submission that plays a task, in its sandbox, to be copied by a learner that sees what it saw."""

from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from vitac.errors import VitacError
from vitac.evaluator.agent.limits import Limits
from vitac.evaluator.agent.verdicts import PolicyFailed
from vitac.evaluator.episodes.episode import Session, make_environment, open_episode, public_part
from vitac.evaluator.episodes.reading import make_reading
from vitac.evaluator.shards.policy import load_in_sandbox
from vitac.evaluator.submission.manifest import load_manifest
from vitac.evaluator.tracks import Task, Track

from .expert import Rollout


class PolicyStopped(VitacError):
    """The policy failed in an episode; `vitac evaluate` says how often it does."""


class PolicyPlayer:
    """Plays a task by a policy, which each process that plays loads once.

    Args:
        track: of the task.
        task: that is played.
        submission: folder of the unpacked submission.
    """

    def __init__(self, track: Track, task: Task, submission: Path) -> None:
        self._reading = make_reading(task, load_manifest(submission).observation_keys)
        self.env: Any = make_environment(task, None, self._reading.sent)
        self._track, self._task, self._submission = track, task, submission
        self._exits = ExitStack()
        self._session: Session | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._exits.close()

    def play(self, options: Mapping[str, Any], *, spread: float, random: np.random.Generator) -> Rollout:
        """Play an episode.

        Args:
            options: of `reset`.
            spread: standard deviation of what is added to every number of an action.
            random: draws it.

        Raises:
            PolicyStopped: the policy failed.
            SandboxFailed: this machine cannot isolate it.
        """
        observation, info = self.env.reset(options=options)
        actions, state_hashes, total_reward = [], [self.env.state_hash()], 0.0
        try:
            with open_episode(self._load(), self._task, self._reading) as policy:
                while info["end_reason"] is None:
                    action = policy.act(public_part(self._task, self._reading, observation))
                    noisy = action + spread * random.standard_normal(len(action))
                    actions.append(np.asarray(np.clip(noisy, -1.0, 1.0), dtype=np.float32))
                    observation, reward, _, _, info = self.env.step(actions[-1])
                    state_hashes.append(self.env.state_hash())
                    total_reward += float(reward)
        except PolicyFailed as failure:
            raise PolicyStopped(f"The policy failed with {dict(options)}: {failure}") from failure
        return Rollout(
            info=info, actions=np.array(actions), state_hashes=tuple(state_hashes), total_reward=total_reward
        )

    def _load(self) -> Session:
        if self._session is None:
            session = load_in_sandbox(self._submission, Limits(), self._track.packages)
            self._session = self._exits.enter_context(session)
        self._session.begin_shard()
        return self._session
