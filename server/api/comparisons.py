"""The route that compares results."""

from typing import Annotated
from uuid import UUID

from fastapi import APIRouter, Query

from ..submissions.comparison import MAX_COMPARED, compare_results
from ..views.comparisons import ComparisonView
from .access import ReaderOf, ServicesOf
from .problems import RESPONSES

router = APIRouter(prefix="/comparisons", tags=["submissions"], responses=RESPONSES)


@router.get("")
def get_comparison(
    services: ServicesOf,
    principal: ReaderOf,
    submission: Annotated[list[UUID], Query(min_length=1, max_length=MAX_COMPARED, description="Id of each.")],
) -> ComparisonView:
    """Return results beside each other; of submissions that you may not see, what leaderboards show of them."""
    with services.database.reading() as session:
        return compare_results(session, services.settings, principal, submission)
