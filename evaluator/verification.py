"""Is a log true? Its actions are checked and re-simulated; called by `vitac log verify` and the server.

Re-simulation proves the actions, not that a policy chose them.
"""

from collections.abc import Callable, Collection
from enum import StrEnum

import numpy as np
from pydantic import JsonValue

from .episodes import Environment
from .logs import LogHeader
from .recordings import RecordingRejected, recording_of
from .records import EpisodeOutcome, EpisodeRecord, Manifest, Timings
from .replay import Resimulated, resimulate
from .scoring import Score, score
from .shards import make_manifest
from .strict_model import StrictModel
from .tracks import Task, Track


class LogVerdict(StrEnum):
    """What re-simulation says of a log."""

    VERIFIED = "verified"
    """Every state hash is equal."""
    WITHIN_TOLERANCE = "verified within tolerance"
    """Made on another class of machines; states differ in their last bits, all outcomes are equal."""
    DIVERGED = "diverged"
    """The actions do not lead where the log says."""
    IMPOSSIBLE = "impossible"
    """No evaluation of this list can have made it."""


class Divergence(StrictModel):
    """The first env step of the first episode whose state is not the recorded one; step 0 is after the reset."""

    episode: int
    env_step: int
    recorded_state: str | None
    recorded_info: dict[str, JsonValue] | None
    resimulated_state: str | None
    resimulated_info: dict[str, JsonValue] | None


class Verification(StrictModel):
    """The verdict on a log.

    Where it is verified, `records` are the log's with states, infos and rewards as they came here. They, not the log's
    own, are to be scored and shown.
    """

    verdict: LogVerdict
    reason: str
    manifest: Manifest
    """What re-simulated it."""
    divergence: Divergence | None = None
    records: tuple[EpisodeRecord, ...] = ()

    @property
    def score(self) -> Score | None:
        """The score that the actions earn; None unless the log is verified."""
        return score(self.records) if self.records else None


def verify(
    *,
    env: Environment,
    track: Track,
    task: Task,
    header: LogHeader,
    records: Collection[EpisodeRecord],
    episodes: Collection[int] | None = None,
    on_episode: Callable[[EpisodeRecord], None] = lambda _: None,
) -> Verification:
    """Checks and re-simulates a log, until it is clear that it diverges.

    Args:
        env: the task's environment.
        track: its track.
        task: what must have been played.
        header: of the log.
        records: of the log.
        episodes: numbers that must be there; the whole list by default.
        on_episode: gets each re-simulated record.
    """
    manifest = make_manifest(track, task, env)
    impossible = why_impossible(manifest, task, header, records, episodes)
    if impossible:
        return Verification(verdict=LogVerdict.IMPOSSIBLE, reason=impossible, manifest=manifest)
    same_machines = header.manifest.platform_class == manifest.platform_class
    played: list[EpisodeRecord] = []
    first: Divergence | None = None
    for record in records:
        recording = recording_of(record, task)
        result = resimulate(env, recording.episode, recording.actions)
        divergence = find_divergence(record, result)
        first = first or divergence
        if divergence and (same_machines or not _ended_as_recorded(record, result)):
            place = f"episode {divergence.episode} env step {divergence.env_step}"
            return Verification(
                verdict=LogVerdict.DIVERGED, reason=f"diverged at {place}", manifest=manifest, divergence=divergence
            )
        played.append(_with_our_states(record, result))
        on_episode(played[-1])
    return Verification(
        verdict=LogVerdict.WITHIN_TOLERANCE if first else LogVerdict.VERIFIED,
        reason=f"made on {header.manifest.platform_class}; all outcomes are equal" if first else "all states are equal",
        manifest=manifest,
        divergence=first,
        records=tuple(played),
    )


def why_impossible(
    manifest: Manifest,
    task: Task,
    header: LogHeader,
    records: Collection[EpisodeRecord],
    episodes: Collection[int] | None = None,
) -> str | None:
    """Why no evaluation with this manifest can have made the log, in one sentence; None if one can."""
    for key in ("track", "task", "list_seed", "task_hash", "evaluator_version", "solver_version", "mesh_hash"):
        came, expected = getattr(header.manifest, key), getattr(manifest, key)
        if came != expected:
            return f"The log was made with {key} {came!r}, here it is {expected!r}; evaluate again."
    wanted = {episode.number for episode in task.episodes} if episodes is None else set(episodes)
    missing = sorted(wanted - {record.episode for record in records})
    if missing:
        return (
            f"Episode {missing[0]} is missing, {len(missing)} of {len(wanted)} in all; a log must hold the whole list."
        )
    problems = (_why_record_impossible(task, record) for record in records)
    return next((problem for problem in problems if problem), None)


def find_divergence(record: EpisodeRecord, played: Resimulated) -> Divergence | None:
    """The first state that is not the recorded one, or the first sign that the episode ended otherwise."""
    pairs = zip(record.state_hashes, played.state_hashes, strict=True)
    step = next((step for step, (recorded, ours) in enumerate(pairs) if recorded != ours), None)
    if step is None and _ended_as_recorded(record, played):
        return None
    step = record.env_steps if step is None else step
    return Divergence(
        episode=record.episode,
        env_step=step,
        recorded_state=record.state_hashes[step],
        recorded_info=record.infos[step - 1] if step else None,
        resimulated_state=played.state_hashes[step],
        resimulated_info=played.infos[step - 1] if step else None,
    )


def _why_record_impossible(task: Task, record: EpisodeRecord) -> str | None:
    place = f"Episode {record.episode}"
    try:
        actions = recording_of(record, task).actions
    except RecordingRejected as error:
        return str(error)
    if record.episode > len(task.episodes):
        return f"{place} is not in the list, which ends with {len(task.episodes)}."
    listed = task.episodes[record.episode - 1]
    if (record.shape, record.initial_offset) != (listed.shape, listed.offset):
        came, expected = f"{record.shape} at {record.initial_offset}", f"{listed.shape} at {listed.offset}"
        return f"{place} starts with {came}, in the list with {expected}."
    if record.env_steps > task.max_steps:
        return f"{place} has {record.env_steps} env steps; the task ends after {task.max_steps}."
    outside = np.argwhere(np.abs(actions) > 1)
    if len(outside):
        step, component = outside[0]
        came = f"{task.actions[component].name} = {actions[step, component]:g}"
        return f"{place} has the action {came} at env step {step + 1}; actions lie within -1 and 1."
    return None


def _ended_as_recorded(record: EpisodeRecord, played: Resimulated) -> bool:
    if record.outcome is EpisodeOutcome.POLICY_FAILED:
        return played.outcome is None
    return (record.outcome, record.env_steps) == (played.outcome, played.end_step)


def _with_our_states(record: EpisodeRecord, played: Resimulated) -> EpisodeRecord:
    return record.model_copy(
        update={
            "state_hashes": played.state_hashes,
            "infos": played.infos,
            "total_reward": played.total_reward,
            "timings": Timings(),
        }
    )
