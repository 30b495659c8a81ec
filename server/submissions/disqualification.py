"""Takes one submission off all boards, or puts it back; its team takes part as before. Called by API and command."""

from uuid import UUID

from sqlalchemy import select
from sqlalchemy.orm import Session

from .. import names
from ..accounts.teams import REASON_LENGTH
from ..audit import record
from ..database.clock import read_clock
from ..database.models import Submission
from ..errors import ProblemCode, ServiceError
from ..evaluations.copies import list_completed, mark_copy
from ..principals import Principal
from ..visibility import visible
from .withdrawal import mark_results


def disqualify(session: Session, by: Principal, submission_id: UUID, reason: str) -> None:
    """Take the results of a submission off all boards, also those that it gets later; its team reads the reason.

    Raises:
        ServiceError: not an organizer, there is no such submission, the reason cannot be shown, or it is disqualified
            already.
    """
    submission = _lock(session, by, submission_id)
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
    submission = _lock(session, by, submission_id)
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


def _lock(session: Session, by: Principal, submission_id: UUID) -> Submission:
    by.require_organizer(by.competition)
    submission = visible(session, by, submission_id)
    session.execute(select(Submission.id).where(Submission.id == submission.id).with_for_update(key_share=True))
    session.refresh(submission, ["disqualified_at", "disqualified_for", "copy_cleared_at", "copy_cleared_for"])
    return submission


def clear(session: Session, by: Principal, submission_id: UUID, reason: str) -> None:
    """Rank a submission whatever it is alike to, now and when it is evaluated again; its team reads the reason.

    Raises:
        ServiceError: not an organizer, there is no such submission, the reason cannot be shown, or it is cleared
            already.
    """
    submission = _lock(session, by, submission_id)
    shown = names.clean(reason, what="A reason", min_length=2, max_length=REASON_LENGTH)
    if submission.copy_cleared_at is not None:
        raise ServiceError(
            ProblemCode.INVALID_REQUEST,
            f"Submission {submission.id} is cleared already: {submission.copy_cleared_for}",
        )
    submission.copy_cleared_at, submission.copy_cleared_for = read_clock(session), shown
    _mark(session, submission)
    record(session, by, "submission.clear", f"submission:{submission.id}", {"reason": shown}, before={"reason": None})


def withdraw(session: Session, by: Principal, submission_id: UUID) -> None:
    """Let what was found of a cleared submission count again; doing it again changes nothing.

    Raises:
        ServiceError: not an organizer, or there is no such submission.
    """
    submission = _lock(session, by, submission_id)
    if submission.copy_cleared_at is not None:
        before = {"reason": submission.copy_cleared_for}
        submission.copy_cleared_at = submission.copy_cleared_for = None
        _mark(session, submission)
        record(
            session, by, "submission.withdraw-clearance", f"submission:{submission.id}", {"reason": None}, before=before
        )


def _mark(session: Session, submission: Submission) -> None:
    session.flush()
    for evaluation in list_completed(session, submission.id):
        mark_copy(session, evaluation)
