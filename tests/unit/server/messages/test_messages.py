from datetime import UTC, datetime, timedelta

import pytest
from service_factories import make_principal
from sqlalchemy import update
from submission_steps import refused
from vitac.server.audit import newest_entries
from vitac.server.db.engine import Database
from vitac.server.db.models import Question
from vitac.server.db.states import Role
from vitac.server.errors import ProblemCode
from vitac.server.members import members
from vitac.server.messages import announcements, questions
from vitac.server.notices import outbox
from vitac.server.principals import CONSOLE, Principal
from vitac.server.teams import teams

JUDGE = Principal(role=Role.JUDGE)


def test_an_announcement_is_shown_to_everybody_and_sent_where_it_is_asked_for(database: Database) -> None:
    with database.transaction() as session:
        ants = make_principal(session, "Ants")
        waiting = teams.register(session, CONSOLE, name="Waiting", waits=True)
        for team in (teams.own(session, ants), waiting):
            members.set_email(session, CONSOLE, members.find_captain(session, team), f"{team.name}@example.org")
        first = announcements.publish(session, CONSOLE, title=" Two \t words ", text="a\r\n\r\nb  \n", notify=False)
        assert outbox.newest(session) == []
        announcements.publish(session, CONSOLE, title="Second", text="<b>text</b>", notify=True)
        assert [notice.target for notice in outbox.newest(session)] == ["Ants@example.org"]
        assert [(one.title, one.text) for one in announcements.shown(session)] == [
            ("Second", "<b>text</b>"),
            ("Two words", "a\n\nb"),
        ]
        for _ in range(2):
            announcements.withdraw(session, CONSOLE, first.id)
        assert [one.title for one in announcements.shown(session)] == ["Second"]
        assert [entry.action for entry in newest_entries(session, 3)] == [
            "announcement.withdraw",
            "announcement.publish",
            "announcement.publish",
        ]
        for by in (ants, JUDGE):
            with refused(ProblemCode.FORBIDDEN):
                announcements.publish(session, by, title="Third", text="text", notify=False)
            with refused(ProblemCode.FORBIDDEN):
                announcements.withdraw(session, by, first.id)
        with refused(ProblemCode.NOT_FOUND):
            announcements.withdraw(session, CONSOLE, 4711)


def test_what_cannot_be_shown_is_not_announced(database: Database) -> None:
    for title, text in (("Title", "a\0b"), ("Title", "x"), ("a\0b", "Text"), ("x" * 121, "Text")):
        with database.transaction() as session, refused(ProblemCode.INVALID_REQUEST):
            announcements.publish(session, CONSOLE, title=title, text=text, notify=False)


def test_a_question_is_seen_by_whom_it_concerns(database: Database) -> None:
    with database.transaction() as session:
        ants, bees = make_principal(session, "Ants"), make_principal(session, "Bees")
        open_one = questions.ask(session, ants, "Is this public?", public=True)
        own = questions.ask(session, ants, "Is this not?", public=False)
        assert [one.id for one in questions.visible(session, ants)] == [own.id, open_one.id]
        assert questions.visible(session, bees) == questions.visible(session, None) == []
        assert questions.visible(session, JUDGE) == []
        assert [one.team for one in questions.visible(session, CONSOLE)] == ["Ants", "Ants"]
        questions.answer(session, CONSOLE, open_one.id, "Yes.", public=True)
        questions.answer(session, CONSOLE, own.id, "No.", public=False)
        for by in (bees, None):
            (seen,) = questions.visible(session, by)
            assert (seen.id, seen.team, seen.answer) == (open_one.id, None, "Yes.")
        questions.answer(session, CONSOLE, open_one.id, "No longer.", public=False)
        assert questions.visible(session, None) == []
        found = newest_entries(session, 1)[0]
        assert (found.action, found.before) == ("question.answer", {"answer": "Yes.", "public": True})
        with refused(ProblemCode.FORBIDDEN):
            questions.answer(session, ants, own.id, "By myself.", public=True)
        with refused(ProblemCode.NOT_FOUND):
            questions.ask(session, CONSOLE, "Of no team?", public=True)


def test_a_hidden_question_waits_for_nobody_and_is_not_public(database: Database) -> None:
    with database.transaction() as session:
        ants = make_principal(session, "Ants")
        rude = questions.ask(session, ants, "Rude words", public=True)
        questions.answer(session, CONSOLE, rude.id, "Please.", public=True)
        for _ in range(2):
            questions.hide(session, CONSOLE, rude.id)
        assert questions.visible(session, None) == []
        assert questions.visible(session, CONSOLE, open_only=True) == []
        assert [one.hidden for one in questions.visible(session, ants)] == [True]
        with refused(ProblemCode.NOT_FOUND):
            questions.hide(session, CONSOLE, 4711)


def test_a_team_asks_so_much(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(questions, "MAX_A_DAY", 3)
    monkeypatch.setattr(questions, "MAX_OPEN", 2)
    with database.transaction() as session:
        ants = make_principal(session, "Ants")
        first = questions.ask(session, ants, "One?", public=True)
        questions.ask(session, ants, "Two?", public=True)
        with refused(ProblemCode.TOO_MANY_REQUESTS):
            questions.ask(session, ants, "Three?", public=True)
        questions.answer(session, CONSOLE, first.id, "Yes.", public=True)
        questions.ask(session, ants, "Three?", public=True)
        session.execute(update(Question).values(answer="Yes.", answered_at=datetime.now(UTC)))
        with refused(ProblemCode.TOO_MANY_REQUESTS):
            questions.ask(session, ants, "Four?", public=True)
        session.execute(update(Question).values(asked_at=datetime.now(UTC) - timedelta(days=1)))
        questions.ask(session, ants, "Four?", public=True)
