"""Routes of receipts: the log, for everybody, and the receipts of a submission."""

from typing import Annotated
from uuid import UUID

from fastapi import APIRouter, Query

from ..receipts.receipt import Receipt, SubmissionReceipt
from ..submissions import receipts
from ..views.receipts import LogView
from .access import PrincipalOf, ServicesOf
from .problems import RESPONSES

router = APIRouter(tags=["receipts"], responses=RESPONSES)

PAGE_ENTRIES = 1000


@router.get("/competitions/{competition}/receipts")
@router.get("/receipts")
def get_log(
    services: ServicesOf,
    *,
    competition: str | None = None,
    after: Annotated[int, Query(ge=0, le=2**53, description="`next_after` from the previous page.")] = 0,
    limit: Annotated[int, Query(ge=1, le=PAGE_ENTRIES)] = PAGE_ENTRIES,
) -> LogView:
    """Return the public key that signs the log of receipts, and its entries, or those of a competition."""
    with services.database.transaction() as session:
        return receipts.log_view(session, after=after, limit=limit, competition=competition)


@router.get("/submissions/{submission_id}/receipts")
def get_receipts(services: ServicesOf, principal: PrincipalOf, submission_id: UUID) -> list[Receipt]:
    """Return the receipt of each final result of a submission, the first one first."""
    with services.database.transaction() as session:
        return receipts.receipts(session, principal, submission_id)


@router.get("/submissions/{submission_id}/arrival")
def get_receipt_of_arrival(services: ServicesOf, principal: PrincipalOf, submission_id: UUID) -> SubmissionReceipt:
    """Return the receipt that a submission got when it arrived, before anybody knew its result."""
    with services.database.transaction() as session:
        return receipts.receipt_of_arrival(session, principal, submission_id)
