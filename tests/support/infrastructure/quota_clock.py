"""The time by which quotas count within a day, so that no test depends on when midnight is."""

from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta

from sqlalchemy.orm import Session


@dataclass(kw_only=True)
class QuotaClock:
    """What quotas take for now: the moment at which a test began, until the test sets another one."""

    moment: datetime = field(default_factory=lambda: datetime.now(UTC))

    def read(self, _: Session) -> datetime:
        return self.moment

    @property
    def midnight(self) -> datetime:
        """The next one in UTC."""
        return datetime.combine(self.moment.date() + timedelta(days=1), datetime.min.time(), UTC)
