from uuid import uuid4

import pytest
from service_factories import (
    LOCK,
    TASK,
    claim,
    make_failed_record,
    make_principal,
    make_record,
    shard_ids,
    store,
    submit,
)
from sqlalchemy import update
from sqlalchemy.orm import Session
from submission_steps import SETTINGS, refused
from vitac.evaluator.agent.verdicts import VerdictCode
from vitac.evaluator.episodes.records import EpisodeRecord
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import ListKind
from vitac.server.database.engine import Database
from vitac.server.database.models import Evaluation, Submission
from vitac.server.errors import ProblemCode
from vitac.server.evaluations import lifecycle
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.principals import CONSOLE, Principal
from vitac.server.submissions import listing
from vitac.server.submissions.files import episode_outputs, episodes_with_output
from vitac.server.views.submissions import OutputView
from vitac.server.visibility import EvaluationVisibility, decide_sight


@pytest.fixture
def submission(database: Database, principal: Principal) -> Submission:
    """A submission of two tasks whose policy printed in episodes 2, 3 and 5 of the first."""
    with database.transaction() as session:
        made = submit(session, principal, tasks=(TASK, LOCK))
        shard = shard_ids(session, made)[0]
    store(database, claim(database, shard), [told(number) for number in (1, 2, 3, 4, 5)])
    return made


def told(number: int) -> EpisodeRecord:
    return make_record(number, output=f"in {number}" if number in {2, 3, 5} else "")


def output_for(database: Database, by: Principal, submission: Submission, **options: int) -> OutputView:
    with database.transaction() as session:
        return episode_outputs(session, by, submission.id, **options)  # type: ignore[arg-type]


def evaluation_of(session: Session, submission: Submission) -> Evaluation:
    return newest_evaluation(session, session.get_one(Submission, submission.id))


def seal(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    """Makes the lists sealed ones of a track file that is gone."""
    monkeypatch.setattr("vitac.server.visibility.known_task", lambda *_: None)
    with database.transaction() as session:
        session.execute(update(Evaluation).values(list_kind=ListKind.SEALED))


def test_team_and_organizers_read_what_was_printed_page_by_page(
    database: Database, principal: Principal, submission: Submission
) -> None:
    for by in (principal, CONSOLE):
        first = output_for(database, by, submission, limit=2)
        rest = output_for(database, by, submission, limit=2, after=first.next_after or 0)
        shown = [(item.episode, item.outcome, item.output) for item in (*first.items, *rest.items)]
        assert shown == [(number, "success", f"in {number}") for number in (2, 3, 5)]
        assert (first.next_after, rest.next_after) == (3, None)
        with database.transaction() as session:
            assert episode_outputs(session, by, submission.id, LOCK).items == []
            assert episodes_with_output(session, by, evaluation_of(session, submission)) == 3


def test_why_a_policy_failed_is_told_to_those_who_see_its_output(
    database: Database, principal: Principal, submission: Submission, monkeypatch: pytest.MonkeyPatch
) -> None:
    with database.transaction() as session:
        shard = shard_ids(session, submission)[1]
    store(database, claim(database, shard), [make_failed_record(28, output="", code=VerdictCode.NON_FINITE_ACTION)])
    for by in (principal, CONSOLE):
        (failed,) = output_for(database, by, submission, after=5).items
        assert (failed.episode, failed.outcome, failed.output) == (28, "policy_failed", "")
        assert failed.failure == f"non_finite_action: failed in 28. {VerdictCode.NON_FINITE_ACTION.sentence}"
        assert [item.failure for item in output_for(database, by, submission).items][:3] == [None] * 3
        with database.transaction() as session:
            assert episodes_with_output(session, by, evaluation_of(session, submission)) == 4
    seal(database, monkeypatch)
    with refused(ProblemCode.FORBIDDEN):
        output_for(database, principal, submission)


def test_to_other_teams_there_is_no_such_submission(database: Database, submission: Submission) -> None:
    with database.transaction() as session:
        other = make_principal(session, "Team B")
    for identity in (submission.id, uuid4()):
        with refused(ProblemCode.NOT_FOUND), database.transaction() as session:
            episode_outputs(session, other, identity)
    with database.transaction() as session:
        assert episodes_with_output(session, other, evaluation_of(session, submission)) == 0


def test_a_task_that_it_does_not_play_is_refused(
    database: Database, principal: Principal, submission: Submission
) -> None:
    with refused(ProblemCode.UNKNOWN_TASK), database.transaction() as session:
        episode_outputs(session, principal, submission.id, "fusion-insertion")


def test_output_on_a_sealed_list_is_for_organizers_only(
    database: Database, principal: Principal, submission: Submission, monkeypatch: pytest.MonkeyPatch
) -> None:
    seal(database, monkeypatch)
    with refused(ProblemCode.FORBIDDEN):
        output_for(database, principal, submission)
    with database.transaction() as session:
        evaluation = evaluation_of(session, submission)
        assert episodes_with_output(session, principal, evaluation) == 0
        assert episodes_with_output(session, CONSOLE, evaluation) == 3


def test_output_of_a_failure_on_a_sealed_list_is_for_organizers_only(
    database: Database, principal: Principal, submission: Submission, monkeypatch: pytest.MonkeyPatch
) -> None:
    with database.transaction() as session:
        evaluation = evaluation_of(session, submission)
        lifecycle.cancel(session, evaluation)
        evaluation.log_tail = "it failed"
    tails = []
    for sealed in (False, True):
        if sealed:
            seal(database, monkeypatch)
        for by in (principal, CONSOLE):
            with database.transaction() as session:
                tails.append(listing.get(session, SETTINGS, by, submission.id).evaluation.log_tail)
    assert tails == ["it failed", "it failed", "", "it failed"]


def test_a_log_has_no_output(database: Database, principal: Principal, submission: Submission) -> None:
    with database.transaction() as session:
        evaluation = evaluation_of(session, submission)
        assert decide_sight(principal, evaluation) == EvaluationVisibility(episodes=True, output=True, practice=True)
        session.expunge(evaluation.submission)
        evaluation.submission.kind = SubmissionKind.LOG
        for by in (principal, CONSOLE):
            assert decide_sight(by, evaluation) == EvaluationVisibility(episodes=True, output=False, practice=True)
        session.rollback()
