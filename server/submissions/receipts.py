"""Receipts of a submission's results as its team reads them, and those of results from before there were receipts."""

from uuid import UUID

import structlog
from sqlalchemy import select
from sqlalchemy.orm import Session

from ..db.models import Evaluation, ReceiptRow
from ..db.states import EvaluationState
from ..errors import ProblemCode, ServiceError
from ..evaluations.scores import combined_result
from ..principals import Principal
from ..receipts import chain
from ..receipts.receipt import Receipt
from ..views.receipts import ChainView, LinkView
from ..visibility import visible

logger = structlog.get_logger(__name__)

ISSUED_TOGETHER = 200
"""Receipts of older results in one transaction, which no other receipt can interrupt."""


def receipts(session: Session, by: Principal, submission_id: UUID) -> list[Receipt]:
    """Return the receipts of a submission's results, the first one first; they hold nothing of single episodes.

    Raises:
        ServiceError: there is no such submission.
    """
    return list(chain.receipts_of_submission(session, visible(session, by, submission_id).id))


def newest_receipt(session: Session, by: Principal, submission_id: UUID) -> Receipt:
    """Return the receipt of a submission's newest result.

    Raises:
        ServiceError: there is no such submission, or it has no result.
    """
    found = receipts(session, by, submission_id)
    if not found:
        raise ServiceError(ProblemCode.NOT_FOUND, f"Submission {submission_id} has no final result, so no receipt.")
    return found[-1]


def chain_view(session: Session, *, after: int, limit: int) -> ChainView:
    """Return a page of the chain, which anybody may read: its links tell no result."""
    state = chain.chain_state(session)
    found = chain.links(session, after=after, limit=limit)
    items = [LinkView(**link.model_dump(), digest=link.digest) for link in found]
    is_end = not items or items[-1].number >= state.receipts
    return ChainView(
        public_key=state.public_key,
        receipts=state.receipts,
        last=state.last,
        items=items,
        next_after=None if is_end else items[-1].number,
    )


def issue_older(session: Session) -> int:
    """Issue receipts for the oldest results that were complete before this service had a key; return how many.

    None is left, or only such as cannot be read, when it returns 0.
    """
    key = chain.ensure_key(session)
    without = session.scalars(
        select(Evaluation)
        .outerjoin(ReceiptRow, ReceiptRow.evaluation_id == Evaluation.id)
        .where(
            Evaluation.state == EvaluationState.COMPLETED,
            Evaluation.finished_at < key.made_at,
            ~Evaluation.is_proposed,
            ReceiptRow.number.is_(None),
        )
        .order_by(Evaluation.finished_at, Evaluation.id)
        .limit(ISSUED_TOGETHER)
        .with_for_update(of=Evaluation, key_share=True)
    ).all()
    return sum(_issue(session, evaluation) for evaluation in without)


def _issue(session: Session, evaluation: Evaluation) -> bool:
    """Issue the receipt of an older result; one that can no longer be read is left out."""
    try:
        chain.issue(session, evaluation, combined_result(evaluation))
    except (KeyError, ValueError) as error:
        message = " ".join(str(error).split())[:300]
        logger.error("receipt_left_out", evaluation=str(evaluation.id), error=message, kind=type(error).__name__)
        return False
    return True
