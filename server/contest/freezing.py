"""Boards that show no new results for a while, so that nobody knows the winners before the organizers say them."""

from datetime import UTC, datetime

from sqlalchemy.orm import Session

from ..audit import record
from ..principals import Principal
from .contest import Contest


def freeze(session: Session, by: Principal, name: str | None = None) -> None:
    """Show no new results on the boards of all stages to anybody but organizers; results are still stored.

    Raises:
        ServiceError: not an organizer, or there is no competition, or it is final.
    """
    contest = Contest.lock_to_change(session, by, name)
    if contest.frozen_at is None:
        contest.row.frozen_at = datetime.now(UTC)
        after = {"frozen_at": contest.row.frozen_at.isoformat()}
        record(session, by, "competition.freeze", contest.subject, after)


def unfreeze(session: Session, by: Principal, name: str | None = None) -> None:
    """Show all results again; a time at which the file would freeze them no longer does.

    Raises:
        ServiceError: not an organizer, or there is no competition, or it is final.
    """
    contest = Contest.lock_to_change(session, by, name)
    if contest.row.frozen_at is not None:
        before = {"frozen_at": contest.row.frozen_at.isoformat()}
        contest.row.frozen_at = None
        record(session, by, "competition.unfreeze", contest.subject, {"frozen_at": None}, before=before)
