"""API tokens: made from 256 random bits, shown once, stored as SHA-256, with expiry and revocation."""

import hashlib
import re
import secrets
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import timedelta
from functools import cache
from typing import Any
from uuid import UUID

from sqlalchemy import ColumnElement, Row, Select, case, exists, func, or_, select, update
from sqlalchemy.orm import Session, aliased, joinedload

from .. import names
from ..audit import record
from ..competitions.competition import Competition
from ..database.clock import read_clock
from ..database.models import ApiToken, Member, Team
from ..database.states import MemberRole, Role
from ..errors import ProblemCode, ServiceError, not_found
from ..principals import Principal
from ..views.teams import NewTokenView, TokenView

PREFIX = "vitac_"
SECRET_BYTES = 32
SECRET_PATTERN = re.compile(r"vitac_[A-Za-z0-9_-]{43}")
LABEL_LENGTH = 64
USE_NOTED_EVERY = timedelta(minutes=1)


@dataclass(frozen=True, kw_only=True)
class IssuedToken:
    """A new token with its secret, which nobody can read again."""

    token: ApiToken
    secret: str


def issue(
    session: Session,
    by: Principal,
    *,
    role: Role,
    label: str,
    team: Team | None = None,
    competition: str | None = None,
    lifetime: timedelta | None,
) -> IssuedToken:
    """Make a token that a team shares, or for an organizer or judge (no team).

    The label of a judge's token is the judge's name: a new token after the old one has ended is the same judge's.
    `competition` is the only competition that an organizer's token is for.

    Raises:
        ServiceError: the principal may not give such a token, the label cannot be shown, there is a good token of that
            judge, or no such competition.
    """
    label = names.clean(label, what="A token's label", min_length=1, max_length=LABEL_LENGTH)
    if not by.organizes_service and (role is not Role.TEAM or team is None or by.team_id != team.id):
        raise ServiceError(ProblemCode.FORBIDDEN, "A team may make tokens for itself only; ask an organizer.")
    if team is not None:
        by.require_leader(team.id)
    if role is Role.JUDGE:
        label = judge_named(session, label)
        _refuse_second_judge(session, label)
    if competition is not None:
        Competition.find(session, competition)
    return _add(session, by, ApiToken(role=role, team=team, label=label, competition=competition), lifetime)


def judge_named(session: Session, name: str) -> str:
    """Return the name of the judge with a token whose name differs in case and spaces at most, else the name itself.

    Raises:
        ServiceError: the name cannot be shown.
    """
    shown = names.clean(name, what="A judge's name", min_length=1, max_length=LABEL_LENGTH)
    return next((label for label in _judges(session) if _same_name(label, shown)), shown)


def is_judge(session: Session, name: str) -> bool:
    """Return whether there is or was a token of a judge of that name."""
    return any(_same_name(label, name) for label in _judges(session))


def _judges(session: Session) -> Iterable[str]:
    return session.scalars(select(ApiToken.label).where(ApiToken.role == Role.JUDGE).order_by(ApiToken.created_at))


def _same_name(one: str, other: str) -> bool:
    return names.key(one, max_length=LABEL_LENGTH) == names.key(other, max_length=LABEL_LENGTH)


def _refuse_second_judge(session: Session, label: str) -> None:
    is_good = (
        ApiToken.revoked_at.is_(None),
        or_(ApiToken.expires_at.is_(None), ApiToken.expires_at > read_clock(session)),
    )
    other = session.scalar(
        select(ApiToken.id).where(ApiToken.role == Role.JUDGE, ApiToken.label == label, *is_good).limit(1)
    )
    if other is not None:
        raise ServiceError(
            ProblemCode.NAME_TAKEN,
            f"There is a judge named {label!r} with the token {other}. Give another judge another name, or end that "
            "token first.",
        )


def issue_to_member(session: Session, by: Principal, member: Member, lifetime: timedelta) -> IssuedToken:
    """Give a member a token of their own in place of the one before, which ends; the caller says who may ask."""
    for old in session.scalars(
        select(ApiToken).where(
            ApiToken.member_id == member.id, ApiToken.revoked_at.is_(None), ApiToken.is_session.is_(False)
        )
    ):
        _end(session, by, old)
    session.flush()
    return _add(session, by, ApiToken(role=Role.TEAM, team=member.team, member=member, label=member.name), lifetime)


def begin_session(session: Session, member: Member, lifetime: timedelta) -> ApiToken:
    """Note that a browser signed in with a member's password; ending it signs the browser out."""
    by = Principal(role=Role.TEAM, team_id=member.team_id, team_name=member.team.name, member_name=member.name)
    made = ApiToken(role=Role.TEAM, team=member.team, member=member, label="signed in with password", is_session=True)
    return _add(session, by, made, lifetime).token


def end_session(session: Session, by: Principal) -> None:
    """End the session of a browser that signed in with a password; a token that signed in stays valid."""
    token = session.get_one(ApiToken, by.token_id)
    if token.is_session:
        revoke(session, by, token.id)


def end_tokens(session: Session, by: Principal, member: Member, *, sessions_only: bool = False) -> None:
    """End a member's sessions, and unless only these are meant the member's token."""
    query = select(ApiToken).where(ApiToken.member_id == member.id, ApiToken.revoked_at.is_(None))
    for token in session.scalars(query.where(ApiToken.is_session) if sessions_only else query):
        _end(session, by, token)


def _add(session: Session, by: Principal, token: ApiToken, lifetime: timedelta | None) -> IssuedToken:
    """Add a token with a new secret."""
    secret = PREFIX + secrets.token_urlsafe(SECRET_BYTES)
    token.secret_sha256 = hash_secret(secret)
    token.created_at = read_clock(session)
    token.expires_at = token.created_at + lifetime if lifetime is not None else None
    session.add(token)
    session.flush()
    after = {"role": token.role.value, "label": token.label} | (
        {"competition": token.competition} if token.competition else {}
    )
    record(session, by, "token.issue", f"token:{token.id}", after)
    return IssuedToken(token=token, secret=secret)


def authenticate(session: Session, secret: str) -> Principal:
    """Return the principal behind a secret.

    Raises:
        ServiceError: unknown, expired or revoked; the answer says which, since only the holder can see it.
    """
    if not SECRET_PATTERN.fullmatch(secret):
        raise ServiceError(
            ProblemCode.INVALID_CREDENTIALS,
            f"Expected a token of {PREFIX} and 43 letters, digits, - or _, got another form. Copy it again.",
        )
    return _principal(session, _find(session, ApiToken.secret_sha256 == hash_secret(secret)))


def principal_of_token_id(session: Session, token_id: UUID) -> Principal:
    """Return the principal of a token that was shown earlier (page sessions keep the id only); same checks.

    Raises:
        ServiceError: unknown, expired or revoked.
    """
    return _principal(session, _find(session, ApiToken.id == token_id))


def list_tokens(session: Session, by: Principal) -> list[ApiToken]:
    """Return the tokens and sessions that the principal may end; newest first.

    An organizer's are all, a captain's those of the team, a member's those of their own; a judge sees their own one.
    """
    query = (
        select(ApiToken)
        .options(joinedload(ApiToken.team), joinedload(ApiToken.member))
        .order_by(ApiToken.created_at.desc(), ApiToken.id)
    )
    return list(session.scalars(query if by.organizes_service else query.where(_own(by))))


def _own(by: Principal) -> ColumnElement[bool]:
    if by.team_id is None or (by.member_id is None and not by.leads_team):
        return ApiToken.id == by.token_id
    return ApiToken.team_id == by.team_id if by.leads_team else ApiToken.member_id == by.member_id


def revoke(session: Session, by: Principal, token_id: UUID) -> ApiToken:
    """End a token or session at once, and return it; ending it again changes nothing.

    Raises:
        ServiceError: there is no such token that the principal may end.
    """
    query = select(ApiToken).where(ApiToken.id == token_id).with_for_update()
    token = session.scalar(query if by.organizes_service else query.where(_own(by), ApiToken.role == Role.TEAM))
    if token is None:
        raise not_found("token", token_id)
    if token.revoked_at is None:
        _end(session, by, token)
    return token


def _end(session: Session, by: Principal, token: ApiToken) -> None:
    token.revoked_at = read_clock(session)
    record(session, by, "token.revoke", f"token:{token.id}", {"label": token.label})


def token_view(token: ApiToken) -> TokenView:
    """Return a token as it is shown, without its secret."""
    return TokenView.from_row(
        token,
        team=token.team.name if token.team is not None else None,
        member=token.member.name if token.member is not None else None,
    )


def new_token_view(issued: IssuedToken) -> NewTokenView:
    """Return a new token with its secret."""
    return NewTokenView(**token_view(issued.token).model_dump(), secret=issued.secret)


def hash_secret(secret: str) -> str:
    """Return what is stored of a secret: a plain hash is enough for 256 random bits."""
    return hashlib.sha256(secret.encode()).hexdigest()


def _find(session: Session, condition: ColumnElement[bool]) -> Row[*tuple[Any, ...]] | None:
    return session.execute(_holders().where(condition)).one_or_none()


@cache
def _holders() -> Select[*tuple[Any, ...]]:
    """Return the query of tokens with all that is asked of who holds one; put together once, as every request asks."""
    others = aliased(ApiToken)
    captain_signs_in = exists().where(
        Member.team_id == ApiToken.team_id,
        Member.role == MemberRole.CAPTAIN,
        Member.left_at.is_(None),
        Member.password_hash.is_not(None) | exists().where(others.member_id == Member.id),
    )
    holder = aliased(Member)
    return (
        select(
            ApiToken.id,
            ApiToken.role,
            ApiToken.label,
            ApiToken.competition,
            ApiToken.revoked_at,
            ApiToken.expires_at,
            ApiToken.last_used_at,
            ApiToken.team_id,
            Team.name.label("team_name"),
            Team.pseudonym.label("team_pseudonym"),
            ApiToken.member_id,
            holder.name.label("member_name"),
            # It is the captain's, or shared by a team whose captain has never had a token or a password.
            case(
                (ApiToken.member_id.is_not(None), holder.role == MemberRole.CAPTAIN),
                (ApiToken.team_id.is_not(None), ~captain_signs_in),
                else_=False,
            ).label("leads_team"),
            func.clock_timestamp().label("now"),
        )
        .outerjoin(Team, Team.id == ApiToken.team_id)
        .outerjoin(holder, holder.id == ApiToken.member_id)
    )


def _principal(session: Session, token: Row[*tuple[Any, ...]] | None) -> Principal:
    if token is None:
        raise ServiceError(ProblemCode.INVALID_CREDENTIALS, "This token is not known here. Check server and token.")
    if token.revoked_at is not None:
        raise ServiceError(ProblemCode.INVALID_CREDENTIALS, f"This token was revoked at {token.revoked_at:%F %T} UTC.")
    if token.expires_at is not None and token.expires_at <= token.now:
        raise ServiceError(
            ProblemCode.INVALID_CREDENTIALS, f"This token expired at {token.expires_at:%F %T} UTC. Ask for a new one."
        )
    if token.last_used_at is None or token.last_used_at < token.now - USE_NOTED_EVERY:
        session.execute(update(ApiToken).where(ApiToken.id == token.id).values(last_used_at=token.now))
    return Principal(
        role=token.role,
        team_id=token.team_id,
        team_name=token.team_name,
        team_pseudonym=token.team_pseudonym,
        token_id=token.id,
        member_id=token.member_id,
        member_name=token.member_name,
        leads_team=token.leads_team,
        judge_name=token.label if token.role is Role.JUDGE else None,
        competition=token.competition,
    )
