"""The audit log: every change by a person, written in the transaction of the change by the one function `record`.

Digests of it are in the public log, so that no line is changed or removed later unseen.
"""

import hashlib
from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta
from typing import TYPE_CHECKING, Any

from sqlalchemy import select
from sqlalchemy.orm import Session
from vitac.evaluator.episodes.records import canonical_json

from .database.clock import read_clock
from .database.models import AuditEntry, ReceiptRow
from .transparency.entries import AuditLogGrown, EntryKind
from .transparency.log import append, parse_entry
from .views.teams import AuditDigestView, AuditEntryView

if TYPE_CHECKING:
    from .principals import Principal

SETTLED_AFTER = timedelta(minutes=1)
"""So old a line is when its digest is made: by then no other transaction adds one with a lower number."""
DIGEST_EVERY = timedelta(hours=1)


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


def append_audit_digest(session: Session, *, every: timedelta = timedelta()) -> bool:
    """Add the digest of the lines since the last one to the log; return whether there were any.

    Args:
        session: of the transaction.
        every: nothing is added before the last digest is so old.
    """
    last, now = _find_last(session), read_clock(session)
    if last is not None and last.issued_at > now - every:
        return False
    lines = _read_lines(session, 0 if last is None else last.last, now - SETTLED_AFTER)
    if not lines:
        return False
    append(
        session,
        lambda at: AuditLogGrown(
            issued_at=at, first=lines[0].id, last=lines[-1].id, lines=len(lines), lines_sha256=_hash(lines)
        ),
    )
    return True


def list_audit_digests(session: Session) -> list[AuditDigestView]:
    """Return all digests, and whether the audit log still has the lines that each is of."""
    rows = session.scalars(
        select(ReceiptRow).where(ReceiptRow.stands_for == EntryKind.AUDIT_LOG).order_by(ReceiptRow.number)
    )
    entries = [parse_entry(row) for row in rows]
    return [
        AuditDigestView.from_row(
            digest, entry=entry.number, agrees=_hash(_read_between(session, digest)) == digest.lines_sha256
        )
        for entry in entries
        for digest in (AuditLogGrown.model_validate(entry.statement),)
    ]


def _find_last(session: Session) -> AuditLogGrown | None:
    newest = select(ReceiptRow).where(ReceiptRow.stands_for == EntryKind.AUDIT_LOG)
    row = session.scalar(newest.order_by(ReceiptRow.number.desc()).limit(1))
    return None if row is None else AuditLogGrown.model_validate(parse_entry(row).statement)


def _read_lines(session: Session, after: int, until: datetime) -> Sequence[AuditEntry]:
    query = select(AuditEntry).where(AuditEntry.id > after, AuditEntry.at < until).order_by(AuditEntry.id)
    return session.scalars(query).all()


def _read_between(session: Session, digest: AuditLogGrown) -> Sequence[AuditEntry]:
    of_digest = select(AuditEntry).where(AuditEntry.id.between(digest.first, digest.last)).order_by(AuditEntry.id)
    return session.scalars(of_digest.execution_options(populate_existing=True)).all()


def _hash(lines: Sequence[AuditEntry]) -> str:
    """Return the SHA-256 [hex] over lines."""
    content = b"\n".join(canonical_json({"id": line.id, **entry_view(line).model_dump(mode="json")}) for line in lines)
    return hashlib.sha256(content).hexdigest()
