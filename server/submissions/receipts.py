"""Receipts of a submission and of its results as its team reads them, and the chain for everybody."""

from uuid import UUID

from sqlalchemy.orm import Session

from ..contest.contest import Contest
from ..errors import ProblemCode, ServiceError
from ..principals import Principal
from ..receipts import chain
from ..receipts.receipt import Receipt, SubmissionReceipt
from ..views.receipts import ChainView, LinkView
from ..visibility import visible


def receipts(session: Session, by: Principal, submission_id: UUID) -> list[Receipt]:
    """Return the receipts of a submission's results, the first one first; they hold nothing of single episodes.

    Raises:
        ServiceError: there is no such submission.
    """
    return list(chain.receipts_of_submission(session, visible(session, by, submission_id).id))


def receipt_of_arrival(session: Session, by: Principal, submission_id: UUID) -> SubmissionReceipt:
    """Return the receipt that a submission got when it arrived.

    Raises:
        ServiceError: there is no such submission, or it got none.
    """
    found = chain.receipt_of_arrival(session, visible(session, by, submission_id).id)
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


def chain_view(session: Session, *, after: int, limit: int, contest: str | None = None) -> ChainView:
    """Return a page of the chain, which anybody may read: its links tell no result.

    Args:
        session: of the transaction.
        after: number of the last link of the page before.
        limit: maximum number of links.
        contest: name of the competition whose links are listed; None: all links.

    Raises:
        ServiceError: there is no such competition.
    """
    name = None if contest is None else Contest.find(session, contest).name
    state = chain.chain_state(session)
    found = chain.links(session, after=after, limit=limit + 1, contest=name)
    items = [LinkView(**link.model_dump(), digest=link.digest) for link in found[:limit]]
    is_end = not items or len(found) <= limit
    return ChainView(
        public_key=state.public_key,
        receipts=state.receipts,
        last=state.last,
        items=items,
        next_after=None if is_end else items[-1].number,
    )
