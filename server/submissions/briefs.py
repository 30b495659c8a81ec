"""Briefs of a stage: handed in by teams as PDF, read and accepted by judges."""

import hashlib
import re
import zlib
from collections.abc import Iterator, Sequence
from typing import Final
from uuid import UUID

from sqlalchemy import select
from sqlalchemy.orm import Session

from ..accounts import teams
from ..audit import record
from ..competitions.competition import Competition
from ..competitions.definition import BriefRules
from ..competitions.stages import Stage
from ..database.clock import read_clock
from ..database.models import Brief
from ..errors import ProblemCode, ServiceError, not_found
from ..principals import Principal
from ..views.by_hand import BriefView

BRIEF_BYTES = 10 << 20


def hand_in(session: Session, by: Principal, stage: Stage, content: bytes) -> Brief:
    """Store the brief of the own team, in place of an earlier one, while the stage is open.

    Raises:
        ServiceError: no team's token, the stage takes no briefs now, the committee has decided already, or the document
            is no PDF of so many pages.
    """
    team = teams.own(session, by)
    teams.lock(session, team)
    teams.require_taking_part(team)
    rules, now = _require_rules(stage), read_clock(session)
    if not stage.rules.opens <= now < stage.rules.closes:
        raise ServiceError(
            ProblemCode.STAGE_CLOSED,
            f"Stage {stage.name} takes briefs from {stage.rules.opens:%F %T} to {stage.rules.closes:%F %T} UTC.",
        )
    pages = count_pages(content)
    if not rules.min_pages <= pages <= rules.max_pages:
        got = (
            f"one of {pages}" if pages else "a file without pages that can be read; save it as PDF, without a password"
        )
        raise ServiceError(ProblemCode.INVALID_REQUEST, f"Expected {rules.sentence}, got {got}.")
    brief = session.get(Brief, _key(stage, team.id))
    if brief is not None and brief.accepted is not None:
        raise ServiceError(ProblemCode.STAGE_CLOSED, f"The committee has decided about {team.name}'s brief already.")
    if brief is None:
        brief = Brief(**stage.place, team_id=team.id)
        session.add(brief)
    brief.content, brief.pages, brief.received_at = content, pages, now
    brief.sha256 = hashlib.sha256(content).hexdigest()
    session.flush()
    record(session, by, "brief.hand-in", f"team:{team.id}", {"stage": stage.subject, "sha256": brief.sha256})
    return brief


def list_briefs(session: Session, by: Principal, stage: Stage) -> Sequence[Brief]:
    """Return the briefs that somebody may see: the own team's, all for judges and organizers; in order of arrival."""
    _require_rules(stage)
    of_stage = select(Brief).where(*stage.make_rows(Brief))
    received = session.scalars(of_stage.order_by(Brief.received_at, Brief.team_id))
    return [brief for brief in received if by.may_see(brief.team_id, stage.competition)]


def find(session: Session, by: Principal, stage: Stage, team_id: UUID) -> Brief:
    """Return the brief of a team.

    Raises:
        ServiceError: there is none that this principal may see.
    """
    brief = session.get(Brief, _key(stage, team_id))
    if brief is None or not by.may_see(team_id, stage.competition):
        raise not_found("brief", team_id)
    return brief


def decide(session: Session, by: Principal, stage: Stage, team_id: UUID, reason: str, *, accepted: bool) -> Brief:
    """Note what the committee decided of a brief, once the stage has closed; again, it replaces the decision.

    Raises:
        ServiceError: no such brief that this principal may see, the stage is open, or the competition is final.
    """
    competition = Competition.lock(session, stage.competition)
    competition.require_not_final()
    stage.require_over()
    brief = find(session, by, stage, team_id)
    before = {"accepted": brief.accepted, "reason": brief.reason} if brief.decided_at else None
    brief.accepted, brief.reason, brief.decided_by, brief.decided_at = accepted, reason, by.actor, read_clock(session)
    session.flush()
    after = {"stage": stage.subject, "accepted": accepted, "reason": reason}
    record(session, by, "brief.decide", f"team:{team_id}", after, before=before)
    return brief


def is_accepted(session: Session, stage: Stage, team_id: UUID) -> bool:
    """Return whether the committee has accepted a team's brief of a stage."""
    brief = session.get(Brief, _key(stage, team_id))
    return brief is not None and brief.accepted is True


def brief_view(brief: Brief) -> BriefView:
    """Return a brief as its team, judges and organizers see it."""
    return BriefView.from_row(brief, team=brief.team.name)


def _key(stage: Stage, team_id: UUID) -> tuple[str, str, str, UUID]:
    return stage.competition, stage.track, stage.name, team_id


def _require_rules(stage: Stage) -> BriefRules:
    if stage.rules.brief is None:
        raise ServiceError(ProblemCode.UNKNOWN_STAGE, f"Stage {stage.name} of {stage.track} takes no briefs.")
    return stage.rules.brief


_OBJECT: Final = re.compile(rb"(?<![0-9])(\d{1,9})\s+\d{1,5}\s+obj\b")
_PAGE: Final = re.compile(rb"/Type\s*/Page(?![A-Za-z])")
_PACKED: Final = re.compile(rb"/Type\s*/ObjStm\b")
_UNPACKED_BYTES: Final = 16 << 20
"""Of all object streams together; those of a few pages have some kilobytes."""


def count_pages(data: bytes) -> int:
    """Return the number of pages; 0 of what is no PDF, is encrypted, or hides its pages in another way.

    Each byte is looked at a few times at most, whatever the file says of itself.
    """
    if not data.startswith(b"%PDF-") or b"/Encrypt" in data:
        return 0
    return len({number for number, content in _list_objects(data) if _PAGE.search(content)})


def _list_objects(data: bytes) -> Iterator[tuple[int, bytes]]:
    left = _UNPACKED_BYTES
    for part in data.split(b"endobj"):
        if (begin := _OBJECT.search(part)) is None:
            continue
        head, _, stream = part[begin.end() :].partition(b"stream")
        if not _PACKED.search(head):
            yield int(begin[1]), head
        elif first := re.search(rb"/First\s+(\d{1,9})", head):
            try:
                content = zlib.decompressobj().decompress(stream.lstrip(b"\r\n"), left) if left else b""
            except zlib.error:
                continue
            left -= len(content)
            yield from _list_packed(content, int(first[1]))


def _list_packed(content: bytes, first: int) -> Iterator[tuple[int, bytes]]:
    """Yield the objects of an object stream: numbers and places in pairs, in order, then the objects."""
    numbers = [int(word) for word in content[:first].split() if word.isdigit() and len(word) < 10]
    places = numbers[1::2]
    for number, begin, end in zip(numbers[::2], places, [*places[1:], len(content)], strict=False):
        if begin > end:
            return
        yield number, content[first + begin : first + end]
