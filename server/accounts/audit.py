"""The audit log: every change by a person, written in the transaction of the change."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from sqlalchemy import select
from sqlalchemy.orm import Session
from vitac.server.db.models import AuditEntry

if TYPE_CHECKING:
    from vitac.server.accounts.principals import Principal


def record(session: Session, by: "Principal", action: str, subject: str, detail: Mapping[str, Any]) -> None:
    """Add one line: who did what (`noun.verb`) to which thing (`noun:id`)."""
    session.add(AuditEntry(actor=by.actor, action=action, subject=subject, detail=dict(detail)))


def newest_entries(session: Session, limit: int = 100) -> list[AuditEntry]:
    """Return the last lines, newest first."""
    return list(session.scalars(select(AuditEntry).order_by(AuditEntry.id.desc()).limit(limit)))
