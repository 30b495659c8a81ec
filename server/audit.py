"""The audit log: every change by a person, written in the transaction of the change by the one function `record`."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from .database.models import AuditEntry
from .views.teams import AuditEntryView

if TYPE_CHECKING:
    from .principals import Principal


def record(
    session: Session,
    by: "Principal",
    action: str,
    subject: str,
    after: Mapping[str, Any],
    *,
    before: Mapping[str, Any] | None = None,
) -> None:
    """Add one line.

    Args:
        session: of the transaction that makes the change.
        by: who did it.
        action: what was done, `noun.verb`.
        subject: to which thing, `noun:id`.
        after: what it is now, as JSON.
        before: what it was; None where there was nothing before.
    """
    old = dict(before) if before is not None else None
    session.add(AuditEntry(actor=by.actor, action=action, subject=subject, before=old, after=dict(after)))


def newest_entries(
    session: Session, limit: int = 100, *, action: str | None = None, subject: str | None = None
) -> list[AuditEntry]:
    """Return the last lines (of an action, of a thing), newest first."""
    query = select(AuditEntry).order_by(AuditEntry.id.desc()).limit(limit)
    if action is not None:
        query = query.where(AuditEntry.action == action)
    if subject is not None:
        query = query.where(AuditEntry.subject == subject)
    return list(session.scalars(query))


def entry_view(entry: AuditEntry) -> AuditEntryView:
    """Return a line as organizers see it."""
    return AuditEntryView.model_validate(entry, from_attributes=True)
