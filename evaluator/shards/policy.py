"""Plays the episodes of a shard with a policy in the sandbox, prepared before they begin; called by `execution`."""

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from random import SystemRandom
from typing import Self

from ..agent.isolation.gpu import find_gpu
from ..agent.limits import Limits
from ..agent.session import Isolation, PolicySession
from ..agent.verdicts import EpisodeCut
from ..episodes.episode import Environment, MakeEnvironment, Session, make_environment, run_episode
from ..episodes.records import EpisodeRecord, PolicyFailure, Reading, make_manifest, make_reading
from ..isolation_kinds import IsolationKind
from ..package_sets import PackageSet
from ..scoring.score import is_broken
from ..submission.image import load_program
from ..submission.manifest import load_manifest
from ..submission_kinds import SubmissionKind
from ..tracks import Episode, Task, Track
from ..tracks.definition import ShardEpisodes
from .order import ShardEnd, ShardOrder, ShardResult

LoadPolicy = Callable[[Path, Limits], AbstractContextManager[Session]]


def load_in_sandbox(
    submission_dir: Path,
    limits: Limits,
    packages: tuple[PackageSet, ...] = (),
    episode_period_s: float | None = None,
    isolation: IsolationKind | None = None,
    kind: SubmissionKind = SubmissionKind.MODEL,
) -> AbstractContextManager[Session]:
    """Load the policy of a submission in its sandbox, with the sets of packages that its track declares.

    Raises:
        PolicyFailed: it cannot be loaded.
        SandboxFailed: the isolation could not be set up.
    """
    manifest, image = load_manifest(submission_dir), None
    if kind.form.is_image:
        image = load_program(submission_dir)
        image = image if manifest.needs is None else replace(image, gpu=find_gpu())
    return PolicySession(
        submission_dir,
        entry_point=manifest.entry_point if image is not None else manifest.own_entry_point(),
        image=image,
        limits=limits,
        packages=packages,
        episode_period_s=episode_period_s,
        kind=isolation,
    )


def load_remote(submission_dir: Path, limits: Limits, address: str) -> AbstractContextManager[Session]:
    """Open the line to the policy server of a submission.

    Raises:
        PolicyFailed: it does not answer.
        AddressInvalid: the address is none.
    """
    from ..remote.session import RemoteSession

    return RemoteSession(address, load_manifest(submission_dir).server(), limits)


def run_shard(
    *,
    submission_dir: Path,
    track: Track,
    task: Task,
    shard: ShardEpisodes,
    on_episode: Callable[[EpisodeRecord], None],
    reading: Reading | None = None,
    limits: Limits | None = None,
    assets_dir: Path | None = None,
    skip: Collection[int] = (),
    failures: list[PolicyFailure] | None = None,
    load_policy: LoadPolicy = load_in_sandbox,
    make_env: MakeEnvironment = make_environment,
) -> ShardResult:
    """Play the episodes of a shard, each in a fresh process of the policy.

    The order is secret: a policy can always read the clock, and in a known order the time would tell it which
    episode it plays.

    Args:
        submission_dir: folder of the unpacked submission, the one that holds `submission.yaml`.
        track: the track of the task.
        task: what is played.
        shard: which episodes.
        on_episode: gets each record as soon as its episode is over.
        reading: what the policy reads; all that the track lists by default.
        limits: of the policy; the default ones if None.
        assets_dir: folder with the challenge's own meshes; our own generated ones by default.
        skip: episodes that have a record already.
        failures: of the policy in the shard so far, to which this adds; whoever play parts of a shard share them.
        load_policy: loads the policy of a submission; in the sandbox by default.
        make_env: gives the environment.

    Raises:
        VitacError: the sandbox or the environment broke. This is never the team's fault; run the shard again.
    """
    reading = reading or make_reading(task)
    env = make_env(task, assets_dir, reading.sent)
    failures = [] if failures is None else failures
    with ExitStack() as stack:
        policy = _LoadedPolicy(lambda: stack.enter_context(load_policy(submission_dir, limits or Limits())))
        for episode in secret_order(episode for episode in shard.episodes if episode.number not in skip):
            if is_broken(failures):
                break
            record = _play_uncut(
                partial(run_episode, env=env, task=task, episode=episode, open_session=policy, reading=reading)
            )
            on_episode(record)
            failures.extend([record.failure] if record.failure else [])
    end = ShardEnd.BROKEN if is_broken(failures) else ShardEnd.COMPLETE
    manifest = make_manifest(track, task, env)
    return ShardResult(index=shard.index, end=end, manifest=manifest, isolation=policy.isolation)


def _play_uncut(play: Callable[[], EpisodeRecord]) -> EpisodeRecord:
    """Play an episode again as often as a line was cut; the session of the line ends that with a verdict."""
    while True:
        with suppress(EpisodeCut):
            return play()


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


def secret_order(episodes: Iterable[Episode]) -> list[Episode]:
    """Return the episodes in an order that nobody can foresee."""
    shuffled = list(episodes)
    SystemRandom().shuffle(shuffled)
    return shuffled


class Preparation:
    """Environment and loaded policy, made when a shard first asks for them and used until an order needs others.

    Every episode runs in a fresh copy of the loaded policy and in a fresh scene, whichever shard it belongs to, so
    that shards have no more in common than the episodes of one shard.
    """

    def __init__(self) -> None:
        self._exits = ExitStack()
        self._of: dict[str, object] | None = None
        self._environment: Environment | None = None
        self._session: Session | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.forget()

    def begin(self, order: ShardOrder) -> None:
        """Begin a shard: forget what was prepared for another order, and count its time from zero."""
        if self._of != order.preparation():
            self.forget()
        self._of = order.preparation()
        if self._session is not None:
            self._session.begin_shard()

    def environment(
        self, make: MakeEnvironment, task: Task, assets_dir: Path | None, observation_keys: Sequence[str] | None
    ) -> Environment:
        """Return the environment, which `make` makes the first time."""
        if self._environment is None:
            self._environment = make(task, assets_dir, observation_keys)
        return self._environment

    @contextmanager
    def policy(self, load: "LoadPolicy", submission_dir: Path, limits: Limits) -> Iterator[Session]:
        """Give the loaded policy, which `load` loads the first time; it stays loaded when the block is left.

        Raises:
            PolicyFailed: it cannot be loaded.
            SandboxFailed: the isolation could not be set up.
        """
        if self._session is None:
            self._session = self._exits.enter_context(load(submission_dir, limits))
        yield self._session

    def forget(self) -> None:
        """Give up environment and policy, and end its sandbox."""
        self._environment = self._session = None
        self._exits.close()
