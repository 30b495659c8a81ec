"""The fixed cut of an episode list into shards, and running one: the unit of queue work and of resuming.

`vitac evaluate` and the service's workers both call `run_shard` (through `shard_process`).
"""

from collections.abc import Callable, Collection, Iterable, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from random import SystemRandom

from vitac.envs.errors import VitacError

from .agent.limits import Limits
from .agent.session import Isolation, PolicySession
from .agent.verdicts import VerdictCode
from .episodes import Environment, Session, make_environment, run_episode
from .log_findings import LogFinding
from .records import EpisodeRecord, FailureStage, Manifest, PolicyFailure
from .strict_model import StrictModel
from .submission import load_manifest
from .tracks import Episode, Task, Track
from .version import evaluator_hash, evaluator_version, platform_class

FAILURES_THAT_END_A_SHARD = 3
"""This many policy failures within one shard end the evaluation as failed: the policy is broken, not unlucky."""


LoadPolicy = Callable[[Path, Limits, int], AbstractContextManager[Session]]


class UnknownEpisodes(VitacError):
    """Episodes were asked for that the list does not have."""


@dataclass(frozen=True, kw_only=True)
class Shard:
    """Neighbouring episodes of a list. `index` counts from 0 in the cut of the whole list."""

    index: int
    episodes: tuple[Episode, ...]

    @property
    def numbers(self) -> frozenset[int]:
        """Numbers of its episodes."""
        return frozenset(episode.number for episode in self.episodes)


class ShardEnd(StrEnum):
    """Why the run of a shard ended."""

    COMPLETE = "complete"
    """All its episodes have a record."""
    BROKEN = "broken"
    """The policy cannot be loaded or failed too often; the rest was not played."""
    REFUTED = "refuted"
    """What was re-simulated is not true; the finding says why, and the rest was not re-simulated."""
    CANCELLED = "cancelled"
    """The caller asked to stop."""


class ShardResult(StrictModel):
    """What the run of a shard ended with; its records went to `on_episode` one by one."""

    index: int
    end: ShardEnd
    manifest: Manifest
    isolation: Isolation | None
    """How strongly the policy was isolated; None if it was not started or did not load."""
    finding: LogFinding | None = None
    """Why a log is not true; None for models and as long as the log holds."""


def cut(task: Task, episodes: Iterable[int] | None = None) -> tuple[Shard, ...]:
    """Cuts the task's list into shards of `task.shard_size`, always at the same places.

    Args:
        task: whose list.
        episodes: numbers to keep; all by default. Shards that lose all their episodes are left out.

    Raises:
        UnknownEpisodes: a number is not in the list, or none is asked for.
    """
    listed = frozenset(episode.number for episode in task.episodes)
    wanted = listed if episodes is None else frozenset(episodes)
    if not wanted or not wanted <= listed:
        came = ", ".join(map(str, sorted(wanted - listed)[:5])) or "none"
        raise UnknownEpisodes(f"Episodes of {task.name} must be among 1 to {len(listed)}; came {came}.")
    starts = range(0, len(task.episodes), task.shard_size)
    pieces = (task.episodes[start : start + task.shard_size] for start in starts)
    kept = (tuple(episode for episode in piece if episode.number in wanted) for piece in pieces)
    return tuple(Shard(index=index, episodes=piece) for index, piece in enumerate(kept) if piece)


def is_broken(failures: Collection[PolicyFailure]) -> bool:
    """Whether a policy with these failures in one shard is given up."""
    return any(map(_ends_at_once, failures)) or len(failures) >= FAILURES_THAT_END_A_SHARD


def breaking_failure(shards: Sequence[Shard], records: Iterable[EpisodeRecord]) -> PolicyFailure | None:
    """The failure that ends an evaluation as failed, or None while the policy works well enough to be scored.

    That is the first failure of the first shard that is broken, or there the one that ended it at once: a function of
    the records and the fixed cut only, so the same for any number of workers and for a resumed evaluation.
    """
    failures = {record.episode: record.failure for record in records if record.failure}
    for shard in sorted(shards, key=lambda shard: shard.index):
        in_shard = [failures[number] for number in sorted(shard.numbers & failures.keys())]
        if is_broken(in_shard):
            return next(filter(_ends_at_once, in_shard), in_shard[0])
    return None


def _ends_at_once(failure: PolicyFailure) -> bool:
    """Whether no other episode of the shard could be played after this failure."""
    return failure.stage is FailureStage.LOAD or failure.code is VerdictCode.SHARD_TIME


def make_manifest(track: Track, task: Task, env: Environment) -> Manifest:
    """What an evaluation in this environment is made with."""
    return Manifest(
        track=track.name,
        task=task.name,
        list_seed=task.episode_list.list_seed,
        task_hash=task.digest(),
        evaluator_version=evaluator_version(),
        evaluator_hash=evaluator_hash(),
        solver_version=env.solver_version,
        mesh_hash=env.mesh_hash(),
        platform_class=platform_class(),
    )


def load_in_sandbox(submission_dir: Path, limits: Limits, slot: int) -> AbstractContextManager[Session]:
    """Loads the policy of a submission in its sandbox.

    Raises:
        PolicyFailed: it cannot be loaded.
        SandboxFailed: the isolation could not be set up.
    """
    entry_point = load_manifest(submission_dir).entry_point
    return PolicySession(submission_dir, entry_point=entry_point, limits=limits, slot=slot)


def run_shard(
    *,
    submission_dir: Path,
    track: Track,
    task: Task,
    shard: Shard,
    on_episode: Callable[[EpisodeRecord], None],
    limits: Limits | None = None,
    slot: int = 0,
    assets_dir: Path | None = None,
    skip: Collection[int] = (),
    earlier_failures: Sequence[PolicyFailure] = (),
    cancelled: Callable[[], bool] = lambda: False,
    load_policy: LoadPolicy = load_in_sandbox,
    make_env: Callable[[Task, Path | None], Environment] = make_environment,
) -> ShardResult:
    """Plays the episodes of a shard, each in a fresh process of the policy.

    The order is secret: a policy cannot be kept from the clock, and in a known order the time would tell it which
    episode it plays.

    Args:
        submission_dir: folder of the unpacked submission, the one that holds `submission.yaml`.
        track: the track of the task.
        task: what is played.
        shard: which episodes.
        on_episode: gets each record as soon as its episode is over.
        limits: of the policy; the default ones if None.
        slot: number of this worker on its machine; concurrent runs need different ones.
        assets_dir: folder with the challenge's own meshes; our own generated ones by default.
        skip: episodes that have a record already.
        earlier_failures: policy failures among the skipped ones.
        cancelled: looked at before each episode.
        load_policy: loads the policy of a submission; in the sandbox by default.
        make_env: gives the environment.

    Raises:
        VitacError: the sandbox or the environment broke. This is never the team's fault; run the shard again.
    """
    env = make_env(task, assets_dir)
    failures = list(earlier_failures)
    end = ShardEnd.BROKEN if is_broken(failures) else ShardEnd.COMPLETE
    with ExitStack() as stack:
        policy = _LoadedPolicy(lambda: stack.enter_context(load_policy(submission_dir, limits or Limits(), slot)))
        for episode in _secret_order(episode for episode in shard.episodes if episode.number not in skip):
            if end is ShardEnd.COMPLETE and cancelled():
                end = ShardEnd.CANCELLED
            if end is not ShardEnd.COMPLETE:
                break
            record = run_episode(env=env, task=task, episode=episode, open_session=policy)
            on_episode(record)
            failures.extend([record.failure] if record.failure else [])
            end = ShardEnd.BROKEN if is_broken(failures) else ShardEnd.COMPLETE
    manifest = make_manifest(track, task, env)
    return ShardResult(index=shard.index, end=end, manifest=manifest, isolation=policy.isolation)


class _LoadedPolicy:
    """The policy of a shard, loaded when an episode first asks for it."""

    def __init__(self, load: Callable[[], Session]) -> None:
        self._load = load
        self._session: Session | None = None

    def __call__(self) -> Session:
        if self._session is None:
            self._session = self._load()
        return self._session

    @property
    def isolation(self) -> Isolation | None:
        return self._session.isolation if self._session else None


def _secret_order(episodes: Iterable[Episode]) -> list[Episode]:
    shuffled = list(episodes)
    SystemRandom().shuffle(shuffled)
    return shuffled
