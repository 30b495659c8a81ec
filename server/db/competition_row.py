"""The row of the one competition of this service: read, locked, and left alone once it is final."""

from sqlalchemy.orm import Session

from ..errors import ProblemCode, ServiceError
from .models import Competition

_ONLY_ID = 1


def competition_row(session: Session) -> Competition | None:
    """Return the competition as far as the session has read it; None: none was applied."""
    return session.get(Competition, _ONLY_ID)


def lock_competition(session: Session, *, shared: bool = False) -> Competition | None:
    """Return the competition as it is now, and keep it so until the end of the transaction; None: none was applied.

    Args:
        session: of the transaction.
        shared: whether others may lock it so at the same time.
    """
    lock = {"read": True} if shared else True
    return session.get(Competition, _ONLY_ID, with_for_update=lock, populate_existing=True)


def require_not_final(row: Competition | None) -> None:
    """Refuse what would change a competition after its end.

    Raises:
        ServiceError: it is final.
    """
    if row is not None and row.finalized_at is not None:
        raise ServiceError(
            ProblemCode.COMPETITION_FINAL, f"{row.definition['title']} is final since {row.finalized_at:%F %T} UTC."
        )
