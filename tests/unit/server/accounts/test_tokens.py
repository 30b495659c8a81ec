import hashlib
from datetime import UTC, datetime, timedelta
from uuid import uuid4

import pytest
from database_work import database_work
from service_factories import make_principal
from sqlalchemy import text
from vitac.server.accounts import teams, tokens
from vitac.server.database.engine import Database
from vitac.server.database.models import ApiToken
from vitac.server.database.states import Role
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.principals import CONSOLE, Principal


def issue(
    database: Database, principal: Principal, lifetime: timedelta | None = None, label: str = "laptop"
) -> tokens.IssuedToken:
    with database.transaction() as session:
        team = teams.own(session, principal)
        return tokens.issue(session, principal, role=Role.TEAM, label=label, team=team, lifetime=lifetime)


def test_a_label_that_cannot_be_shown_is_refused(database: Database, principal: Principal) -> None:
    for label in ["", " ", "\u3164", "a\u202eb", "a\nb\x00", "a" * 65]:
        with pytest.raises(ServiceError) as refused:
            issue(database, principal, label=label)
        assert refused.value.code is ProblemCode.INVALID_REQUEST


def refusal(database: Database, secret: str) -> ServiceError:
    with pytest.raises(ServiceError) as refused, database.transaction() as session:
        tokens.authenticate(session, secret)
    assert refused.value.code is ProblemCode.INVALID_CREDENTIALS
    return refused.value


def test_secret_opens_the_door_and_only_its_hash_is_stored(database: Database, principal: Principal) -> None:
    issued = issue(database, principal)
    with database.transaction() as session:
        found = tokens.authenticate(session, issued.secret)
        assert (found.team_id, found.team_name, found.role) == (principal.team_id, "Team A", Role.TEAM)
        row = dict(session.execute(text("SELECT * FROM api_tokens")).mappings().one())
    assert row["secret_sha256"] == hashlib.sha256(issued.secret.encode()).hexdigest()
    assert issued.secret not in str(row)


def test_secrets_have_256_random_bits(database: Database, principal: Principal) -> None:
    secrets = {issue(database, principal).secret for _ in range(20)}
    assert len(secrets) == 20
    assert all(tokens.SECRET_PATTERN.fullmatch(secret) for secret in secrets)


def test_malformed_secret_is_refused_with_the_form_it_should_have(database: Database) -> None:
    for secret in ["", "vitac_", "vitac_" + "!" * 43, "Bearer x", "vitac_" + "a" * 44, "\0"]:
        assert "43 letters" in refusal(database, secret).detail


def test_unknown_secret_is_refused(database: Database) -> None:
    assert "not known" in refusal(database, "vitac_" + "a" * 43).detail


def test_expired_token_is_refused_with_the_time(database: Database, principal: Principal) -> None:
    secret = issue(database, principal, timedelta(seconds=-1)).secret
    assert "expired at" in refusal(database, secret).detail


def test_revoked_token_is_refused_at_once_also_by_its_id(database: Database, principal: Principal) -> None:
    issued = issue(database, principal)
    with database.transaction() as session:
        assert tokens.principal_of_token_id(session, issued.token.id).team_id == principal.team_id
        tokens.revoke(session, principal, issued.token.id)
        tokens.revoke(session, principal, issued.token.id)
    assert "revoked at" in refusal(database, issued.secret).detail
    with pytest.raises(ServiceError, match="revoked at"), database.transaction() as session:
        tokens.principal_of_token_id(session, issued.token.id)


def test_team_can_neither_revoke_nor_list_tokens_of_others(database: Database, principal: Principal) -> None:
    mine = issue(database, principal)
    with database.transaction() as session:
        other = make_principal(session, "Team B")
        assert tokens.list_tokens(session, other) == []
        assert [token.id for token in tokens.list_tokens(session, principal)] == [mine.token.id]
        assert len(tokens.list_tokens(session, CONSOLE)) == 1
    for wanted in (mine.token.id, uuid4()):
        with pytest.raises(ServiceError, match="There is no token"), database.transaction() as session:
            tokens.revoke(session, other, wanted)


def test_team_cannot_make_organizers_or_tokens_for_others(database: Database, principal: Principal) -> None:
    with database.transaction() as session:
        other = teams.own(session, make_principal(session, "Team B"))
    for role, team in ((Role.ORGANIZER, None), (Role.TEAM, other)):
        with pytest.raises(ServiceError, match="for itself only"), database.transaction() as session:
            tokens.issue(session, principal, role=role, label="x", team=team, lifetime=None)


def test_use_is_noted_but_not_at_every_request(database: Database, principal: Principal) -> None:
    issued = issue(database, principal)
    used = []
    for _ in range(2):
        with database.transaction() as session:
            tokens.authenticate(session, issued.secret)
        with database.transaction() as session:
            used.append(session.get_one(ApiToken, issued.token.id).last_used_at)
    assert used[0] == used[1]
    assert used[0] is not None
    assert datetime.now(UTC) - used[0] < timedelta(minutes=1)


def test_who_asks_is_found_by_one_statement(database: Database, principal: Principal) -> None:
    """Every request asks."""
    issued = issue(database, principal)
    statements = []
    for _ in range(2):
        with database.transaction() as session, database_work(session) as work:
            assert tokens.authenticate(session, issued.secret).team_name == principal.team_name
        statements.append(work.statements)
    assert statements == [2, 1], "the first one notes the use, too"


def test_audit_log_tells_who_issued_and_revoked(database: Database, principal: Principal) -> None:
    issued = issue(database, principal)
    with database.transaction() as session:
        tokens.revoke(session, CONSOLE, issued.token.id)
        lines = session.execute(text("SELECT actor, action FROM audit_log ORDER BY id")).all()
    assert [tuple(line) for line in lines][-2:] == [
        ("team:Team A", "token.issue"),
        ("organizer:console", "token.revoke"),
    ]
