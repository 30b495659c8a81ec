"""What a team writes about a public result, with links to code, paper and discussion; called by API, pages, command.

Others see it with the result, never while its team is anonymous, and not once an organizer has removed it.
"""

import re
from collections.abc import Collection, Mapping
from typing import Final
from uuid import UUID

from sqlalchemy import select
from sqlalchemy.orm import Session, joinedload

from .. import names
from ..accounts import webhooks
from ..accounts.shown_names import ShownNames
from ..accounts.teams import REASON_LENGTH
from ..audit import record
from ..confirmations import compute_revision
from ..database.engine import among
from ..database.models import Submission
from ..errors import ProblemCode, ServiceError
from ..names import clean_text
from ..principals import Principal
from ..views.submissions import DescriptionView
from ..visibility import visible
from .public_pages import readable

LINKS: Final = ("code", "paper", "discussion")
_HOST: Final = re.compile(r"(?:[a-z0-9](?:[a-z0-9-]*[a-z0-9])?\.)+[a-z]{2,}")
_ADDRESS: Final = re.compile(r"[A-Za-z0-9._~:/?@!$&'()*+,;=%-]+")
"""What an address is written with (RFC 3986), but brackets and the fragment."""
_NOT_GLOBAL: Final = ("alt", "example", "internal", "invalid", "lan", "local", "localhost", "onion", "test")
"""Ends of names that no public server has (RFC 2606, 6761, 6762, 7686, 9476), and two that local networks use."""


def find_description(session: Session, by: Principal, submission_id: UUID) -> DescriptionView:
    """Return what is written about a submission, for somebody who may read its result; empty where nothing is shown.

    Raises:
        ServiceError: there is no such submission.
    """
    submission = readable(session, by, submission_id)
    return show_description(submission, by, ShownNames.read(session, by)) or DescriptionView()


def show_description(submission: Submission, by: Principal, shown: ShownNames) -> DescriptionView | None:
    """Return what somebody who may read a submission sees of its description; None where that is nothing."""
    content, removed_for = submission.description, submission.description_removed_for
    is_own = by.may_see(submission.team_id, submission.competition)
    if not is_own and (removed_for is not None or shown.hides(submission.team)):
        return None
    if content is None and removed_for is None:
        return None
    return DescriptionView(**content or {}, revision=compute_revision(content), removed_for=removed_for)


def descriptions_among(session: Session, by: Principal, public: Collection[UUID]) -> Mapping[UUID, DescriptionView]:
    """Return those of some public submissions that somebody sees."""
    query = select(Submission).where(
        among(Submission.id, public), Submission.description.is_not(None), Submission.description_removed_for.is_(None)
    )
    described = session.scalars(query.options(joinedload(Submission.team))).all()
    if not described:
        return {}
    shown = ShownNames.read(session, by)
    return {one.id: view for one in described if (view := show_description(one, by, shown))}


def describe(
    session: Session, by: Principal, submission_id: UUID, *, text: str, base: str | None = None, **links: str
) -> None:
    """Write about a public result; nothing at all takes away what was written.

    Args:
        session: of the transaction.
        by: its team or an organizer.
        submission_id: of the result.
        text: plain, of several lines.
        base: the revision that the change was made against; None: whatever is there now.
        links: `code`, `paper` and `discussion`; empty: none.

    Raises:
        ServiceError: another team's, not public, removed by an organizer, changed meanwhile, or text or a link cannot
            be shown.
    """
    submission = _lock(session, by, submission_id)
    before = compute_revision(submission.description)
    if base not in {None, before}:
        raise ServiceError(
            ProblemCode.CHANGED_MEANWHILE,
            f"Somebody changed this description meanwhile: expected revision {base or 'none'}, got {before or 'none'}. "
            "Nothing was changed. Read it again and repeat your change.",
            revision=before,
        )
    content = {"text": clean_text(text, what="A description")} if text.strip() else {}
    content |= {name: _check_link(name, links[name]) for name in LINKS if links.get(name, "").strip()}
    submission.description = content or None
    after = {"revision": compute_revision(content)}
    record(session, by, "submission.describe", _subject(submission), after, before={"revision": before})


def remove(session: Session, by: Principal, submission_id: UUID, reason: str) -> None:
    """Hide a description from others until it is restored; its team reads the reason and cannot change it.

    Raises:
        ServiceError: not an organizer, there is no such submission, or the reason cannot be shown.
    """
    _set_removed(
        session, by, submission_id, names.clean(reason, what="A reason", min_length=2, max_length=REASON_LENGTH)
    )


def restore(session: Session, by: Principal, submission_id: UUID) -> None:
    """Let others see a removed description again; doing it again changes nothing.

    Raises:
        ServiceError: not an organizer, or there is no such submission.
    """
    _set_removed(session, by, submission_id, None)


def _set_removed(session: Session, by: Principal, submission_id: UUID, reason: str | None) -> None:
    by.require_organizer(by.competition)
    submission = visible(session, by, submission_id)
    _refresh(session, submission)
    before, submission.description_removed_for = submission.description_removed_for, reason
    if before != reason:
        action = "submission.restore-description" if reason is None else "submission.remove-description"
        record(session, by, action, _subject(submission), {"reason": reason}, before={"reason": before})


def _lock(session: Session, by: Principal, submission_id: UUID) -> Submission:
    submission = readable(session, by, submission_id)
    if not by.may_change(submission.team_id, submission.competition):
        raise ServiceError(
            ProblemCode.FORBIDDEN, "Expected a result of your team, got another one: only its team describes it."
        )
    _refresh(session, submission)
    if submission.description_removed_for is not None and not by.organizes(submission.competition):
        raise ServiceError(
            ProblemCode.FORBIDDEN,
            f"An organizer removed this description: {submission.description_removed_for} Ask the organizers.",
        )
    if not submission.is_public:
        raise ServiceError(
            ProblemCode.INVALID_REQUEST,
            "Expected a public result, got a private one. Make it public first, on its page or with `vitac publish`.",
        )
    return submission


def _refresh(session: Session, submission: Submission) -> None:
    session.execute(select(Submission.id).where(Submission.id == submission.id).with_for_update(key_share=True))
    session.refresh(submission, ["description", "description_removed_for", "is_public"])


def _subject(submission: Submission) -> str:
    return f"submission:{submission.id}"


def _check_link(name: str, address: str) -> str:
    """Return a link as it is stored: https, to a host that everybody can reach and whose name reads as it is.

    Names of other scripts come as `xn--`, and may look like another one; addresses of numbers and ports are refused.
    """
    what, address = f"The link to {name}", address.strip()
    parts = webhooks.check_address(address, inside_allowed=False, what=what)
    host = parts.hostname or ""
    labels = host.split(".")
    if (
        not _ADDRESS.fullmatch(address)
        or not _HOST.fullmatch(host)
        or labels[-1] in _NOT_GLOBAL
        or any(label.startswith("xn--") for label in labels)
        or parts.port is not None
    ):
        raise ServiceError(
            ProblemCode.INVALID_REQUEST,
            f"{what} {address!r:.100} cannot be used: expected a public host in plain letters without port, such as "
            f"https://github.com/TEAM/POLICY, got {parts.netloc!r:.60}.",
        )
    return address
