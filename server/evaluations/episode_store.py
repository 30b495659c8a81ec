"""Stored episodes: one row for each key and episode, written by whoever holds the shard, never written twice."""

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Self

from sqlalchemy import bindparam, func, select
from sqlalchemy.dialects.postgresql import insert
from sqlalchemy.orm import Session
from vitac.envs.tasks.definition import Family
from vitac.evaluator.episodes.records import EpisodeRecord, PolicyFailure, digest_of_stored
from vitac.evaluator.tracks import ListKind

from ..competitions.competition import find_stage
from ..database.clock import read_clock
from ..database.models import EpisodeResult, Evaluation, Submission
from ..errors import ProblemCode, ServiceError
from ..principals import Principal
from ..queue.leases import Lease
from ..queue.work import lock_held, note_progress
from ..tracks import known_track
from ..visibility import decide_sight
from .history import report_difference
from .provenance import note_packages

OUTPUT_CHARACTERS = 4096
"""Length of the end of a policy's output in one episode that is stored for its team."""


@dataclass(frozen=True, kw_only=True)
class EpisodeKey:
    """What episode rows of one evaluation have in common; an episode is computed once for each such key.

    Attributes:
        commitment: of the sealed list that is played; empty for the public one.
    """

    submission_digest: str
    evaluator_version: str
    track: str
    run: int
    commitment: str

    @classmethod
    def from_evaluation(cls, evaluation: Evaluation, submission: Submission) -> Self:
        """Return the key of the episodes of an evaluation that its result is made of."""
        return cls(
            submission_digest=submission.digest,
            evaluator_version=evaluation.evaluator_version,
            track=submission.track,
            run=evaluation.run,
            commitment=evaluation.commitment or "",
        )

    def select_public_list(self) -> Self:
        """Return the key of the episodes that are played on the public list beside a sealed one."""
        return replace(self, commitment="")

    @classmethod
    def from_lease(cls, lease: Lease) -> Self:
        """Return the key of the episodes that are played under a lease."""
        return cls(
            submission_digest=lease.submission_digest,
            evaluator_version=lease.evaluator_version,
            track=lease.track,
            run=lease.run,
            commitment=lease.commitment or "",
        )

    def conditions(self, result: type[EpisodeResult] = EpisodeResult) -> tuple[Any, ...]:
        """Return the key as conditions on `EpisodeResult` or an alias of it."""
        return (
            result.submission_digest == self.submission_digest,
            result.evaluator_version == self.evaluator_version,
            result.track == self.track,
            result.run == self.run,
            result.commitment == self.commitment,
        )

    def given(self) -> dict[str, Any]:
        """Return the parameters for `conditions_given`."""
        return asdict(self)

    @classmethod
    def conditions_given(cls, result: type[EpisodeResult] = EpisodeResult) -> tuple[Any, ...]:
        """Return the conditions of some key, for a statement that is put together once."""
        return tuple(getattr(result, part.name) == bindparam(part.name) for part in fields(cls))


def played_keys(evaluation: Evaluation, submission: Submission) -> tuple[EpisodeKey, ...]:
    """Return the keys of the episodes on each list that an evaluation plays; first that of its result.

    Beside the sealed list of a stage, the public one is played for comparison, but not beside its final list, nor on
    stations. Beside one that decides at once, a fresh list is, too.
    """
    key = EpisodeKey.from_evaluation(evaluation, submission)
    track = known_track(submission.track)
    is_public = track is not None and all(
        task.episode_list.kind is ListKind.PUBLIC and task.family is not Family.STATION for task in track.tasks.values()
    )
    plays_both = key.commitment and is_public and submission.final_of is None
    practice = (key.select_public_list(),) if plays_both else ()
    fresh = (replace(key, commitment=evaluation.fresh_commitment),) if evaluation.fresh_commitment else ()
    return key, *fresh, *practice


def find_shown_key(
    session: Session, by: Principal, evaluation: Evaluation, *, practice: bool = False
) -> EpisodeKey | None:
    """Return the key of the episodes that somebody may see singly; None where there are none for them.

    While a stage is open that ranks on a public list, a team sees only its own there.

    Args:
        session: of the transaction.
        by: who asks.
        evaluation: whose episodes.
        practice: those on the public list that was played beside a sealed one, instead of those of the result.
    """
    sight, keys = decide_sight(by, evaluation), played_keys(evaluation, evaluation.submission)
    if practice:
        return keys[-1] if sight.practice and len(keys) > 1 and not keys[-1].commitment else None
    return keys[0] if sight.episodes and not _is_closed_to(session, by, evaluation.submission) else None


def _is_closed_to(session: Session, by: Principal, submission: Submission) -> bool:
    if by.may_see(submission.team_id, submission.competition) or by.organizes(submission.competition):
        return False
    stage = find_stage(session, submission)
    return stage.ranks_on_public_list and not stage.is_over(read_clock(session))


_TABLE = EpisodeResult.metadata.tables[EpisodeResult.__tablename__]
_ADD_NEW = insert(_TABLE).on_conflict_do_nothing(constraint="uq_episode_results_key").returning(_TABLE.c.episode)
"""Built once, and given the rows as parameters: building it with them in it would take longer than running it."""


@dataclass(frozen=True, kw_only=True)
class StoredEpisodes:
    """What is known of a shard before it runs."""

    numbers: frozenset[int]
    failures: tuple[PolicyFailure, ...]


def store_episodes(
    session: Session, lease: Lease, records: Iterable[EpisodeRecord], *, packages: Mapping[str, str] | None = None
) -> None:
    """Store finished episodes, and which packages their policy saw; storing one again writes nothing.

    Args:
        session: of the transaction.
        lease: on their shard.
        records: of the episodes.
        packages: that the policy saw, versions by name; None where no policy ran, or where they were stored before
            under this lease.

    Raises:
        LeaseLost: the shard is no longer ours.
    """
    # In one order for all: another evaluation of the same content may store the same rows at the same time.
    by_number = {record.episode: record for record in sorted(records, key=lambda record: record.episode, reverse=True)}
    if packages is not None:
        note_packages(session, lease, packages)  # It may lock the evaluation, which comes before its shards.
    lock_held(session, lease)
    for record in by_number.values():
        _require_code(lease, record)
    rows = {number: row_values(lease, record) for number, record in by_number.items()}
    added = session.scalars(_ADD_NEW, list(rows.values())).all()
    for number in rows.keys() - set(added):
        _compare_with_stored(session, lease, by_number[number], rows[number]["record_digest"])
    if added:
        note_progress(session, lease)


def row_values(lease: Lease, record: EpisodeRecord) -> dict[str, Any]:
    """Return the columns of the row of an episode that was played under a lease."""
    record = storable(record)
    key = EpisodeKey.from_lease(lease)
    stored = record.model_dump(mode="json", exclude={"output"})
    return {
        "submission_digest": key.submission_digest,
        "evaluator_version": key.evaluator_version,
        "track": key.track,
        "task": record.task,
        "episode": record.episode,
        "run": key.run,
        "commitment": key.commitment,
        "shape": record.shape,
        "initial_offset": record.initial_offset,
        "outcome": record.outcome.value,
        "success": record.success,
        "env_steps": record.env_steps,
        "record": stored,
        "forces": stored.get("forces"),
        "record_digest": digest_of_stored(stored),
        "states_digest": states_digest(record),
        "half_way_state": half_way_state(record),
        "wall_s": record.timings.wall_s,
        "output": record.output[-OUTPUT_CHARACTERS:],
        "evaluation_id": lease.evaluation_id,
    }


def states_digest(record: EpisodeRecord) -> str:
    """Return the SHA-256 [hex] over all states of an episode, by which those of different submissions are compared."""
    return hashlib.sha256("\n".join(record.state_hashes).encode()).hexdigest()


def half_way_state(record: EpisodeRecord) -> str:
    """Return the hash of the state after half of the env steps, rounded up: changes of later actions leave it equal."""
    return record.state_hashes[len(record.state_hashes) // 2]


def storable(record: EpisodeRecord) -> EpisodeRecord:
    """Return the record without characters that the database cannot hold; a policy may print whatever it likes."""
    failure = record.failure and record.failure.model_copy(
        update={name: _remove_nul(getattr(record.failure, name)) for name in ("message", "output_tail")}
    )
    return record.model_copy(update={"failure": failure, "output": _remove_nul(record.output)})


def stored_episodes(session: Session, lease: Lease) -> StoredEpisodes:
    """Return which episodes of the shard need not be played, and how the policy failed in them."""
    rows = session.scalars(
        select(EpisodeResult).where(
            *EpisodeKey.from_lease(lease).conditions(),
            EpisodeResult.task == lease.task,
            EpisodeResult.episode.in_(lease.episodes),
        )
    ).all()
    records = [EpisodeRecord.model_validate(row.record) for row in sorted(rows, key=lambda row: row.episode)]
    return StoredEpisodes(
        numbers=frozenset(record.episode for record in records),
        failures=tuple(record.failure for record in records if record.failure is not None),
    )


def missing_episodes(session: Session, lease: Lease) -> list[int]:
    """Return which episodes of the shard are not stored."""
    stored = session.scalars(
        select(EpisodeResult.episode).where(
            *EpisodeKey.from_lease(lease).conditions(),
            EpisodeResult.task == lease.task,
            EpisodeResult.episode.in_(lease.episodes),
        )
    )
    return sorted(set(lease.episodes).difference(stored))


def read_stored_records(session: Session, key: EpisodeKey, task: str) -> list[EpisodeRecord]:
    """Return all stored records of one task, by episode."""
    rows = session.scalars(
        select(EpisodeResult.record)
        .where(*key.conditions(), EpisodeResult.task == task)
        .order_by(EpisodeResult.episode)
    )
    return [EpisodeRecord.model_validate(row) for row in rows]


def read_played_records(session: Session, evaluation: Evaluation) -> dict[str, dict[str, list[EpisodeRecord]]]:
    """Return all stored records of an evaluation, by commitment of the list and task; the public list has none."""
    submission = evaluation.submission
    return {
        key.commitment: {task: read_stored_records(session, key, task) for task in submission.tasks}
        for key in played_keys(evaluation, submission)
    }


def count_stored(session: Session, key: EpisodeKey) -> int:
    """Return how many episodes of an evaluation are stored."""
    return session.scalar(select(func.count()).select_from(EpisodeResult).where(*key.conditions())) or 0


def _remove_nul(text: str) -> str:
    return text.replace("\0", "\N{REPLACEMENT CHARACTER}").encode("utf-8", "replace").decode("utf-8")


def _require_code(lease: Lease, record: EpisodeRecord) -> None:
    """Refuse the record of a trial whose video began with another code: it is of another attempt."""
    code = record.video.code if record.video else None
    if lease.code != code:
        raise ServiceError(
            ProblemCode.INVALID_REQUEST,
            f"Trial {record.episode} was to show the code {lease.code}, its record names {code}: it is "
            "of another trial, so it is not stored and the trial is played again.",
        )


def _compare_with_stored(session: Session, lease: Lease, record: EpisodeRecord, digest: str) -> None:
    stored = session.scalar(
        select(EpisodeResult.record_digest).where(
            *EpisodeKey.from_lease(lease).conditions(),
            EpisodeResult.task == record.task,
            EpisodeResult.episode == record.episode,
        )
    )
    if stored is not None and stored != digest:
        report_difference(session, lease, episode=record.episode, stored=stored, differing=digest)
