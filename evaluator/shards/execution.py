"""Runs a shard in this process, whatever plays it, and answers line by line."""

import io
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from types import MappingProxyType
from typing import IO, TYPE_CHECKING, Self

from vitac.errors import VitacError

from ..agent.isolation.packages import policy_versions
from ..episodes.episode import Environment, MakeEnvironment, Resimulated, make_environment, resimulate
from ..episodes.records import ActionSequence, EpisodeOutcome, EpisodeRecord, Manifest, make_manifest, make_reading
from ..logs.checks import explain_impossible, must_agree
from ..logs.findings import LogFinding
from ..logs.log import LogReader, open_log
from ..logs.recordings import Recording
from ..logs.text_2025 import read_text_log, summarize
from ..logs.text_2025.recordings import explain_not_resimulated, text_log_recordings
from ..logs.verification import check_episode
from ..sensors.made import read_design
from ..submission.manifest import load_manifest
from ..submission_kinds import SubmissionKind
from ..tracks import Player, Task
from ..tracks.definition import cut
from ..tracks.registry import find_version
from ..tracks.sealed import load_played_track, read_secret
from .batch import run_batches
from .estimator import run_estimator
from .host_process import ShardProcessFailed
from .order import OnCalibration, OrderedShard, ShardEnd, ShardMessage, ShardOrder, ShardResult
from .policy import LoadPolicy, Preparation, load_in_sandbox, load_remote, run_shard

if TYPE_CHECKING:
    from vitac.envs.tactile.design import SensorDesign


OnEpisode = Callable[[EpisodeRecord], None]


def resimulate_log(
    part: OrderedShard, on_episode: OnEpisode, make_env: MakeEnvironment = make_environment
) -> ShardResult:
    """Re-simulate a shard of one of our logs, in the order of its episodes and until one diverges.

    Args:
        part: what is re-simulated.
        on_episode: gets each record of the re-simulation that holds.
        make_env: gives the environment.

    Raises:
        LogRejected: the log cannot be read.
    """
    env = make_env(part.task, None, ())
    manifest = make_manifest(part.track, part.task, env)
    finding = _explain_impossible(part, manifest) or _first_divergence(part, env, on_episode)
    return _make_log_result(part, manifest, finding)


def _make_log_result(part: OrderedShard, manifest: Manifest, finding: LogFinding | None) -> ShardResult:
    end = ShardEnd.REFUTED if finding else ShardEnd.COMPLETE
    return ShardResult(index=part.shard.index, end=end, manifest=manifest, isolation=None, finding=finding)


def _explain_impossible(part: OrderedShard, manifest: Manifest) -> LogFinding | None:
    """Return why the log cannot be true; at its upload it was not compared with the mesh and the solver of here."""
    with open_log(part.order.submission) as stream:
        reader = LogReader(stream)
        impossibility = explain_impossible(must_agree(manifest), part.task, reader.header, reader.records())
    return LogFinding.impossible(impossibility) if impossibility else None


def _first_divergence(part: OrderedShard, env: Environment, on_episode: OnEpisode) -> LogFinding | None:
    with open_log(part.order.submission) as stream:
        reader = LogReader(stream)
        for record in reader.records():
            if record.episode not in part.numbers:
                continue
            checked = check_episode(env, part.task, record)
            if checked.finding:
                return checked.finding
            on_episode(checked.record)
    return None


def resimulate_text_log(
    part: OrderedShard, on_episode: OnEpisode, make_env: MakeEnvironment = make_environment
) -> ShardResult:
    """Re-simulate a shard of a text log.

    Args:
        part: what is re-simulated.
        on_episode: gets each record of the re-simulation.
        make_env: gives the environment.

    Raises:
        TextLogRejected: the log cannot be read.
    """
    with open_log(part.order.submission) as stream:
        text_log = read_text_log(stream)
    env = make_env(part.task.apply_text_log_settings(), None, ())
    manifest = make_manifest(part.track, part.task, env)
    script = summarize(text_log)[0]
    impossible = explain_not_resimulated(text_log, script, part.task)
    if impossible:
        return _make_log_result(part, manifest, LogFinding.impossible(impossible))
    for recording in text_log_recordings(text_log, script, part.task):
        if recording.episode.number in part.numbers:
            on_episode(_record(part.task, recording, resimulate(env, recording.episode, recording.actions)))
    return _make_log_result(part, manifest, None)


def _record(task: Task, recording: Recording, played: Resimulated) -> EpisodeRecord:
    """Return the episode up to its end in our physics, or to that of the recorded actions if it has none there."""
    steps = len(recording.actions) if played.end_step is None else played.end_step
    return EpisodeRecord(
        episode=recording.episode.number,
        task=task.name,
        shape=recording.episode.shape,
        initial_offset=recording.episode.offset,
        outcome=played.outcome or EpisodeOutcome.ACTIONS_ENDED,
        env_steps=steps,
        total_reward=played.total_reward,
        actions=ActionSequence.from_array(recording.actions[:steps]),
        state_hashes=played.state_hashes[: steps + 1],
        infos=played.infos[:steps],
        picture=played.picture,
        forces=played.forces,
        timings=played.timings,
    )


class OtherEvaluator(VitacError):
    """The process of a shard has another evaluator than the evaluation began with; start its worker again."""


Runner = Callable[[OrderedShard, Preparation, OnEpisode], ShardResult]
"""Plays a shard of one kind of submission."""


def execute(order: ShardOrder, answer: IO[str], preparation: Preparation) -> None:
    """Run the shard and write one line for each episode and one for the end.

    Args:
        order: what to run.
        answer: gets the lines.
        preparation: environment and loaded policy of the orders before this one.
    """

    def send(message: ShardMessage) -> None:
        answer.write(message.model_dump_json(exclude_unset=True) + "\n")
        answer.flush()

    try:
        result = _make_result(order, preparation, send)
    except VitacError as error:
        preparation.forget()  # whoever reads the error kills this process, which could not clear up itself
        send(ShardMessage(error=f"{type(error).__name__}: {error}"))
    else:
        send(ShardMessage(result=result))


def _make_result(order: ShardOrder, preparation: Preparation, send: Callable[[ShardMessage], None]) -> ShardResult:
    if order.evaluator_version not in {None, find_version(order.track)}:
        raise OtherEvaluator(
            f"Expected evaluator {order.evaluator_version}, got {find_version(order.track)}: the installation was "
            "replaced under a running worker. Start the worker again."
        )
    track = load_played_track(order.track, read_secret(order.secret) if order.secret else None)
    task = track.tasks[order.task]
    shard = next(shard for shard in cut(task, order.episodes) if shard.index == order.shard)
    ordered = OrderedShard(order=order, track=track, task=task, shard=shard)

    def on_episode(record: EpisodeRecord) -> None:
        send(ShardMessage(record=record))

    if task.player is not Player.POLICY:
        return run_estimator(ordered, on_episode)
    runner = RUNNERS[order.kind]
    if runner is _run_policy and order.kind is SubmissionKind.MODEL and order.remote is None:
        send(ShardMessage(packages=policy_versions(order.submission, track.packages)))
    return runner(ordered, preparation, on_episode)


def _run_policy(ordered: OrderedShard, preparation: Preparation, on_episode: OnEpisode) -> ShardResult:
    order = ordered.order
    if order.remote is not None:
        load: LoadPolicy = partial(load_remote, address=order.remote)
    else:
        load = partial(
            load_in_sandbox,
            packages=ordered.track.packages,
            episode_period_s=order.episode_period_s,
            isolation=order.isolation,
            kind=order.kind,
        )
    if ordered.task.definition.batch_size > 1:
        return run_batches(ordered, on_episode, load)
    preparation.begin(order)
    return run_shard(
        submission_dir=order.submission,
        track=ordered.track,
        task=ordered.task,
        shard=ordered.shard,
        on_episode=on_episode,
        reading=make_reading(ordered.task, load_manifest(order.submission).read_keys),
        limits=order.limits,
        assets_dir=order.assets_dir,
        load_policy=partial(preparation.policy, load),
        make_env=partial(preparation.environment, partial(make_environment, sensor=_find_sensor(order))),
        skip=order.skip,
        failures=list(order.earlier_failures),
    )


def _find_sensor(order: ShardOrder) -> "SensorDesign | None":
    return read_design(order.sensor) if order.sensor else None


RUNNERS: Mapping[SubmissionKind, Runner] = MappingProxyType(
    {
        SubmissionKind.MODEL: _run_policy,
        SubmissionKind.IMAGE: _run_policy,
        SubmissionKind.LOG: lambda ordered, _, on_episode: resimulate_log(ordered, on_episode),
        SubmissionKind.REMOTE: _run_policy,
        SubmissionKind.TEXT_LOG: lambda ordered, _, on_episode: resimulate_text_log(ordered, on_episode),
    }
)


class ShardHere:
    """One shard; what is asked of it is what is asked of a `ShardProcess`."""

    result: ShardResult

    def __init__(self, order: ShardOrder, preparation: Preparation) -> None:
        self._order = order
        self._preparation = preparation

    def records(self, _: OnCalibration) -> Iterator[EpisodeRecord]:
        """Play all, then yield the records.

        Raises:
            ShardProcessFailed: the machine or the simulation broke.
        """
        answer = io.StringIO()
        execute(self._order, answer, self._preparation)
        for line in answer.getvalue().splitlines():
            message = ShardMessage.model_validate_json(line)
            if message.error is not None:
                raise ShardProcessFailed(message.error)
            if message.record is not None:
                yield message.record
            if message.result is not None:
                self.result = message.result

    def kill(self) -> None:
        """Let it end by itself: it is what this process does."""


class ShardsHere:
    """Stands in for `ShardProcesses`, with one shard at a time."""

    def __init__(self) -> None:
        self._exits = ExitStack()
        self._preparation = Preparation()

    def __enter__(self) -> Self:
        self._exits.enter_context(self._preparation)
        return self

    def __exit__(self, *exception: object) -> None:
        self._exits.close()

    @contextmanager
    def running_shard(self, order: ShardOrder) -> Iterator[ShardHere]:
        """Give a shard that is played when its records are read."""
        yield ShardHere(order, self._preparation)
