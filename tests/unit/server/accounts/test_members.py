from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import cast

import pytest
from argon2 import PasswordHasher
from service_factories import make_principal, make_secret
from sqlalchemy import select
from sqlalchemy.orm import Session
from sqlalchemy.pool import QueuePool
from submission_steps import refused
from vitac.server.accounts import members, outbox, passwords, teams, tokens
from vitac.server.accounts.members import JoiningMember
from vitac.server.accounts.outbox import announce
from vitac.server.audit import newest_entries
from vitac.server.database.engine import Database
from vitac.server.database.models import Invitation, Member, Notice
from vitac.server.database.states import MemberRole, NoticeKind
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.principals import CONSOLE, Principal

from competitions import make_competition, put_in_place

WEEK = timedelta(days=7)
PASSWORD = "correct horse battery"  # noqa: S105 - made up


@pytest.fixture(autouse=True)
def quick_hashes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(passwords, "_HASHER", PasswordHasher(time_cost=1, memory_cost=8, parallelism=1))


def set_password(database: Database, by: Principal, member: Member, password: str | None, old: str = "") -> None:
    members.set_password(database, by, member.team_id, member.id, password, old=old)


def joined(session: Session, team: Principal, name: str = "Ann", **values: str) -> tuple[Member, Principal]:
    """A new member of a team, and who asks with their token."""
    _, code = members.invite(session, CONSOLE, teams.own(session, team))
    member, issued = members.join(session, JoiningMember(code=code, name=name, **values), WEEK)
    return member, tokens.authenticate(session, issued.secret)


def test_who_has_an_invitation_joins_once_with_a_token_of_their_own(database: Database) -> None:
    with database.transaction() as session:
        team = make_principal(session)
        made, code = members.invite(session, team, teams.own(session, team))
        assert code not in {made.code_sha256, str(made.id)}
        member, issued = members.join(session, JoiningMember(code=f" {code}\n", name=" Ann  Lee "), WEEK)
        by = tokens.authenticate(session, issued.secret)
        assert (member.name, member.role, by.member_id, by.leads_team) == (
            "Ann Lee",
            MemberRole.MEMBER,
            member.id,
            False,
        )
        assert (by.actor, by.account) == ("team:Team A/Ann Lee", "team:Team A")
        assert by.may_see(member.team_id)
        view = members.own_team_view(session, by, member.team)
        assert ({one.name for one in view.members}, view.invitations) == ({"Captain", "Ann Lee"}, [])
        for wrong in (code, "vitac-join-unknown", ""):
            with refused(ProblemCode.INVITE_REQUIRED):
                members.join(session, JoiningMember(code=wrong, name="Bob"), WEEK)
        assert newest_entries(session, 1, action="member.join")[0].actor == "team:Team A/Ann Lee"


def test_an_invitation_ends_by_time_and_by_the_captain(database: Database) -> None:
    with database.transaction() as session:
        team = make_principal(session)
        own = teams.own(session, team)
        late, late_code = members.invite(session, team, own)
        late.expires_at = datetime.now(UTC)
        ended, ended_code = members.invite(session, team, own)
        for _ in range(2):
            members.withdraw_invitation(session, team, own, ended.id)
        for code in (late_code, ended_code):
            with refused(ProblemCode.INVITE_REQUIRED):
                members.join(session, JoiningMember(code=code, name="Bob"), WEEK)
        other = make_principal(session, "Team B")
        with refused(ProblemCode.NOT_FOUND):
            members.withdraw_invitation(session, other, teams.own(session, other), ended.id)


def test_only_the_captain_and_organizers_invite_remove_and_hand_over(database: Database) -> None:
    with database.transaction() as session:
        team = make_principal(session)
        ann, by_ann = joined(session, team)
        bob, _ = joined(session, team, "Bob")
        captain = members.find_captain(session, ann.team)
        for forbidden in (
            lambda: members.invite(session, by_ann, ann.team),
            lambda: members.remove(session, by_ann, bob),
            lambda: members.hand_over(session, by_ann, ann),
            lambda: members.renew_token(session, by_ann, captain, WEEK),
        ):
            with refused(ProblemCode.FORBIDDEN):
                forbidden()
        with refused(ProblemCode.NOT_FOUND):
            members.invite(session, make_principal(session, "Team B"), ann.team)
        members.hand_over(session, team, ann)
        assert (ann.role, captain.role) == (MemberRole.CAPTAIN, MemberRole.MEMBER)
        found = newest_entries(session, 1)[0]
        assert (found.action, found.before, found.after) == ("team.captain", {"captain": "Captain"}, {"captain": "Ann"})
        with refused(ProblemCode.INVALID_REQUEST):
            members.remove(session, CONSOLE, ann)


def test_of_two_changes_of_captain_at_once_the_second_is_refused(database: Database) -> None:
    with database.transaction() as session:
        team = make_principal(session)
        ann, _ = joined(session, team)
        bob, _ = joined(session, team, "Bob")
        captain = members.find_captain(session, ann.team)
        asked_twice = replace(team, member_id=captain.id, leads_team=True)  # both requests were let in as the captain's
        members.hand_over(session, asked_twice, ann)
        with pytest.raises(ServiceError, match="Ann is the captain now"):
            members.hand_over(session, asked_twice, bob)
        assert members.find_captain(session, ann.team).id == ann.id


def test_a_captain_who_wants_to_leave_reads_how_to_hand_over(database: Database) -> None:
    with database.transaction() as session:
        team = make_principal(session)
        captain = members.find_captain(session, teams.own(session, team))
        with pytest.raises(ServiceError, match="no other member: invite one first"):
            members.remove(session, CONSOLE, captain)
        joined(session, team)
        with pytest.raises(ServiceError, match=r"captain first \(Ann\): `vitac team captain NAME`"):
            members.remove(session, CONSOLE, captain)


def test_a_shared_token_leads_the_team_until_its_captain_has_one(database: Database) -> None:
    with database.transaction() as session:
        team = make_principal(session)
        secret = make_secret(session, team)
        assert tokens.authenticate(session, secret).leads_team
        captain = members.find_captain(session, teams.own(session, team))
        own = members.renew_token(session, tokens.authenticate(session, secret), captain, WEEK)
        assert tokens.authenticate(session, own.secret).leads_team
        shared = tokens.authenticate(session, secret)
        assert (shared.leads_team, shared.team_id) == (False, team.team_id)
        assert [token.id for token in tokens.list_tokens(session, shared)] == [shared.token_id]
        with refused(ProblemCode.NOT_FOUND):
            tokens.revoke(session, shared, own.token.id)


def test_a_member_has_one_token_and_who_leaves_has_none(database: Database) -> None:
    with database.transaction() as session:
        team = make_principal(session)
        ann, by_ann = joined(session, team, email="ann@example.org", password_hash=passwords.hashed(PASSWORD))
    members.sign_in(database, "team a", "ANN", PASSWORD, WEEK)
    with database.transaction() as session:
        ann = session.get_one(Member, ann.id)
        renewed = members.renew_token(session, by_ann, ann, WEEK)
        assert by_ann.token_id is not None
        with refused(ProblemCode.INVALID_CREDENTIALS):
            tokens.principal_of_token_id(session, by_ann.token_id)
        assert len(tokens.list_tokens(session, by_ann)) == 3
        members.remove(session, by_ann, ann)
        with refused(ProblemCode.INVALID_CREDENTIALS):
            tokens.authenticate(session, renewed.secret)
        assert all(token.revoked_at for token in tokens.list_tokens(session, by_ann))
        assert (ann.email, ann.password_hash) == (None, None)
        with refused(ProblemCode.NOT_FOUND):
            members.remove(session, team, ann)
        _, code = members.invite(session, team, ann.team)
        with refused(ProblemCode.NAME_TAKEN):
            members.join(session, JoiningMember(code=code, name="ann"), WEEK)
    with refused(ProblemCode.INVALID_CREDENTIALS):
        members.sign_in(database, "Team A", "Ann", PASSWORD, WEEK)


def test_a_password_begins_a_session_that_can_be_ended(database: Database) -> None:
    with database.transaction() as session:
        ann, by_ann = joined(session, make_principal(session), password_hash=passwords.hashed(PASSWORD))
        assert PASSWORD not in (ann.password_hash or "")
    begun = members.sign_in(database, " TEAM  A", "ann", PASSWORD, WEEK)
    with database.transaction() as session:
        assert tokens.principal_of_token_id(session, begun.id).member_id == ann.id
    for team, name, password in (
        ("Team A", "Ann", PASSWORD.upper()),
        ("Team A", "Captain", ""),
        ("Team B", "Ann", PASSWORD),
        ("Team A", "Ann", "x" * 10_000),
    ):
        with refused(ProblemCode.INVALID_CREDENTIALS):
            members.sign_in(database, team, name, password, WEEK)
    set_password(database, by_ann, ann, PASSWORD + "!", old=PASSWORD)
    with database.transaction() as session, refused(ProblemCode.INVALID_CREDENTIALS):
        tokens.principal_of_token_id(session, begun.id)
    again = members.sign_in(database, "Team A", "Ann", PASSWORD + "!", WEEK)
    with database.transaction() as session:
        tokens.revoke(session, by_ann, again.id)
        with refused(ProblemCode.INVALID_CREDENTIALS):
            tokens.principal_of_token_id(session, again.id)
    for wrong in ("short", "x" * 257):
        with refused(ProblemCode.INVALID_REQUEST):
            set_password(database, by_ann, ann, wrong, old=PASSWORD + "!")
    set_password(database, by_ann, ann, None, old=PASSWORD + "!")
    with refused(ProblemCode.INVALID_CREDENTIALS):
        members.sign_in(database, "Team A", "Ann", PASSWORD + "!", WEEK)


def test_a_password_is_changed_with_the_old_one_or_soon_after_signing_in(database: Database) -> None:
    with database.transaction() as session:
        team = make_principal(session)
        ann, by_ann = joined(session, team)
        _, by_bob = joined(session, team, "Bob")
    set_password(database, by_ann, ann, PASSWORD)
    long_ago = replace(by_ann, signed_in_at=datetime.now(UTC) - members.FRESH_FOR)
    for by, old in ((by_ann, ""), (by_ann, PASSWORD + "!"), (long_ago, ""), (by_bob, PASSWORD)):
        with refused(ProblemCode.FORBIDDEN):
            set_password(database, by, ann, PASSWORD + "?", old=old)
    set_password(database, replace(by_ann, signed_in_at=datetime.now(UTC)), ann, PASSWORD + "!")
    set_password(database, long_ago, ann, PASSWORD + "?", old=PASSWORD + "!")
    set_password(database, CONSOLE, ann, None)


def test_no_transaction_is_open_while_a_password_is_checked(
    database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    with database.transaction() as session:
        ann, by_ann = joined(session, make_principal(session), password_hash=passwords.hashed(PASSWORD))
    is_right, in_use = passwords.is_right, list[int]()

    def noted(password: str, stored: str | None) -> bool:
        in_use.append(cast(QueuePool, database.engine.pool).checkedout())
        return is_right(password, stored)

    monkeypatch.setattr(passwords, "is_right", noted)
    members.sign_in(database, "Team A", "Ann", PASSWORD, WEEK)
    set_password(database, by_ann, ann, None, old=PASSWORD)
    assert in_use == [0, 0]


@pytest.mark.parametrize("name", ["Ann\0", "\0 ANN", "ann\0\0", " \0Ann\0 "])
def test_a_nul_finds_the_same_member_and_counts_towards_the_same_limit(database: Database, name: str) -> None:
    assert teams.name_key(name) == teams.name_key("Ann")
    with database.transaction() as session:
        ann, _ = joined(session, make_principal(session), password_hash=passwords.hashed(PASSWORD))
    assert members.sign_in(database, "Team\0A", name, PASSWORD, WEEK).member_id == ann.id


def test_the_lock_date_holds_for_all_but_organizers(database: Database) -> None:
    with database.transaction() as session:
        team = make_principal(session)
        own = teams.own(session, team)
        ann, by_ann = joined(session, team)
        _, code = members.invite(session, team, own)
        put_in_place(session, make_competition(teams_locked=(datetime.now(UTC) - timedelta(seconds=1)).isoformat()))
        for locked in (
            lambda: members.invite(session, team, own),
            lambda: members.join(session, JoiningMember(code=code, name="Bob"), WEEK),
            lambda: members.remove(session, by_ann, ann),
            lambda: members.hand_over(session, team, ann),
        ):
            with refused(ProblemCode.REGISTRATION_CLOSED):
                locked()
        members.invite(session, CONSOLE, own)
        members.hand_over(session, CONSOLE, ann)
        assert members.find_captain(session, own).id == ann.id


def test_a_team_has_room_for_so_many(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(members, "MAX_MEMBERS", 2)
    with database.transaction() as session:
        team = make_principal(session)
        members.invite(session, team, teams.own(session, team))
        with refused(ProblemCode.INVALID_REQUEST):
            members.invite(session, team, teams.own(session, team))
        session.query(Invitation).delete()
        members.invite(session, team, teams.own(session, team))


def test_an_address_gets_a_code_and_nothing_else_before_it_is_confirmed(database: Database) -> None:
    with database.transaction() as session:
        team = make_principal(session)
        ann, by_ann = joined(session, team, email="ann@example.org")
        announce(session, NoticeKind.ANNOUNCEMENT, ann.team_id, "announcement:1", {})
        code = session.scalars(select(Notice)).one().facts["code"]
        for wrong in ("", f"{code}x"):
            with refused(ProblemCode.INVALID_REQUEST):
                members.confirm_email(session, by_ann, ann, wrong)
        with refused(ProblemCode.FORBIDDEN):
            members.confirm_email(session, joined(session, team, "Bob")[1], ann, code)
        members.confirm_email(session, by_ann, ann, f" {code} ")
        announce(session, NoticeKind.ANNOUNCEMENT, ann.team_id, "announcement:2", {})
        assert session.scalars(select(Notice.subject).where(Notice.kind != NoticeKind.CONFIRMATION)).all() == [
            "announcement:2"
        ]
        members.set_email(session, by_ann, ann, "other@example.org")
        assert ann.email_confirmed_at is None


def test_one_address_gets_few_mails_of_all_teams_however_it_is_written(
    database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(outbox, "MAX_MAILS_A_DAY_TO_ONE", 5)
    forms = ("victim@example.org", "Victim@Example.ORG", "victim+1@example.org")
    with database.transaction() as session:
        for name, form in zip(("Ants", "Bees", "Cats"), forms, strict=True):
            ann, by_ann = joined(session, make_principal(session, name))
            members.set_email(session, by_ann, ann, form)
        assert len(session.scalars(select(Notice)).all()) == outbox.MAX_CONFIRMATIONS
        for form in (*forms, "VICTIM+2@example.org"):
            with refused(ProblemCode.TOO_MANY_REQUESTS):
                members.set_email(session, by_ann, ann, form)
        ann.email_confirmed_at = datetime.now(UTC)
        for number in range(4):
            announce(session, NoticeKind.ANNOUNCEMENT, ann.team_id, f"announcement:{number}", {})
        assert len(session.scalars(select(Notice)).all()) == outbox.MAX_MAILS_A_DAY_TO_ONE


def test_a_team_has_few_codes_sent_to_strangers(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(outbox, "MAX_CONFIRMATIONS_OF_TEAM", 2)
    with database.transaction() as session:
        ann, by_ann = joined(session, make_principal(session))
        for number in range(2):
            members.set_email(session, by_ann, ann, f"stranger{number}@example.org")
        with refused(ProblemCode.TOO_MANY_REQUESTS):
            members.set_email(session, by_ann, ann, "stranger2@example.org")
