from datetime import UTC, datetime, timedelta

import pytest
from service_factories import make_principal
from sqlalchemy import update
from submission_steps import refused
from vitac.server.accounts import members, messages, outbox, teams
from vitac.server.audit import newest_entries
from vitac.server.database.engine import Database
from vitac.server.database.models import Question
from vitac.server.database.states import Role
from vitac.server.errors import ProblemCode
from vitac.server.principals import CONSOLE, Principal

JUDGE = Principal(role=Role.JUDGE)


def test_an_announcement_is_shown_to_everybody_and_sent_where_it_is_asked_for(database: Database) -> None:
    with database.transaction() as session:
        ants = make_principal(session, "Ants")
        waiting = teams.register(session, CONSOLE, name="Waiting", waits=True)
        for team in (teams.own(session, ants), waiting):
            members.set_email(session, CONSOLE, members.find_captain(session, team), f"{team.name}@example.org")
        first = messages.publish_announcement(
            session, CONSOLE, title=" Two \t words ", text="a\r\n\r\nb  \n", notify=False
        )
        assert outbox.newest(session) == []
        messages.publish_announcement(session, CONSOLE, title="Second", text="<b>text</b>", notify=True)
        assert [notice.target for notice in outbox.newest(session)] == ["Ants@example.org"]
        assert [(one.title, one.text) for one in messages.list_announcements(session)] == [
            ("Second", "<b>text</b>"),
            ("Two words", "a\n\nb"),
        ]
        for _ in range(2):
            messages.withdraw_announcement(session, CONSOLE, first.id)
        assert [one.title for one in messages.list_announcements(session)] == ["Second"]
        assert [entry.action for entry in newest_entries(session, 3)] == [
            "announcement.withdraw",
            "announcement.publish",
            "announcement.publish",
        ]
        for by in (ants, JUDGE):
            with refused(ProblemCode.FORBIDDEN):
                messages.publish_announcement(session, by, title="Third", text="text", notify=False)
            with refused(ProblemCode.FORBIDDEN):
                messages.withdraw_announcement(session, by, first.id)
        with refused(ProblemCode.NOT_FOUND):
            messages.withdraw_announcement(session, CONSOLE, 4711)


def test_what_cannot_be_shown_is_neither_announced_nor_asked(database: Database) -> None:
    for title, text in (("Title", "a\0b"), ("Title", "x"), ("a\0b", "Text"), ("x" * 121, "Text")):
        with database.transaction() as session, refused(ProblemCode.INVALID_REQUEST):
            messages.publish_announcement(session, CONSOLE, title=title, text=text, notify=False)
    with database.transaction() as session:
        ants = make_principal(session, "Ants")
    for text in ("", "x", "x" * 4001, "turned \u202e around"):
        with database.transaction() as session, refused(ProblemCode.INVALID_REQUEST):
            messages.ask_question(session, ants, text, public=True)


def test_a_question_is_seen_by_whom_it_concerns(database: Database) -> None:
    with database.transaction() as session:
        ants, bees = make_principal(session, "Ants"), make_principal(session, "Bees")
        open_one = messages.ask_question(session, ants, "Is this public?", public=True)
        own = messages.ask_question(session, ants, "Is this not?", public=False)
        assert [one.id for one in messages.list_questions(session, ants)] == [own.id, open_one.id]
        assert messages.list_questions(session, bees) == messages.list_questions(session, None) == []
        assert messages.list_questions(session, JUDGE) == []
        assert [one.team for one in messages.list_questions(session, CONSOLE)] == ["Ants", "Ants"]
        messages.answer_question(session, CONSOLE, open_one.id, "Yes.", public=True)
        messages.answer_question(session, CONSOLE, own.id, "No.", public=False)
        for by in (bees, None):
            (seen,) = messages.list_questions(session, by)
            assert (seen.id, seen.team, seen.answer) == (open_one.id, None, "Yes.")
        messages.answer_question(session, CONSOLE, open_one.id, "No longer.", public=False)
        assert messages.list_questions(session, None) == []
        found = newest_entries(session, 1)[0]
        assert (found.action, found.before) == ("question.answer", {"answer": "Yes.", "public": True})
        with refused(ProblemCode.FORBIDDEN):
            messages.answer_question(session, ants, own.id, "By myself.", public=True)
        with refused(ProblemCode.NOT_FOUND):
            messages.ask_question(session, CONSOLE, "Of no team?", public=True)


def test_a_hidden_question_waits_for_nobody_and_is_not_public(database: Database) -> None:
    with database.transaction() as session:
        ants = make_principal(session, "Ants")
        rude = messages.ask_question(session, ants, "Rude words", public=True)
        messages.answer_question(session, CONSOLE, rude.id, "Please.", public=True)
        for _ in range(2):
            messages.hide_question(session, CONSOLE, rude.id)
        assert messages.list_questions(session, None) == []
        assert messages.list_questions(session, CONSOLE, open_only=True) == []
        assert [one.hidden for one in messages.list_questions(session, ants)] == [True]
        with refused(ProblemCode.NOT_FOUND):
            messages.hide_question(session, CONSOLE, 4711)


def test_a_team_asks_so_much(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(messages, "MAX_A_DAY", 3)
    monkeypatch.setattr(messages, "MAX_OPEN", 2)
    with database.transaction() as session:
        ants = make_principal(session, "Ants")
        first = messages.ask_question(session, ants, "One?", public=True)
        messages.ask_question(session, ants, "Two?", public=True)
        with refused(ProblemCode.TOO_MANY_REQUESTS):
            messages.ask_question(session, ants, "Three?", public=True)
        messages.answer_question(session, CONSOLE, first.id, "Yes.", public=True)
        messages.ask_question(session, ants, "Three?", public=True)
        session.execute(update(Question).values(answer="Yes.", answered_at=datetime.now(UTC)))
        with refused(ProblemCode.TOO_MANY_REQUESTS):
            messages.ask_question(session, ants, "Four?", public=True)
        session.execute(update(Question).values(asked_at=datetime.now(UTC) - timedelta(days=1)))
        messages.ask_question(session, ants, "Four?", public=True)
