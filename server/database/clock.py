"""The one clock of the service: the database's, whatever the clocks of the machines around it say."""

from datetime import UTC, datetime

from sqlalchemy import func, select
from sqlalchemy.orm import Session


def read_clock(session: Session) -> datetime:
    """Return the time now; rows that are half changed stay unwritten."""
    with session.no_autoflush:
        now: datetime = session.scalars(select(func.clock_timestamp())).one()
    return now.astimezone(UTC)
