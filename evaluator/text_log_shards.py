"""Re-simulates the episodes of a shard from a 2025 text log; called by `shard_process`.

Nothing of it can be verified: the 2025 simulator does not reproduce itself. What comes out is what our physics makes of
the same actions.
"""

from collections.abc import Callable, Collection
from pathlib import Path

from .episodes import make_environment
from .log_findings import LogFinding
from .log_shards import MakeEnvironment
from .packed_logs import open_log
from .recordings import Recording
from .records import ActionSequence, EpisodeOutcome, EpisodeRecord
from .replay import Resimulated, resimulate
from .shards import Shard, ShardEnd, ShardResult, make_manifest
from .text_log_recordings import text_log_recordings, why_not_resimulated
from .text_logs import read_text_log, summarize
from .tracks import Task, Track


def resimulate_text_log(
    *,
    log: Path,
    track: Track,
    task: Task,
    shard: Shard,
    on_episode: Callable[[EpisodeRecord], None],
    skip: Collection[int] = (),
    make_env: MakeEnvironment = make_environment,
) -> ShardResult:
    """Re-simulates a shard of a text log.

    Args:
        log: the file, packed or not.
        track: the track of the task.
        task: ours that belongs to the log.
        shard: which episodes.
        on_episode: gets each record as it came here.
        skip: episodes that have a record already.
        make_env: gives the environment.

    Raises:
        TextLogRejected: the log cannot be read.
    """
    with open_log(log) as stream:
        text_log = read_text_log(stream)
    env = make_env(task, None)
    manifest = make_manifest(track, task, env)
    impossible = why_not_resimulated(text_log, summarize(text_log)[0], task)
    if impossible:
        finding = LogFinding.impossible(impossible)
        return ShardResult(index=shard.index, end=ShardEnd.REFUTED, manifest=manifest, isolation=None, finding=finding)
    for recording in text_log_recordings(text_log, task):
        if recording.episode.number in shard.numbers - set(skip):
            on_episode(_record(task, recording, resimulate(env, recording.episode, recording.actions)))
    return ShardResult(index=shard.index, end=ShardEnd.COMPLETE, manifest=manifest, isolation=None)


def _record(task: Task, recording: Recording, played: Resimulated) -> EpisodeRecord:
    """The episode up to its end in our physics, or to that of the recorded actions if it has none there."""
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
        timings=played.timings,
    )
