"""Re-simulates the episodes of a shard from an uploaded log, where `shards.run_shard` plays them with a policy.

Called by `shard_process`. No policy runs, so no sandbox is needed.
"""

from collections.abc import Callable, Collection
from pathlib import Path

from .episodes import Environment, make_environment
from .log_checks import must_agree, why_impossible
from .log_findings import LogFinding
from .logs import LogReader
from .packed_logs import open_log
from .records import EpisodeRecord, Manifest
from .shards import Shard, ShardEnd, ShardResult, make_manifest
from .tracks import Task, Track
from .verification import check_episode

MakeEnvironment = Callable[[Task, Path | None], Environment]


def resimulate_log(
    *,
    log: Path,
    track: Track,
    task: Task,
    shard: Shard,
    on_episode: Callable[[EpisodeRecord], None],
    skip: Collection[int] = (),
    make_env: MakeEnvironment = make_environment,
) -> ShardResult:
    """Re-simulates a shard of one of our logs, in the order of its episodes and until one diverges.

    Args:
        log: the file, packed or not.
        track: the track of the task.
        task: what was played.
        shard: which episodes.
        on_episode: gets each record that holds, as it came here.
        skip: episodes that have a record already.
        make_env: gives the environment.

    Raises:
        LogRejected: the log cannot be read.
    """
    env = make_env(task, None)
    manifest = make_manifest(track, task, env)
    finding = _why_impossible(log, manifest, task)
    if finding is None:
        finding = _first_divergence(log, env, manifest, task, shard.numbers - set(skip), on_episode)
    end = ShardEnd.REFUTED if finding else ShardEnd.COMPLETE
    return ShardResult(index=shard.index, end=end, manifest=manifest, isolation=None, finding=finding)


def _why_impossible(log: Path, manifest: Manifest, task: Task) -> LogFinding | None:
    """The upload was checked, but not against the mesh and the solver, which only an environment knows."""
    with open_log(log) as stream:
        reader = LogReader(stream)
        found = why_impossible(must_agree(manifest), task, reader.header, reader.records())
    return LogFinding.impossible(found) if found else None


def _first_divergence(
    log: Path,
    env: Environment,
    manifest: Manifest,
    task: Task,
    numbers: Collection[int],
    on_episode: Callable[[EpisodeRecord], None],
) -> LogFinding | None:
    with open_log(log) as stream:
        reader = LogReader(stream)
        ours = sorted((record for record in reader.records() if record.episode in numbers), key=_number)
        for record in ours:
            checked = check_episode(env, task, manifest, reader.header, record)
            if checked.divergence and not checked.holds:
                return LogFinding.diverged(checked.divergence)
            on_episode(checked.record)
    return None


def _number(record: EpisodeRecord) -> int:
    return record.episode
