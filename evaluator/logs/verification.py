"""Verifies a log: checks and re-simulates its actions; called by `vitac log verify` and the service's workers.

Re-simulation proves the actions, not that a policy chose them.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass

from ..episodes.episode import Environment, Resimulated, resimulate
from ..episodes.records import EpisodeOutcome, EpisodeRecord, Manifest, make_manifest
from ..scoring.score import Score, score
from ..strict_model import StrictModel
from ..tracks import Task, Track, load_track
from .checks import explain_impossible, must_agree
from .findings import WHY_TOLERATED, Divergence, LogFinding, OtherPicture, VerificationResult, comparable
from .log import LogHeader
from .recordings import make_recording


class Verification(StrictModel):
    """The result of verifying a log.

    For a verified log, `records` are the log's records with the re-simulated states, infos and rewards. Score and show
    these, not the log's own.
    """

    verdict: VerificationResult
    reason: str
    manifest: Manifest
    """Provenance of the re-simulation."""
    divergence: Divergence | None = None
    records: tuple[EpisodeRecord, ...] = ()

    @property
    def score(self) -> Score | None:
        """The score that the actions earn; None unless the log is verified."""
        if not self.records:
            return None
        return score(self.records, load_track(self.manifest.track).task(self.manifest.task).definition.measures)


@dataclass(frozen=True, kw_only=True)
class CheckedEpisode:
    """A record of a log after its re-simulation.

    Attributes:
        record: the log's record with the re-simulated states, infos and rewards.
        divergence: the first state that differs; where states may differ, the different end of the episode if there
            is one; None if all states are equal.
        finding: why the episode is not accepted. It is, if all states and the sampled pictures are equal, or if it ends
            alike where states may differ: it is of another platform class, or of a task that does not repeat.
    """

    record: EpisodeRecord
    divergence: Divergence | None
    finding: LogFinding | None


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
    """Check and re-simulate a log; stop at the first divergence.

    Args:
        env: the task's environment.
        track: the task's track.
        task: task that the log must be of.
        header: header of the log.
        records: episodes of the log.
        episodes: numbers of the required episodes; the whole list by default.
        on_episode: called with each re-simulated record.
    """
    manifest = make_manifest(track, task, env)
    impossible = explain_impossible(must_agree(manifest), task, header, records, episodes)
    if impossible:
        return _refuse(manifest, LogFinding.impossible(impossible))
    played: list[EpisodeRecord] = []
    first: Divergence | None = None
    for record in records:
        checked = check_episode(env, task, record)
        first = first or checked.divergence
        if checked.finding:
            return _refuse(manifest, checked.finding)
        played.append(checked.record)
        on_episode(played[-1])
    return Verification(
        verdict=VerificationResult.WITHIN_TOLERANCE if first else VerificationResult.VERIFIED,
        reason=WHY_TOLERATED if first else "all states are equal",
        manifest=manifest,
        divergence=first,
        records=tuple(played),
    )


def check_episode(env: Environment, task: Task, record: EpisodeRecord) -> CheckedEpisode:
    """Re-simulate one record of a log.

    Args:
        env: the task's environment.
        task: task of the log.
        record: a record that `explain_impossible_record` accepts.
    """
    recording = make_recording(record, task)
    played = resimulate(env, recording.episode, recording.actions)
    divergence = find_divergence(record, played)
    tolerant = not task.definition.repeats
    ended_as_recorded = _ended_as_recorded(record, played)
    if tolerant and not ended_as_recorded:
        divergence = _make_divergence(min(record.env_steps, played.end_step or record.env_steps), record, played)
    return CheckedEpisode(
        record=_replace_states(record, played),
        divergence=divergence,
        finding=None if divergence and tolerant and ended_as_recorded else _finding(divergence, record, played),
    )


def _finding(divergence: Divergence | None, record: EpisodeRecord, played: Resimulated) -> LogFinding | None:
    if divergence:
        return LogFinding.diverged(divergence)
    if record.picture != played.picture:
        other = OtherPicture(episode=record.episode, recorded=record.picture, resimulated=played.picture)
        return LogFinding.from_picture(other)
    return None


def find_divergence(record: EpisodeRecord, played: Resimulated) -> Divergence | None:
    """Return the first state that differs from the recorded one, or the different end of the episode; None if equal."""
    pairs = zip(record.state_hashes, played.state_hashes, strict=True)
    step = next((step for step, (recorded, ours) in enumerate(pairs) if recorded != ours), None)
    if step is None and _ended_as_recorded(record, played):
        return None
    return _make_divergence(record.env_steps if step is None else step, record, played)


def _make_divergence(step: int, record: EpisodeRecord, played: Resimulated) -> Divergence:
    recorded, ours = (record.infos[step - 1], played.infos[step - 1]) if step else (None, None)
    return Divergence(
        episode=record.episode,
        env_step=step,
        recorded_state=record.state_hashes[step],
        recorded_info=recorded and ours and {key: comparable(recorded.get(key), ours[key]) for key in ours},
        resimulated_state=played.state_hashes[step],
        resimulated_info=ours,
    )


def _refuse(manifest: Manifest, finding: LogFinding) -> Verification:
    return Verification(
        verdict=finding.verdict, reason=finding.reason, manifest=manifest, divergence=finding.divergence
    )


def _ended_as_recorded(record: EpisodeRecord, played: Resimulated) -> bool:
    if record.outcome is EpisodeOutcome.POLICY_FAILED:
        return played.outcome is None
    return (record.outcome, record.env_steps) == (played.outcome, played.end_step)


def _replace_states(record: EpisodeRecord, played: Resimulated) -> EpisodeRecord:
    """Return the record with re-simulated values; the log's own claims, except actions and end, are dropped."""
    failure = record.failure and record.failure.model_copy(
        update={"message": "Claimed by the log; the policy was not seen.", "output_tail": ""}
    )
    return record.model_copy(
        update={
            "state_hashes": played.state_hashes,
            "infos": played.infos,
            "total_reward": played.total_reward,
            "picture": played.picture,
            "forces": played.forces,
            "failure": failure,
            "timings": played.timings,
            "output": "",
        }
    )
