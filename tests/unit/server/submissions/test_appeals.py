import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from uuid import UUID

import pytest
from service_factories import (
    TASK,
    claim,
    complete_scored,
    make_principal,
    make_record,
    make_score,
    shard_ids,
    store,
    submit,
    submit_scored,
)
from sqlalchemy import select, update
from sqlalchemy.orm import Session
from submission_steps import refused
from vitac.server.accounts import teams
from vitac.server.audit import newest_entries
from vitac.server.competitions.competition import Competition
from vitac.server.database.engine import Database
from vitac.server.database.models import Appeal, Evaluation, Rejudgement, Submission
from vitac.server.database.states import AppealState, Role
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.names import TEXT_LENGTH
from vitac.server.operations import team_data
from vitac.server.principals import CONSOLE, Principal
from vitac.server.submissions import appeals, withdrawal

from competitions import make_competition, put_in_place

JUDGE = Principal(role=Role.JUDGE)
TEXT = "The peg was in the hole."


def with_appeals(session: Session, days: int | None = 7) -> None:
    content = make_competition(**({} if days is None else {"appeal_days": days}))
    content["tracks"] = {"mail": content["tracks"]["track_1"] | {"taken_here": False}}
    put_in_place(session, content)


@pytest.fixture
def played(database: Database) -> tuple[Principal, Submission]:
    """A team and its finished submission, where appeals are possible for a week; its third episode is stored."""
    with database.transaction() as session:
        with_appeals(session)
        team = make_principal(session, "Ants")
        submission = submit(session, team)
        first = shard_ids(session, submission)[0]
    store(database, claim(database, first), [make_record(3)])
    with database.transaction() as session:
        complete_scored(session, session.get_one(Submission, submission.id), {TASK: make_score(1)})
    return team, submission


def test_an_appeal_is_opened_seen_and_ruled_on(database: Database, played: tuple[Principal, Submission]) -> None:
    team, submission = played
    with database.transaction() as session:
        other = make_principal(session, "Bees")
        made = appeals.open_appeal(session, team, submission.id, TEXT, task=TASK, episode=3)
        with refused(ProblemCode.INVALID_REQUEST):
            appeals.open_appeal(session, team, submission.id, TEXT)
        for by, seen in ((team, 1), (CONSOLE, 1), (JUDGE, 1), (other, 0)):
            assert len(appeals.visible(session, by)) == seen
        with refused(ProblemCode.NOT_FOUND):
            appeals.find(session, other, made.id)
        for by in (team, JUDGE):
            with refused(ProblemCode.FORBIDDEN):
                appeals.rule(session, by, made.id, "No.", upheld=False)
        with refused(ProblemCode.FORBIDDEN):
            appeals.withdraw(session, JUDGE, made.id)
        appeals.rule(session, CONSOLE, made.id, "Yes, it was.", upheld=True)
        view = appeals.appeal_view(made, team)
        assert (view.state, view.ruling, view.task, view.episode) == (AppealState.UPHELD, "Yes, it was.", TASK, 3)
        with refused(ProblemCode.INVALID_REQUEST):
            appeals.rule(session, CONSOLE, made.id, "Or not.", upheld=False)
        with refused(ProblemCode.INVALID_REQUEST):
            appeals.withdraw(session, team, made.id)
        again = appeals.open_appeal(session, team, submission.id, TEXT)
        appeals.withdraw(session, team, again.id)
        assert [one.state for one in appeals.visible(session, CONSOLE)] == [AppealState.WITHDRAWN, AppealState.UPHELD]
        assert appeals.visible(session, CONSOLE, open_only=True) == []
        found = newest_entries(session, 4)
    assert [entry.action for entry in found] == ["appeal.withdraw", "appeal.open", "appeal.rule", "appeal.open"]
    assert (found[2].before, found[2].after) == ({"state": "open"}, {"state": "upheld", "ruling": "Yes, it was."})


def test_what_cannot_be_appealed_against_is_refused(database: Database, played: tuple[Principal, Submission]) -> None:
    team, submission = played
    with database.transaction() as session:
        waiting = submit(session, team, "waits")
        with refused(ProblemCode.APPEAL_TOO_LATE):
            appeals.open_appeal(session, team, waiting.id, TEXT)
        for by in (make_principal(session, "Bees"), Principal(role=Role.TEAM)):
            with refused(ProblemCode.NOT_FOUND):
                appeals.open_appeal(session, by, submission.id, TEXT)
        with refused(ProblemCode.FORBIDDEN):
            appeals.open_appeal(session, JUDGE, submission.id, TEXT)
        for task, episode in ((TASK, 10_000), (TASK, 10**12), (TASK, 0), ("nothing", 1), ("a\0b", 1)):
            with refused(ProblemCode.NOT_FOUND):
                appeals.open_appeal(session, team, submission.id, TEXT, task=task, episode=episode)
        for half in ({"task": TASK}, {"episode": 1}):
            with refused(ProblemCode.INVALID_REQUEST):
                appeals.open_appeal(session, team, submission.id, TEXT, **half)
        session.execute(update(Evaluation).values(created_at=Evaluation.created_at))
        week_ago = datetime.now(UTC) - timedelta(days=7)
        newest = select(Evaluation.id).where(Evaluation.submission_id == submission.id)
        session.execute(update(Evaluation).where(Evaluation.id.in_(newest)).values(finished_at=week_ago))
        session.expire_all()
        with refused(ProblemCode.APPEAL_TOO_LATE):
            appeals.open_appeal(session, team, submission.id, TEXT)
        with_appeals(session, days=8)
        session.expire_all()
        appeals.open_appeal(session, team, submission.id, TEXT)
        with_appeals(session, days=None)
        session.expire_all()
        with refused(ProblemCode.APPEAL_TOO_LATE):
            appeals.open_appeal(session, team, submission.id, TEXT)


def test_a_team_has_so_many_open_appeals(
    database: Database, played: tuple[Principal, Submission], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(appeals, "MAX_OPEN", 0)
    team, submission = played
    with database.transaction() as session, refused(ProblemCode.TOO_MANY_REQUESTS):
        appeals.open_appeal(session, team, submission.id, TEXT)


def test_a_team_opens_so_many_appeals_in_a_day_and_the_newest_are_shown(
    database: Database, played: tuple[Principal, Submission], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(appeals, "MAX_A_DAY", 2)
    monkeypatch.setattr(appeals, "SHOWN", 1)
    team, submission = played
    with database.transaction() as session:
        for _ in range(2):
            last = appeals.open_appeal(session, team, submission.id, TEXT)
            appeals.withdraw(session, team, last.id)
        with refused(ProblemCode.TOO_MANY_REQUESTS):
            appeals.open_appeal(session, team, submission.id, TEXT)
        assert [one.id for one in appeals.visible(session, team)] == [last.id]
        session.execute(update(Appeal).values(opened_at=datetime.now(UTC) - timedelta(days=1)))
        appeals.open_appeal(session, team, submission.id, TEXT)


def test_the_time_to_appeal_against_a_rejudged_result_begins_when_it_counts(
    database: Database, played: tuple[Principal, Submission]
) -> None:
    team, submission = played
    now = datetime.now(UTC)
    with database.transaction() as session:
        made = Rejudgement(track=submission.track, stage="", reason="other physics", applied_at=now)
        session.add(made)
        session.flush()
        session.execute(update(Evaluation).values(finished_at=now - timedelta(days=8)))
        session.expire_all()
        with refused(ProblemCode.APPEAL_TOO_LATE):
            appeals.open_appeal(session, team, submission.id, TEXT)
        session.execute(update(Evaluation).values(rejudgement_id=made.id))
        session.expire_all()
        appeals.open_appeal(session, team, submission.id, TEXT)


def test_of_appeals_opened_or_ended_at_once_only_so_many_count(
    database: Database, played: tuple[Principal, Submission], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(appeals, "MAX_OPEN", 2)
    team, submission = played
    with database.transaction() as session:
        evaluated = [submission.id]
        for number in range(3):
            evaluated.append(submit_scored(session, team, f"other {number}", {TASK: make_score(1)}).id)
    barrier = threading.Barrier(4)

    def at_once(done: Callable[[Session], object]) -> ProblemCode | None:
        with database.transaction() as session:
            barrier.wait(120.0)
            try:
                done(session)
            except ServiceError as error:
                session.rollback()
                return error.code
        return None

    def open_one(submission_id: UUID) -> ProblemCode | None:
        return at_once(lambda session: appeals.open_appeal(session, team, submission_id, TEXT))

    with ThreadPoolExecutor(4) as pool:
        assert sorted(map(str, pool.map(open_one, evaluated))) == ["None"] * 2 + ["too_many_requests"] * 2
        with database.transaction() as session:
            number = appeals.visible(session, team, open_only=True)[0].id

        def end(upheld: bool | None) -> ProblemCode | None:
            if upheld is None:
                return at_once(lambda session: appeals.withdraw(session, team, number))
            return at_once(lambda session: appeals.rule(session, CONSOLE, number, "Decided.", upheld=upheld))

        ended = list(pool.map(end, (True, False, None, None)))
    assert (ended.count(None), ended.count(ProblemCode.INVALID_REQUEST)) == (1, 3)
    with database.transaction() as session:
        found = [line.action for line in newest_entries(session, 20) if line.subject == f"appeal:{number}"]
    assert len(found) == 2, "one line of the opening, and one of the end that counted"


def test_an_appeal_of_a_removed_team_is_still_decided_and_says_nothing_of_it(
    database: Database, played: tuple[Principal, Submission]
) -> None:
    team, submission = played
    with database.transaction() as session:
        number = appeals.open_appeal(session, team, submission.id, TEXT, task=TASK, episode=3).id
        for _ in range(2):
            team_data.erase(session, CONSOLE, teams.own(session, team))
    with database.transaction() as session:
        (view,) = appeals.visible(session, CONSOLE)
        assert (view.text, view.state) == (withdrawal.REMOVED, AppealState.OPEN)
        assert "Ants" not in view.model_dump_json()
        appeals.rule(session, CONSOLE, number, "Nobody is left to tell.", upheld=False)
        assert appeals.visible(session, CONSOLE, open_only=True) == []


def test_a_text_that_cannot_be_shown_opens_and_ends_no_appeal(
    database: Database, played: tuple[Principal, Submission]
) -> None:
    team, submission = played
    texts = ("", " x ", "x" * (TEXT_LENGTH + 1), "a\0b", "turned \u202e around")
    with database.transaction() as session:
        for text in texts:
            with refused(ProblemCode.INVALID_REQUEST):
                appeals.open_appeal(session, team, submission.id, text)
        made = appeals.open_appeal(session, team, submission.id, "x" * TEXT_LENGTH)
        for text in texts:
            with refused(ProblemCode.INVALID_REQUEST):
                appeals.rule(session, CONSOLE, made.id, text, upheld=True)
        assert made.state is AppealState.OPEN


@pytest.mark.parametrize(("days", "is_taken"), [(7, True), (None, False)])
def test_the_form_is_shown_where_the_competition_gives_time_for_appeals(
    database: Database, days: int | None, is_taken: bool
) -> None:
    with database.transaction() as session:
        assert not appeals.takes_appeals(session)
        with_appeals(session, days)
        assert appeals.takes_appeals(session) == is_taken
        assert appeals.takes_appeals(session, Competition.read(session).name) == is_taken
