"""Receipts of a submission and of its results as its team reads them, and the log for everybody."""

from dataclasses import asdict
from uuid import UUID

from sqlalchemy.orm import Session

from ..competitions.competition import Competition
from ..errors import ProblemCode, ServiceError
from ..principals import Principal
from ..receipts import issuing
from ..receipts.receipt import Receipt, SubmissionReceipt
from ..receipts.witnesses import list_witness_views
from ..transparency.log import read_log_state
from ..views.receipts import PublicLogEntryView, PublicLogView
from ..visibility import visible


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
    found = issuing.receipt_of_arrival(session, visible(session, by, submission_id).id)
    if found is None:
        raise ServiceError(ProblemCode.NOT_FOUND, f"Submission {submission_id} has no receipt of its arrival.")
    return found


def newest_receipt(session: Session, by: Principal, submission_id: UUID) -> Receipt:
    """Return the receipt of a submission's newest result.

    Raises:
        ServiceError: there is no such submission, or it has no result.
    """
    found = receipts(session, by, submission_id)
    if not found:
        raise ServiceError(ProblemCode.NOT_FOUND, f"Submission {submission_id} has no final result, so no receipt.")
    return found[-1]


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
    found = issuing.list_entries(session, after=after, limit=limit + 1, competition=name)
    items = [PublicLogEntryView(**entry.model_dump(), leaf_hash=entry.leaf_hash.hex()) for entry in found[:limit]]
    is_end = not items or len(found) <= limit
    return PublicLogView(
        **asdict(read_log_state(session)),
        witnesses=list_witness_views(session),
        items=items,
        next_after=None if is_end else items[-1].number,
    )
