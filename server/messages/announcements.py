"""Announcements: what organizers say to everybody; shown on the competition's page and sent to teams where wanted."""

from datetime import UTC, datetime

from sqlalchemy import select
from sqlalchemy.orm import Session

from .. import names
from ..audit import record
from ..db.models import Announcement, Team
from ..db.states import NoticeKind
from ..errors import not_found
from ..notices.outbox import announce
from ..principals import Principal
from ..texts import clean_text
from ..views.messages import AnnouncementView

TITLE_LENGTH = 120
SHOWN = 100


def publish(session: Session, by: Principal, *, title: str, text: str, notify: bool) -> Announcement:
    """Show an announcement to everybody.

    Args:
        session: of the transaction.
        by: an organizer.
        title: one line.
        text: plain text in paragraphs.
        notify: whether it is sent to all teams, too.

    Raises:
        ServiceError: not an organizer, or title or text cannot be shown.
    """
    by.require_organizer()
    made = Announcement(
        title=names.clean(title, what="A title", min_length=2, max_length=TITLE_LENGTH),
        text=clean_text(text, what="An announcement"),
        published_at=datetime.now(UTC),
    )
    session.add(made)
    session.flush()
    record(session, by, "announcement.publish", f"announcement:{made.id}", {"title": made.title, "notify": notify})
    if notify:
        facts = {"title": made.title, "text": made.text, "page": "/announcements"}
        taking_part = Team.approved_at.is_not(None), Team.disqualified_at.is_(None)
        for team_id in session.scalars(select(Team.id).where(*taking_part)).all():
            announce(session, NoticeKind.ANNOUNCEMENT, team_id, f"announcement:{made.id}", facts)
    return made


def withdraw(session: Session, by: Principal, announcement_id: int) -> None:
    """Show an announcement to nobody from now on; what was sent is sent. Doing it again changes nothing.

    Raises:
        ServiceError: not an organizer, or there is no such announcement.
    """
    by.require_organizer()
    found = session.get(Announcement, announcement_id, with_for_update=True)
    if found is None:
        raise not_found("announcement", announcement_id)
    if found.withdrawn_at is None:
        found.withdrawn_at = datetime.now(UTC)
        after, before = {"shown": False}, {"shown": True, "title": found.title}
        record(session, by, "announcement.withdraw", f"announcement:{found.id}", after, before=before)


def shown(session: Session) -> list[AnnouncementView]:
    """Return the announcements that everybody sees, newest first."""
    query = select(Announcement).where(Announcement.withdrawn_at.is_(None)).order_by(Announcement.id.desc())
    return [AnnouncementView.model_validate(one, from_attributes=True) for one in session.scalars(query.limit(SHOWN))]
