"""Re-simulates the episodes of a shard from a 2025 text log; called by `execution`.

Nothing of it can be verified: the 2025 simulator does not reproduce itself. The result shows how our physics
plays the same actions.
"""

from collections.abc import Callable

from ..episodes.provenance import make_manifest
from ..episodes.records import ActionSequence, EpisodeOutcome, EpisodeRecord
from ..episodes.replay import Resimulated, resimulate
from ..logs.findings import LogFinding
from ..logs.packing import open_log
from ..logs.recordings import Recording
from ..logs.text_2025 import read_text_log, summarize
from ..logs.text_2025.recordings import explain_not_resimulated, text_log_recordings
from ..tracks import Task
from .log import LogShard
from .result import ShardResult


def resimulate_text_log(part: LogShard, on_episode: Callable[[EpisodeRecord], None]) -> ShardResult:
    """Re-simulate a shard of a text log.

    Args:
        part: what is re-simulated.
        on_episode: gets each record of the re-simulation.

    Raises:
        TextLogRejected: the log cannot be read.
    """
    with open_log(part.log) as stream:
        text_log = read_text_log(stream)
    env = part.make_env(part.task.apply_text_log_settings(), None, ())
    manifest = make_manifest(part.track, part.task, env)
    script = summarize(text_log)[0]
    impossible = explain_not_resimulated(text_log, script, part.task)
    if impossible:
        return part.result(manifest, LogFinding.impossible(impossible))
    for recording in text_log_recordings(text_log, script, part.task):
        if recording.episode.number in part.numbers:
            on_episode(_record(part.task, recording, resimulate(env, recording.episode, recording.actions)))
    return part.result(manifest, None)


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
