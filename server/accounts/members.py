"""Members of teams: invited, joined, removed; who leads the team; how they sign in. Called by API, pages and CLI."""

import secrets
from collections.abc import Collection
from dataclasses import dataclass
from datetime import timedelta
from uuid import UUID

from sqlalchemy import ColumnElement, exists, func, select
from sqlalchemy.orm import Session

from .. import names
from ..audit import record
from ..database.clock import read_clock
from ..database.engine import Database
from ..database.models import ApiToken, Invitation, Member, Team
from ..database.states import MemberRole, NoticeKind, Role
from ..errors import ProblemCode, ServiceError, not_found
from ..principals import Principal
from ..views.teams import InvitationView, MemberView, NewInvitationView, OwnTeamView
from . import passwords, teams, tokens
from .outbox import MAX_CONFIRMATIONS, MAX_CONFIRMATIONS_OF_TEAM, ask_to_confirm
from .tokens import IssuedToken

CODE_PREFIX = "vitac-join-"
EMAIL_CODE_PREFIX = "vitac-mail-"
INVITATION_LIFETIME = timedelta(days=7)
FRESH_FOR = timedelta(minutes=15)
"""Time after a sign-in in which a password may be changed without the old one."""
MAX_MEMBERS = 50
"""Maximum members of a team, together with its open invitations."""
WRONG_PASSWORD = "No member of that name and team has this password."  # noqa: S105 - a sentence


@dataclass(frozen=True, kw_only=True)
class JoiningMember:
    """What somebody says who joins a team.

    Attributes:
        code: of the invitation.
        name: unique in the team.
        email: for notices.
        password_hash: of the password to sign in with on the pages; None: with the token only.
    """

    code: str
    name: str
    email: str | None = None
    password_hash: str | None = None


def invite(session: Session, by: Principal, team: Team, *, leads: bool = False) -> tuple[Invitation, str]:
    """Make a code with which one person joins a team; it is shown once.

    Args:
        session: of the transaction.
        by: the captain, or an organizer.
        team: which one.
        leads: whether that person leads the team, if nobody can act for it until then.

    Raises:
        ServiceError: not the captain, teams are locked, or the team is full.
    """
    by.require_leader(team.id)
    teams.require_unlocked(session, by)
    teams.lock(session, team)
    _require_room(session, team)
    code = CODE_PREFIX + secrets.token_urlsafe(24)
    made = Invitation(
        team=team,
        code_sha256=tokens.hash_secret(code),
        expires_at=read_clock(session) + INVITATION_LIFETIME,
        leads=leads,
    )
    session.add(made)
    session.flush()
    record(session, by, "member.invite", f"team:{team.id}", {"invitation": str(made.id)})
    return made, code


def withdraw_invitation(session: Session, by: Principal, team: Team, invitation_id: UUID) -> None:
    """End an invitation that nobody has used; doing it again changes nothing.

    Raises:
        ServiceError: not the captain, or the team has no such invitation, or it was used.
    """
    by.require_leader(team.id)
    invitation = session.get(Invitation, invitation_id, with_for_update=True)
    if invitation is None or invitation.team_id != team.id or invitation.used_at is not None:
        raise not_found("open invitation", invitation_id)
    if invitation.revoked_at is None:
        invitation.revoked_at = read_clock(session)
        record(session, by, "member.uninvite", f"team:{team.id}", {"invitation": str(invitation.id)})


def join(session: Session, new: JoiningMember, lifetime: timedelta) -> tuple[Member, IssuedToken]:
    """Make somebody with an invitation a member; `lifetime` is that of their token.

    Raises:
        ServiceError: the code is unknown, used or expired, teams are locked, or the name is taken or cannot be shown.
    """
    invitation = session.scalar(
        select(Invitation).where(Invitation.code_sha256 == tokens.hash_secret(new.code.strip())).with_for_update()
    )
    if (
        invitation is None
        or invitation.used_at
        or invitation.revoked_at
        or invitation.expires_at <= read_clock(session)
    ):
        raise ServiceError(
            ProblemCode.INVITE_REQUIRED, "This code is unknown, used or expired; ask the team's captain for a new one."
        )
    team = invitation.team
    teams.require_unlocked(session, None)
    teams.lock(session, team)
    shown = names.clean(new.name, what="A member's name", min_length=2, max_length=teams.NAME_LENGTH)
    key = teams.name_key(shown)
    if session.scalar(select(Member.id).where(Member.team_id == team.id, Member.name_key == key)) is not None:
        raise ServiceError(ProblemCode.NAME_TAKEN, f"{team.name} has or had a member named {shown!r}; choose another.")
    leads = invitation.leads and is_unclaimed(session, team)
    if leads:
        session.delete(find_captain(session, team))
        session.flush()
    member = Member(
        team=team,
        role=MemberRole.CAPTAIN if leads else MemberRole.MEMBER,
        name=shown,
        name_key=key,
        email=new.email,
        password_hash=new.password_hash,
    )
    session.add(member)
    invitation.used_at = read_clock(session)
    session.flush()
    _ask_to_confirm(session, member)
    by = Principal(role=Role.TEAM, team_id=team.id, team_name=team.name, member_id=member.id, member_name=shown)
    record(session, by, "member.join", f"member:{member.id}", {"name": shown, "invitation": str(invitation.id)})
    return member, tokens.issue_to_member(session, by, member, lifetime)


def is_unclaimed(session: Session, team: Team) -> bool:
    """Return whether nobody can act for a team yet: its captain is a name without token, password and address."""
    captain = find_captain(session, team)
    has_token = session.scalar(select(exists().where(ApiToken.team_id == team.id)))
    return captain.password_hash is None and captain.email is None and not has_token


def remove(session: Session, by: Principal, member: Member) -> None:
    """End a membership: by the member, the captain or an organizer. What they submitted stays the team's.

    Raises:
        ServiceError: somebody else asks, teams are locked, they have left already, or they lead the team.
    """
    if by.member_id != member.id:
        by.require_leader(member.team_id)
    _lock_present(session, by, member)
    if member.role is MemberRole.CAPTAIN:
        raise ServiceError(
            ProblemCode.INVALID_REQUEST, f"{member.name} is the captain. {_explain_handing_over(session, member)}"
        )
    tokens.end_tokens(session, by, member)
    member.left_at, member.password_hash, member.email = read_clock(session), None, None
    member.email_confirmed_at, member.email_code_sha256 = None, None
    action = "member.leave" if by.member_id == member.id else "member.remove"
    record(session, by, action, f"member:{member.id}", {"member": False}, before={"member": True, "name": member.name})


def _explain_handing_over(session: Session, captain: Member) -> str:
    others = [
        one.name for one in list_team_members(session, captain.team_id) if one.left_at is None and one.id != captain.id
    ]
    if not others:
        return "The team has no other member: invite one first, who then becomes the captain."
    return (
        f"Make another member the captain first ({', '.join(others)}): `vitac team captain NAME`, or the button on the "
        "page /team."
    )


def hand_over(session: Session, by: Principal, member: Member) -> None:
    """Make a member the captain, and the captain a member.

    Raises:
        ServiceError: not the captain, teams are locked, or they have left.
    """
    by.require_leader(member.team_id)
    _lock_present(session, by, member)
    old = find_captain(session, member.team)
    if old.id == member.id:
        return
    if not by.organizes_service and by.member_id not in {None, old.id}:  # somebody else was made the captain meanwhile
        raise ServiceError(ProblemCode.FORBIDDEN, f"{old.name} is the captain now; only the captain may do this.")
    old.role = MemberRole.MEMBER
    session.flush()
    member.role = MemberRole.CAPTAIN
    before, after = {"captain": old.name}, {"captain": member.name}
    record(session, by, "team.captain", f"team:{member.team_id}", after, before=before)


def _lock_present(session: Session, by: Principal, member: Member) -> None:
    """Lock the team of a member who is still in it, as long as teams may be changed."""
    teams.require_unlocked(session, by)
    teams.lock(session, member.team)
    session.refresh(member)
    if member.left_at is not None:
        raise not_found("member", member.id)


def renew_token(session: Session, by: Principal, member: Member, lifetime: timedelta) -> IssuedToken:
    """Give a member a new token in place of the one before.

    Raises:
        ServiceError: neither the member nor the captain without a token of their own nor an organizer asks.
    """
    _require_own(by, member)
    return tokens.issue_to_member(session, by, member, lifetime)


def set_password(
    database: Database, by: Principal, team_id: UUID, member_id: UUID, password: str | None, *, old: str | None = None
) -> None:
    """Set or (None) take away the password of a member; browsers that signed in with the old one are signed out.

    Args:
        database: of the members; no transaction is open while a hash is computed.
        by: who asks.
        team_id: of the member's team.
        member_id: whose password.
        password: the new one.
        old: the one before, unless they have none, have just signed in, or an organizer asks.

    Raises:
        ServiceError: as `renew_token`, the old one is wrong, or the new one is too short or too long.
    """
    with database.reading() as session:
        member = find(session, by, team_id, member_id)
        _require_own(by, member)
        stored, name, now = member.password_hash, member.name, read_clock(session)
    is_fresh = by.organizes_service or (by.signed_in_at is not None and now - by.signed_in_at < FRESH_FOR)
    if stored is not None and not is_fresh and not passwords.is_right(old or "", stored):
        raise ServiceError(
            ProblemCode.FORBIDDEN,
            f"{name} has a password: give it as the old one, or sign in again and change it within "
            f"{FRESH_FOR.seconds // 60} minutes.",
        )
    password_hash = passwords.hashed(password) if password is not None else None
    with database.transaction() as session:
        member = find(session, by, team_id, member_id)
        teams.lock(session, member.team)
        session.refresh(member)
        _require_own(by, member)
        if member.password_hash != stored:
            raise ServiceError(ProblemCode.FORBIDDEN, f"{name}'s password was changed meanwhile; try again.")
        member.password_hash = password_hash
        tokens.end_tokens(session, by, member, sessions_only=True)
        before, after = {"password": stored is not None}, {"password": password is not None}
        record(session, by, "member.password", f"member:{member.id}", after, before=before)


def set_email(session: Session, by: Principal, member: Member, email: str | None) -> None:
    """Set or (None) take away where a member gets notices; the address itself is not in the audit log.

    It gets a code, and nothing else before `confirm_email`. What an organizer sets is confirmed.

    Raises:
        ServiceError: as `renew_token`, or no further code may be sent.
    """
    _require_own(by, member)
    before = {"email": member.email is not None}
    if by.organizes_service:
        member.email, member.email_code_sha256 = email, None
        member.email_confirmed_at = read_clock(session) if email is not None else None
    elif email != member.email or member.email_confirmed_at is None:
        member.email, member.email_confirmed_at = email, None
        if not _ask_to_confirm(session, member):
            raise ServiceError(
                ProblemCode.TOO_MANY_REQUESTS,
                f"No code was sent to {email}, and nothing was changed: an address gets {MAX_CONFIRMATIONS} codes in "
                f"30 days, and a team has {MAX_CONFIRMATIONS_OF_TEAM} sent in a day. Use another address, or ask the "
                "organizers to set this one.",
            )
    record(session, by, "member.email", f"member:{member.id}", {"email": email is not None}, before=before)


def confirm_email(session: Session, by: Principal, member: Member, code: str) -> None:
    """Note that a member has read the code that was sent to their address.

    Raises:
        ServiceError: as `renew_token`, or it is not the code of the last e-mail.
    """
    _require_own(by, member)
    if member.email_code_sha256 is None or member.email_code_sha256 != tokens.hash_secret(code.strip()):
        raise ServiceError(
            ProblemCode.INVALID_REQUEST, "This is not the code of the last e-mail; set the address again for another."
        )
    member.email_confirmed_at, member.email_code_sha256 = read_clock(session), None
    record(session, by, "member.email_confirm", f"member:{member.id}", {"email": True}, before={"email": True})


def _ask_to_confirm(session: Session, member: Member) -> bool:
    """Send a code to a member's address, or forget the one before; return whether no limit of codes is reached."""
    code = EMAIL_CODE_PREFIX + secrets.token_urlsafe(12)
    member.email_code_sha256 = tokens.hash_secret(code) if member.email is not None else None
    return member.email is None or ask_to_confirm(session, member.team_id, member.email, code)


def mute(session: Session, by: Principal, member: Member, kinds: Collection[NoticeKind]) -> None:
    """Send a member no further e-mails of these kinds, and again those of all others.

    Raises:
        ServiceError: as `renew_token`.
    """
    _require_own(by, member)
    before = {"muted": list(member.muted)}
    member.muted = sorted({kind.value for kind in kinds})
    record(session, by, "member.mute", f"member:{member.id}", {"muted": member.muted}, before=before)


def sign_in(database: Database, team: str, name: str, password: str, lifetime: timedelta) -> ApiToken:
    """Begin the session of a browser with a member's password; no transaction is open while its hash is computed.

    Raises:
        ServiceError: no member of that name and team has this password.
    """
    wanted = Team.name_key == teams.name_key(team), Member.name_key == teams.name_key(name), Member.left_at.is_(None)
    with database.reading() as session:
        row = session.execute(select(Member.id, Member.password_hash).join(Team).where(*wanted)).one_or_none()
    if not passwords.is_right(password, row.password_hash if row is not None else None) or row is None:
        raise ServiceError(ProblemCode.INVALID_CREDENTIALS, WRONG_PASSWORD)
    with database.transaction() as session:
        member = session.get_one(Member, row.id, with_for_update=True)
        if member.password_hash != row.password_hash:  # changed meanwhile, or they have left
            raise ServiceError(ProblemCode.INVALID_CREDENTIALS, WRONG_PASSWORD)
        return tokens.begin_session(session, member, lifetime)


def find(session: Session, by: Principal, team_id: UUID, member_id: UUID) -> Member:
    """Return a member of a team.

    Raises:
        ServiceError: there is none that the principal may see.
    """
    member = session.get(Member, member_id)
    if member is None or member.team_id != team_id or not by.may_change(team_id):
        raise not_found("member", member_id)
    return member


def find_captain(session: Session, team: Team) -> Member:
    """Return who leads a team."""
    leads = Member.team_id == team.id, Member.role == MemberRole.CAPTAIN, Member.left_at.is_(None)
    return session.scalars(select(Member).where(*leads)).one()


def list_team_members(session: Session, team_id: UUID) -> list[Member]:
    """Return the members of a team, also those who have left, in the order in which they joined."""
    return list(session.scalars(select(Member).where(Member.team_id == team_id).order_by(Member.joined_at, Member.id)))


def own_team_view(session: Session, by: Principal, team: Team) -> OwnTeamView:
    """Return a team as its members and organizers see it.

    Raises:
        ServiceError: somebody else asks.
    """
    if not by.may_change(team.id):
        raise not_found("team", team.id)
    usable = select(Invitation).where(*_usable(team)).order_by(Invitation.created_at, Invitation.id)
    return OwnTeamView(
        **dict(teams.organizer_team_view(session, team)),
        members=[_member_view(member) for member in list_team_members(session, team.id)],
        invitations=[
            InvitationView.model_validate(invitation, from_attributes=True) for invitation in session.scalars(usable)
        ],
    )


def new_invitation_view(made: Invitation, code: str) -> NewInvitationView:
    """Return a new invitation with its code."""
    return NewInvitationView.from_row(made, code=code)


def _member_view(member: Member) -> MemberView:
    return MemberView.from_row(
        member,
        email_confirmed=member.email_confirmed_at is not None,
        has_password=member.password_hash is not None,
        muted=[NoticeKind(kind) for kind in member.muted],
    )


def _require_own(by: Principal, member: Member) -> None:
    """Refuse everybody but the member and organizers; whoever leads a team by its shared token is its captain."""
    is_captain = by.member_id is None and by.leads_team and member.role is MemberRole.CAPTAIN
    if member.left_at is not None or not by.may_change(member.team_id):
        raise not_found("member", member.id)
    if not (by.organizes_service or by.member_id == member.id or is_captain):
        raise ServiceError(ProblemCode.FORBIDDEN, f"Only {member.name} and organizers may do this.")


def _usable(team: Team) -> tuple[ColumnElement[bool], ...]:
    return (
        Invitation.team_id == team.id,
        Invitation.used_at.is_(None),
        Invitation.revoked_at.is_(None),
        Invitation.expires_at > func.now(),
    )


def _require_room(session: Session, team: Team) -> None:
    present = select(func.count()).where(Member.team_id == team.id, Member.left_at.is_(None))
    invited = select(func.count()).select_from(Invitation).where(*_usable(team))
    if (session.scalar(present) or 0) + (session.scalar(invited) or 0) >= MAX_MEMBERS:
        raise ServiceError(
            ProblemCode.INVALID_REQUEST, f"{team.name} has {MAX_MEMBERS} members and invitations, no more are possible."
        )
