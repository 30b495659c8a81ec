"""When the addresses of people are forgotten; called by housekeeping, also in workers, which have no passwords."""

from datetime import UTC, datetime, timedelta

from sqlalchemy import delete, update
from sqlalchemy.orm import Session

from ..audit import record
from ..competition.competition import Competition
from ..db.models import Member, Notice, Team
from ..db.states import NoticeChannel
from ..principals import CONSOLE
from ..settings import Settings


def forget_contacts(session: Session, settings: Settings, at: datetime | None = None) -> int:
    """Remove people's addresses when all competitions ended long enough ago; return how many. `at`: None is now."""
    days, ends = settings.contacts_kept_days, [one.row.finalized_at for one in Competition.read_all(session)]
    over = [end for end in ends if end is not None]
    if days is None or len(over) < len(ends) or (at or datetime.now(UTC)) < max(over) + timedelta(days=days):
        return 0
    of_members = session.scalars(
        update(Member).where(Member.email.is_not(None)).values(email=None).returning(Member.id)
    )
    session.execute(delete(Notice).where(Notice.channel == NoticeChannel.MAIL))
    of_teams = session.scalars(update(Team).where(Team.contact.is_not(None)).values(contact=None).returning(Team.id))
    forgotten = len(of_members.all()) + len(of_teams.all())
    if forgotten:
        after, before = {"contacts": 0}, {"contacts": forgotten}
        record(session, CONSOLE, "contacts.forget", "competition:contacts", after, before=before)
    return forgotten
