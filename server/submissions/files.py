"""Stored files of submissions besides their uploads: added with a submission, found, spared by housekeeping."""

from collections.abc import Iterable
from dataclasses import asdict
from functools import cache
from typing import Any
from uuid import UUID

from sqlalchemy import Connection, Row, Select, delete, func, or_, select, union
from sqlalchemy.dialects.postgresql import insert
from sqlalchemy.orm import Session
from vitac.evaluator.episodes.records import EpisodeOutcome, PolicyFailure

from ..competitions.competition import Competition
from ..database.models import EpisodeResult, Evaluation, Submission, SubmissionFile, Team
from ..database.states import FileRole
from ..database.stored_uploads import HAS_NO_UPLOAD
from ..errors import ProblemCode, ServiceError
from ..evaluations.episode_store import EpisodeKey
from ..evaluations.history import newest_evaluation
from ..principals import Principal
from ..receipts import issuing
from ..receipts.receipt import Receipt, SubmissionReceipt
from ..receipts.witnesses import list_witness_views
from ..transparency.log import read_log_state
from ..views.receipts import PublicLogEntryView, PublicLogView
from ..views.submissions import EpisodeOutputView, OutputView
from ..visibility import decide_sight, visible
from .intake import UploadedFile


def add_files(session: Session, submission_id: UUID, files: Iterable[UploadedFile]) -> None:
    """Add the files of a submission; those that it has already stay, but for its sensor, of which it has one.

    Another mesher makes another sensor of the same archive: from then on that is the one that is played. New facts of a
    file are added to those that it has: two evaluations may learn the same of a sensor.
    """
    for file in files:
        if file.role is FileRole.SENSOR:
            is_sensor = (SubmissionFile.submission_id == submission_id, SubmissionFile.role == FileRole.SENSOR)
            session.execute(delete(SubmissionFile).where(*is_sensor, SubmissionFile.sha256 != file.sha256))
        added = insert(SubmissionFile).values(
            submission_id=submission_id,
            role=file.role,
            sha256=file.sha256,
            n_bytes=file.n_bytes,
            name=file.name,
            facts=file.facts,
        )
        session.execute(
            added.on_conflict_do_update(
                index_elements=["submission_id", "role", "sha256"],
                set_={"facts": SubmissionFile.facts.concat(added.excluded.facts)},
            )
        )


def find_file(session: Session, submission_id: UUID, role: FileRole) -> SubmissionFile | None:
    """Return a submission's file of a role, the last by digest where there are several; None without one."""
    return session.scalars(
        select(SubmissionFile)
        .where(SubmissionFile.submission_id == submission_id, SubmissionFile.role == role)
        .order_by(SubmissionFile.sha256.desc())
        .limit(1)
    ).first()


def stored_digests(connection: Connection | Session) -> list[str]:
    """Return the digests of all stored files that a submission has, sorted, each once.

    Not those of removed teams, and not those whose evaluations were all cancelled a day ago.
    """
    is_kept = Team.erased_at.is_(None) & ~HAS_NO_UPLOAD
    uploads = select(Submission.archive_sha256).join(Submission.team).where(is_kept)
    others = (
        select(SubmissionFile.sha256)
        .join(Submission, Submission.id == SubmissionFile.submission_id)
        .join(Submission.team)
        .where(is_kept)
    )
    digests = union(uploads, others).subquery()
    return sorted(connection.scalars(select(digests.c[0])))


PAGE_EPISODES = 20
_HAS_SOMETHING = or_(
    func.octet_length(EpisodeResult.output) > 0, EpisodeResult.outcome == EpisodeOutcome.POLICY_FAILED.value
)


def episode_outputs(
    session: Session,
    by: Principal,
    submission_id: UUID,
    task: str | None = None,
    *,
    after: int = 0,
    limit: int = PAGE_EPISODES,
) -> OutputView:
    """Return what the policy printed in the episodes of the newest evaluation and why it failed, a page of them.

    Args:
        session: of the transaction.
        by: who asks.
        submission_id: of the submission.
        task: one of its tasks; by default the first.
        after: number of the last episode of the page before.
        limit: most episodes of a page.

    Raises:
        ServiceError: there is no such submission, its output is not shown, or it does not play that task.
    """
    submission = visible(session, by, submission_id)
    evaluation = newest_evaluation(session, submission)
    if not decide_sight(by, evaluation).output:
        raise ServiceError(
            ProblemCode.FORBIDDEN,
            "The output of a log, or on a sealed list before it is published, is not shown: ask the organizers if you "
            "need it.",
        )
    task = submission.tasks[0] if task is None else task
    if task not in submission.tasks:
        raise ServiceError(
            ProblemCode.UNKNOWN_TASK, f"Expected one of the tasks {', '.join(submission.tasks)}, got {task!r:.80}."
        )
    rows = session.execute(
        select(
            EpisodeResult.task,
            EpisodeResult.episode,
            EpisodeResult.outcome,
            EpisodeResult.output,
            EpisodeResult.record["failure"].label("failure"),
        )
        .where(*_key(evaluation), EpisodeResult.task == task, EpisodeResult.episode > after, _HAS_SOMETHING)
        .order_by(EpisodeResult.episode)
        .limit(limit + 1)
    ).all()
    return OutputView(
        items=[_view(row) for row in rows[:limit]],
        next_after=rows[limit - 1].episode if len(rows) > limit else None,
    )


def episodes_with_output(session: Session, by: Principal, evaluation: Evaluation) -> int:
    """Return in how many episodes of an evaluation the policy printed something or failed; 0 where it is not shown."""
    if not decide_sight(by, evaluation).output:
        return 0
    return session.scalar(_count_query(), EpisodeKey.from_evaluation(evaluation, evaluation.submission).given()) or 0


@cache
def _count_query() -> Select[int]:
    """Return the query of their number, put together once: each page of a submission asks it."""
    return select(func.count()).select_from(EpisodeResult).where(*EpisodeKey.conditions_given(), _HAS_SOMETHING)


def _view(row: Row[Any]) -> EpisodeOutputView:
    failure = None if row.failure is None else PolicyFailure.model_validate(row.failure)
    return EpisodeOutputView.from_row(row, failure=None if failure is None else f"{failure.code}: {failure.sentence}")


def _key(evaluation: Evaluation) -> tuple[Any, ...]:
    return EpisodeKey.from_evaluation(evaluation, evaluation.submission).conditions()


def receipts(session: Session, by: Principal, submission_id: UUID) -> list[Receipt]:
    """Return the receipts of a submission's results, the first one first; they hold nothing of single episodes.

    Raises:
        ServiceError: there is no such submission.
    """
    return list(issuing.receipts_of_submission(session, visible(session, by, submission_id).id))


def receipt_of_arrival(session: Session, by: Principal, submission_id: UUID) -> SubmissionReceipt:
    """Return the receipt that a submission got when it arrived.

    Raises:
        ServiceError: there is no such submission, or it got none.
    """
    receipt = issuing.receipt_of_arrival(session, visible(session, by, submission_id).id)
    if receipt is None:
        raise ServiceError(ProblemCode.NOT_FOUND, f"Submission {submission_id} has no receipt of its arrival.")
    return receipt


def newest_receipt(session: Session, by: Principal, submission_id: UUID) -> Receipt:
    """Return the receipt of a submission's newest result.

    Raises:
        ServiceError: there is no such submission, or it has no result.
    """
    listed = receipts(session, by, submission_id)
    if not listed:
        raise ServiceError(ProblemCode.NOT_FOUND, f"Submission {submission_id} has no final result, so no receipt.")
    return listed[-1]


def log_view(session: Session, *, after: int, limit: int, competition: str | None = None) -> PublicLogView:
    """Return a page of the log, which anybody may read: its entries show no result.

    Args:
        session: of the transaction.
        after: number of the last entry of the page before.
        limit: maximum number of entries.
        competition: name of the competition whose entries are listed; None: all entries.

    Raises:
        ServiceError: there is no such competition.
    """
    name = None if competition is None else Competition.find(session, competition).name
    entries = issuing.list_entries(session, after=after, limit=limit + 1, competition=name)
    items = [PublicLogEntryView(**entry.model_dump(), leaf_hash=entry.leaf_hash.hex()) for entry in entries[:limit]]
    is_end = not items or len(entries) <= limit
    return PublicLogView(
        **asdict(read_log_state(session)),
        witnesses=list_witness_views(session),
        items=items,
        next_after=None if is_end else items[-1].number,
    )
