"""Takes submissions off all boards: withdrawn by their team, disqualified by an organizer, or uncleared copies."""

from uuid import UUID

from sqlalchemy import ColumnElement, delete, exists, select, update
from sqlalchemy.orm import Session, aliased
from vitac.evaluator.episodes.records import EpisodeRecord

from .. import names
from ..accounts.teams import REASON_LENGTH
from ..audit import record
from ..competitions.competition import Competition
from ..database.clock import read_clock
from ..database.models import BoardResult, EpisodeResult, Evaluation, Submission, SubmissionFile
from ..database.states import ACTIVE_EVALUATION_STATES
from ..errors import ProblemCode, ServiceError
from ..evaluations.copies import list_completed, mark_copy
from ..evaluations.history import newest_evaluation
from ..evaluations.lifecycle import cancel
from ..principals import Principal
from ..visibility import changeable, visible

REMOVED = "(removed by its team)"


def withdraw(session: Session, by: Principal, submission_id: UUID) -> None:
    """Take a submission off all boards and cancel what waits or runs of it; doing it again changes nothing.

    Raises:
        ServiceError: there is no such submission of the team, or its competition is final.
    """
    submission = _lock(session, by, submission_id)
    if submission.withdrawn_at is None:
        _withdraw(session, by, submission)


def restore(session: Session, by: Principal, submission_id: UUID) -> None:
    """Put a withdrawn submission back on the boards; doing it again changes nothing.

    Raises:
        ServiceError: there is no such submission of the team, it is deleted, or its competition is final.
    """
    submission = _lock(session, by, submission_id)
    if submission.erased_at is not None:
        raise ServiceError(
            ProblemCode.INVALID_REQUEST, f"Submission {submission.id} is deleted; upload the same content again."
        )
    take_back(session, by, submission)


def take_back(session: Session, by: Principal, submission: Submission) -> None:
    """Let the results of a submission count again that its team had withdrawn; of any other nothing changes."""
    if submission.withdrawn_at is not None:
        before = {"withdrawn": True, "deleted": submission.erased_at is not None}
        submission.withdrawn_at = submission.erased_at = None
        mark_results(session, submission)
        record(session, by, "submission.restore", f"submission:{submission.id}", {"withdrawn": False}, before=before)


def erase(session: Session, by: Principal, submission_id: UUID) -> None:
    """Withdraw a submission and remove its upload, its description and what its policy printed permanently.

    Its name, scores and records stay, so that quotas and receipts can be checked; the files go with the next
    housekeeping. Doing it again changes nothing.

    Raises:
        ServiceError: there is no such submission of the team, or its competition is final.
    """
    submission = _lock(session, by, submission_id)
    if submission.erased_at is not None:
        return
    if submission.withdrawn_at is None:
        _withdraw(session, by, submission)
    submission.erased_at, submission.description = read_clock(session), None
    session.execute(delete(SubmissionFile).where(SubmissionFile.submission_id == submission.id))
    erase_output(session, Submission.id == submission.id)
    record(
        session, by, "submission.delete", f"submission:{submission.id}", {"deleted": True}, before={"deleted": False}
    )


def mark_results(session: Session, submission: Submission) -> None:
    """Write whether a submission is on boards to its results."""
    of_submission = BoardResult.submission_id == submission.id
    session.execute(update(BoardResult).where(of_submission).values(is_off_boards=submission.is_off_boards))


def _withdraw(session: Session, by: Principal, submission: Submission) -> None:
    submission.withdrawn_at = read_clock(session)
    newest = newest_evaluation(session, submission)
    if newest.state in ACTIVE_EVALUATION_STATES:
        cancel(session, newest)
    mark_results(session, submission)
    record(
        session,
        by,
        "submission.withdraw",
        f"submission:{submission.id}",
        {"withdrawn": True},
        before={"withdrawn": False},
    )


def erase_output(session: Session, chosen: ColumnElement[bool]) -> None:
    """Remove what the policies of some submissions printed; where another one has the same content, it stays theirs.

    A record that the result hash of a scored evaluation covers stays whole, or nobody could check that score again.

    Args:
        session: of the transaction.
        chosen: condition on submissions.
    """
    ids = select(Submission.id).where(chosen)
    theirs, ours = aliased(Submission), aliased(Submission)
    mine = exists().where(ours.id.in_(ids), ours.digest == EpisodeResult.submission_digest)
    is_shared = exists().where(
        theirs.id.not_in(ids), theirs.erased_at.is_(None), theirs.digest == EpisodeResult.submission_digest
    )
    session.execute(
        update(EpisodeResult).where(mine, ~is_shared).values(output="").execution_options(synchronize_session=False)
    )
    scored = exists().where(
        ours.digest == EpisodeResult.submission_digest,
        Evaluation.submission_id == ours.id,
        Evaluation.run == EpisodeResult.run,
        Evaluation.evaluator_version == EpisodeResult.evaluator_version,
        Evaluation.result_hash.is_not(None),
    )
    failed = EpisodeResult.record["failure"].astext.is_not(None)
    for row in session.scalars(select(EpisodeResult).where(mine, ~is_shared, ~scored, failed)):
        stored = EpisodeRecord.model_validate(row.record)
        failure = stored.failure and stored.failure.model_copy(update={"message": REMOVED, "output_tail": ""})
        kept = stored.model_copy(update={"failure": failure})
        row.record, row.record_digest = kept.model_dump(mode="json", exclude={"output"}), kept.record_digest()
    of_chosen = Evaluation.submission_id.in_(ids)
    session.execute(
        update(Evaluation)
        .where(of_chosen, Evaluation.verdict_message.is_not(None))
        .values(verdict_message=REMOVED)
        .execution_options(synchronize_session=False)
    )
    session.execute(
        update(Evaluation).where(of_chosen).values(log_tail="").execution_options(synchronize_session=False)
    )


def _lock(session: Session, by: Principal, submission_id: UUID) -> Submission:
    submission = changeable(session, by, submission_id)
    if submission.competition:
        Competition.lock(session, submission.competition, shared=True).require_not_final()
    session.execute(select(Submission.id).where(Submission.id == submission.id).with_for_update(key_share=True))
    session.refresh(submission, ["withdrawn_at", "erased_at"])
    return submission


def disqualify(session: Session, by: Principal, submission_id: UUID, reason: str) -> None:
    """Take the results of a submission off all boards, also those that it gets later; its team reads the reason.

    Raises:
        ServiceError: not an organizer, there is no such submission, the reason cannot be shown, or it is disqualified
            already.
    """
    submission = _lock_for_organizer(session, by, submission_id)
    shown = names.clean(reason, what="A reason", min_length=2, max_length=REASON_LENGTH)
    require_qualified(submission)
    submission.disqualified_at, submission.disqualified_for = read_clock(session), shown
    mark_results(session, submission)
    subject = f"submission:{submission.id}"
    record(session, by, "submission.disqualify", subject, {"reason": shown}, before={"reason": None})


def reinstate(session: Session, by: Principal, submission_id: UUID) -> None:
    """Put the results of a disqualified submission back on the boards; doing it again changes nothing.

    Raises:
        ServiceError: not an organizer, or there is no such submission.
    """
    submission = _lock_for_organizer(session, by, submission_id)
    if submission.disqualified_at is not None:
        before = {"reason": submission.disqualified_for}
        submission.disqualified_at = submission.disqualified_for = None
        mark_results(session, submission)
        record(session, by, "submission.reinstate", f"submission:{submission.id}", {"reason": None}, before=before)


def require_qualified(submission: Submission) -> None:
    """Refuse what is disqualified.

    Raises:
        ServiceError: submission_disqualified.
    """
    if submission.disqualified_at is not None:
        raise ServiceError(
            ProblemCode.SUBMISSION_DISQUALIFIED,
            f"Submission {submission.id} is disqualified: {submission.disqualified_for}. Ask the organizers.",
        )


def _lock_for_organizer(session: Session, by: Principal, submission_id: UUID) -> Submission:
    by.require_organizer(by.competition)
    submission = visible(session, by, submission_id)
    session.execute(select(Submission.id).where(Submission.id == submission.id).with_for_update(key_share=True))
    session.refresh(submission, ["disqualified_at", "disqualified_for", "copy_cleared_at", "copy_cleared_for"])
    return submission


def clear_copy(session: Session, by: Principal, submission_id: UUID, reason: str) -> None:
    """Rank a submission whatever it is alike to, now and when it is evaluated again; its team reads the reason.

    Raises:
        ServiceError: not an organizer, there is no such submission, the reason cannot be shown, or it is cleared
            already.
    """
    submission = _lock_for_organizer(session, by, submission_id)
    shown = names.clean(reason, what="A reason", min_length=2, max_length=REASON_LENGTH)
    if submission.copy_cleared_at is not None:
        raise ServiceError(
            ProblemCode.INVALID_REQUEST,
            f"Submission {submission.id} is cleared already: {submission.copy_cleared_for}",
        )
    submission.copy_cleared_at, submission.copy_cleared_for = read_clock(session), shown
    _mark_copies(session, submission)
    record(session, by, "submission.clear", f"submission:{submission.id}", {"reason": shown}, before={"reason": None})


def withdraw_clearance(session: Session, by: Principal, submission_id: UUID) -> None:
    """Let what was found of a cleared submission count again; doing it again changes nothing.

    Raises:
        ServiceError: not an organizer, or there is no such submission.
    """
    submission = _lock_for_organizer(session, by, submission_id)
    if submission.copy_cleared_at is not None:
        before = {"reason": submission.copy_cleared_for}
        submission.copy_cleared_at = submission.copy_cleared_for = None
        _mark_copies(session, submission)
        record(
            session, by, "submission.withdraw-clearance", f"submission:{submission.id}", {"reason": None}, before=before
        )


def _mark_copies(session: Session, submission: Submission) -> None:
    session.flush()
    for evaluation in list_completed(session, submission.id):
        mark_copy(session, evaluation)
