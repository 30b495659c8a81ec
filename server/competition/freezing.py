"""Boards that show no new results for a while, so that nobody knows the winners before the organizers say them."""

from datetime import UTC, datetime

from sqlalchemy.orm import Session

from ..audit import record
from ..principals import Principal
from .competition import Competition


def freeze(session: Session, by: Principal, name: str | None = None) -> None:
    """Show no new results on the boards of all stages to anybody but organizers; results are still stored.

    Raises:
        ServiceError: not an organizer, or there is no competition, or it is final.
    """
    competition = Competition.lock_to_change(session, by, name)
    if competition.frozen_at is None:
        competition.row.frozen_at = datetime.now(UTC)
        after = {"frozen_at": competition.row.frozen_at.isoformat()}
        record(session, by, "competition.freeze", competition.subject, after)


def unfreeze(session: Session, by: Principal, name: str | None = None) -> None:
    """Show all results again; a time at which the file would freeze them no longer does.

    Raises:
        ServiceError: not an organizer, or there is no competition, or it is final.
    """
    competition = Competition.lock_to_change(session, by, name)
    if competition.row.frozen_at is not None:
        before = {"frozen_at": competition.row.frozen_at.isoformat()}
        competition.row.frozen_at = None
        record(session, by, "competition.unfreeze", competition.subject, {"frozen_at": None}, before=before)
