"""What organizers are told to look at: which evaluations, in which words and order, and how far each stage is."""

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta

import pytest
from service_factories import TASK, TRACK, add_result, make_score, sha256
from sqlalchemy.orm import Session
from vitac.evaluator.tracks import load_track
from vitac.server.database.engine import Database
from vitac.server.database.models import EpisodeDifference, Evaluation, LogCopy, Qualification, Team
from vitac.server.database.states import EvaluationState
from vitac.server.evaluations.verdicts import ServiceVerdict
from vitac.server.operations import desk as module
from vitac.server.operations.desk import StageState, stages, troubles
from vitac.server.principals import CONSOLE

from competitions import CLOSES, FIRST, LATER_CLOSES, SECOND, make_competition, put_in_place

BEGIN = datetime(2026, 1, 1, tzinfo=UTC)


@pytest.fixture
def session(database: Database) -> Iterator[Session]:
    with database.transaction() as opened:
        yield opened
        opened.rollback()


class Desk:
    """A team and its evaluations."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self.team = Team(name="Team A", name_key="team a")
        session.add(self.team)
        session.flush()
        self.number = 0

    def evaluation(self, minute: int) -> Evaluation:
        self.number += 1
        moment = BEGIN + timedelta(minutes=minute)
        return add_result(self.session, self.number, self.team, {TASK: make_score(5)}, moment)

    def differs(self, evaluation: Evaluation, episode: int = 1) -> None:
        self.session.add(
            EpisodeDifference(
                evaluation_id=evaluation.id,
                task=TASK,
                episode=episode,
                stored_digest=sha256("stored"),
                differing_digest=sha256("other"),
            )
        )
        self.session.flush()

    def is_copy(self, evaluation: Evaluation, of: Evaluation) -> None:
        copy = LogCopy(evaluation_id=evaluation.id, earlier_submission_id=of.submission_id, episodes=3)
        self.session.add(copy)
        self.session.flush()


def test_each_trouble_is_said_once_and_the_newest_comes_first(session: Session) -> None:
    desk = Desk(session)
    good, twice, both = desk.evaluation(1), desk.evaluation(2), desk.evaluation(3)
    assert troubles(session, CONSOLE) == []
    for episode in (1, 2, 3):
        desk.differs(twice, episode)
    desk.differs(both)
    desk.is_copy(both, of=good)
    found = troubles(session, CONSOLE)
    assert [one.submission_id for one in found] == [both.submission_id, twice.submission_id]
    assert [one.problem for one in found] == [
        "an episode gave another result when it was run again; "
        "the states, nearly the actions, or the archive of another team's earlier submission",
        "an episode gave another result when it was run again",
    ]
    titled = load_track(TRACK).title
    assert [(one.team, one.track_title, one.at, one.submission) for one in found] == [
        ("Team A", titled, BEGIN + timedelta(minutes=3), both.submission.name),
        ("Team A", titled, BEGIN + timedelta(minutes=2), twice.submission.name),
    ]
    put_in_place(session, make_competition())
    assert {one.track_title for one in troubles(session, CONSOLE)} == {"Touch"}, "as the competition calls it"
    good.submission.track = both.submission.track = "gone"
    session.flush()
    assert [one.track_title for one in troubles(session, CONSOLE)] == ["gone", "Touch"]


def test_a_failure_of_the_machines_is_a_trouble_and_one_of_the_policy_is_none(session: Session) -> None:
    first = Desk(session).evaluation(1)
    for run, code in enumerate((ServiceVerdict.MACHINE_FAILED.value, "crashed"), start=2):
        moment = BEGIN + timedelta(minutes=run)
        failed = Evaluation(
            submission=first.submission, run=run, evaluator_version=first.evaluator_version,
            evaluator_hash=first.evaluator_hash, state=EvaluationState.FAILED, episodes_reused=0, log_tail="",
            created_at=moment, finished_at=moment, verdict_code=code, verdict_message="so it was",
            list_kind=first.list_kind,
        )  # fmt: skip
        session.add(failed)
    session.flush()
    (found,) = troubles(session, CONSOLE)
    assert (found.problem, found.at) == ("the machines failed", BEGIN + timedelta(minutes=2))


def test_so_many_are_shown_at_most(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    desk = Desk(session)
    made = [desk.evaluation(minute) for minute in range(4)]
    for evaluation in made:
        desk.differs(evaluation)
    monkeypatch.setattr(module, "SHOWN", 3)
    assert [one.submission_id for one in troubles(session, CONSOLE)] == [one.submission_id for one in made[:0:-1]]


def state_of(found: StageState) -> tuple[str, str, int | None, int, int, bool]:
    return found.track, found.stage.name, found.qualified, found.submissions, found.running, found.over


def test_stages_tell_how_far_they_are(session: Session) -> None:
    assert stages(session, CONSOLE) == []
    put_in_place(session, make_competition())
    desk = Desk(session)
    for minute in range(3):
        submission = desk.evaluation(minute).submission
        submission.competition, submission.stage = "cup", FIRST
    desk.evaluation(5)  # outside of the competition
    session.add(Qualification(competition="cup", track=TRACK, stage=SECOND, team_id=desk.team.id))
    session.add(Qualification(competition="cup", track="track_2", stage=SECOND, team_id=desk.team.id))
    session.flush()
    before, at_the_end, after = CLOSES - timedelta(seconds=1), CLOSES, LATER_CLOSES
    assert [state_of(one) for one in stages(session, CONSOLE, before)] == [
        (TRACK, FIRST, None, 3, 0, False),
        (TRACK, SECOND, 1, 0, 0, False),
    ]
    assert [(one.track_title, one.stage.title) for one in stages(session, CONSOLE)] == [
        ("Touch", "Simulation"),
        ("Touch", "Final"),
    ]
    assert [one.over for one in stages(session, CONSOLE, at_the_end)] == [True, False]
    assert [one.over for one in stages(session, CONSOLE, after)] == [True, True]


def test_stages_that_are_held_elsewhere_are_not_shown(session: Session) -> None:
    put_in_place(session, make_competition(taken_here=False))
    assert stages(session, CONSOLE, CLOSES) == []
