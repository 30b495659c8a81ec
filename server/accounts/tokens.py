"""API tokens: made from 256 random bits, shown once, kept as SHA-256, with expiry and revocation."""

import hashlib
import re
import secrets
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from uuid import UUID

from sqlalchemy import ColumnElement, select
from sqlalchemy.orm import Session, joinedload
from vitac.server.accounts.audit import record
from vitac.server.db.models import ApiToken, Team
from vitac.server.db.states import Role
from vitac.server.errors import ProblemCode, ServiceError, not_found

from ..views.accounts import NewTokenView, TokenView
from . import names
from .principals import Principal

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
    lifetime: timedelta | None,
) -> IssuedToken:
    """Make a token for a team, or for an organizer or judge (no team).

    Raises:
        ServiceError: the principal may not give such a token, or the label cannot be shown.
    """
    label = names.clean(label, what="A token's label", min_length=1, max_length=LABEL_LENGTH)
    if not by.is_organizer and (role is not Role.TEAM or team is None or by.team_id != team.id):
        raise ServiceError(ProblemCode.FORBIDDEN, "A team may make tokens for itself only; ask an organizer.")
    secret = PREFIX + secrets.token_urlsafe(SECRET_BYTES)
    token = ApiToken(
        role=role,
        team=team,
        label=label,
        secret_sha256=hash_secret(secret),
        created_at=datetime.now(UTC),
        expires_at=datetime.now(UTC) + lifetime if lifetime is not None else None,
    )
    session.add(token)
    session.flush()
    record(session, by, "token.issue", f"token:{token.id}", {"role": role.value, "label": label})
    return IssuedToken(token=token, secret=secret)


def authenticate(session: Session, secret: str) -> Principal:
    """Return the principal behind a secret.

    Raises:
        ServiceError: unknown, expired or revoked; the three are told apart, since only the holder can see the answer.
    """
    if not SECRET_PATTERN.fullmatch(secret):
        raise ServiceError(
            ProblemCode.INVALID_CREDENTIALS,
            f"Expected a token of {PREFIX} and 43 letters, digits, - or _, got another form. Copy it again.",
        )
    return _principal(_find(session, ApiToken.secret_sha256 == hash_secret(secret)))


def principal_of_token_id(session: Session, token_id: UUID) -> Principal:
    """Return the principal of a token that was shown earlier (page sessions keep the id only); same checks.

    Raises:
        ServiceError: unknown, expired or revoked.
    """
    return _principal(_find(session, ApiToken.id == token_id))


def list_tokens(session: Session, by: Principal) -> list[ApiToken]:
    """Return the tokens of the principal's team, all for an organizer, a judge's own one; newest first."""
    query = select(ApiToken).options(joinedload(ApiToken.team)).order_by(ApiToken.created_at.desc(), ApiToken.id)
    if not by.is_organizer:
        own = ApiToken.id == by.token_id if by.team_id is None else ApiToken.team_id == by.team_id
        query = query.where(own)
    return list(session.scalars(query))


def revoke(session: Session, by: Principal, token_id: UUID) -> None:
    """End a token at once; ending it again changes nothing.

    Raises:
        ServiceError: there is no such token that the principal may see.
    """
    token = session.get(ApiToken, token_id, with_for_update=True)
    if token is None or not (by.is_organizer or (token.team_id is not None and token.team_id == by.team_id)):
        raise not_found("token", token_id)
    if token.revoked_at is None:
        token.revoked_at = datetime.now(UTC)
        record(session, by, "token.revoke", f"token:{token.id}", {"label": token.label})


def token_view(token: ApiToken) -> TokenView:
    """Return a token as it is shown, without its secret."""
    return TokenView(
        id=token.id,
        label=token.label,
        role=token.role,
        team=token.team.name if token.team is not None else None,
        created_at=token.created_at,
        expires_at=token.expires_at,
        revoked_at=token.revoked_at,
        last_used_at=token.last_used_at,
    )


def new_token_view(issued: IssuedToken) -> NewTokenView:
    """Return a new token with its secret."""
    return NewTokenView(**token_view(issued.token).model_dump(), secret=issued.secret)


def hash_secret(secret: str) -> str:
    """Return what is kept of a secret: a plain hash is enough for 256 random bits."""
    return hashlib.sha256(secret.encode()).hexdigest()


def _find(session: Session, condition: ColumnElement[bool]) -> ApiToken | None:
    return session.scalar(select(ApiToken).options(joinedload(ApiToken.team)).where(condition))


def _principal(token: ApiToken | None) -> Principal:
    now = datetime.now(UTC)
    if token is None:
        raise ServiceError(ProblemCode.INVALID_CREDENTIALS, "This token is not known here. Check server and token.")
    if token.revoked_at is not None:
        raise ServiceError(ProblemCode.INVALID_CREDENTIALS, f"This token was revoked at {token.revoked_at:%F %T} UTC.")
    if token.expires_at is not None and token.expires_at <= now:
        raise ServiceError(
            ProblemCode.INVALID_CREDENTIALS, f"This token expired at {token.expires_at:%F %T} UTC. Ask for a new one."
        )
    if token.last_used_at is None or token.last_used_at < now - USE_NOTED_EVERY:
        token.last_used_at = now
    return Principal(
        role=token.role,
        team_id=token.team_id,
        team_name=token.team.name if token.team is not None else None,
        token_id=token.id,
    )
