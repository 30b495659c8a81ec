from types import SimpleNamespace

import pytest
from database_work import database_work
from service_factories import (
    TASK,
    make_score,
    play,
    submit_scored,
)
from sqlalchemy import text
from submission_steps import SETTINGS, break_policy, create, ids_of, make_worker, view_of
from vitac.evaluator.tracks import ListKind
from vitac.server import visibility
from vitac.server.database.engine import Database
from vitac.server.database.models import EpisodeDifference, Submission
from vitac.server.database.states import EvaluationState, WorkerState
from vitac.server.evaluations import view as evaluation_view
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.principals import CONSOLE, Principal
from vitac.server.submissions import listing
from vitac.server.tracks import known_task


def test_new_submission_is_queued_with_its_position(database: Database, principal: Principal) -> None:
    first, is_new = create(database, principal, "one")
    second, _ = create(database, principal, "two")
    assert is_new
    view = view_of(database, principal, second)
    assert view.evaluation.state is EvaluationState.QUEUED
    assert view.evaluation.queue_position == 2
    assert view.evaluation.eta_s is None
    assert view.evaluation.progress.episodes_total == 270
    assert view.workers.alive == 0
    play(database, ids_of(database, first)[0])
    assert view_of(database, principal, first).evaluation.queue_position is None
    assert view_of(database, principal, second).evaluation.queue_position == 1


def test_failed_evaluation_shows_verdict_sentence_and_output(database: Database, principal: Principal) -> None:
    submission, _ = create(database, principal)
    break_policy(database, submission)
    evaluation = view_of(database, principal, submission).evaluation
    assert evaluation.verdict is not None
    assert (evaluation.verdict.code, evaluation.verdict.task, evaluation.verdict.episode) == ("crashed", TASK, 1)
    assert evaluation.verdict.title.endswith("say where.")
    assert evaluation.verdict.message == "failed in 1"
    assert evaluation.log_tail == "out 1"


def test_eta_counts_own_and_earlier_episodes_over_the_slots_of_living_workers(
    database: Database, principal: Principal, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, _ = create(database, principal, "one")
    second, _ = create(database, principal, "two")
    play(database, ids_of(database, first)[0])
    assert view_of(database, principal, first).evaluation.eta_s is None
    make_worker(database, slots=2)
    assert view_of(database, principal, first).evaluation.eta_s == pytest.approx(243 * 0.5 / 2)
    assert view_of(database, principal, second).evaluation.eta_s == pytest.approx((243 + 270) * 0.5 / 2)
    in_batches = SimpleNamespace(definition=SimpleNamespace(batch_size=16))
    for task, at_once in ((in_batches, 16), (None, 1)):
        monkeypatch.setattr(evaluation_view, "known_task", lambda *_, task=task: task)
        assert view_of(database, principal, first).evaluation.eta_s == pytest.approx(243 * 0.5 / at_once / 2)


def test_workers_that_are_lost_refusing_or_of_another_version_do_not_count_as_alive(
    database: Database, principal: Principal
) -> None:
    make_worker(database, state=WorkerState.REFUSING)
    make_worker(database, state=WorkerState.STOPPED)
    make_worker(database, evaluator_version="other")
    make_worker(database)
    with database.transaction() as session:
        session.execute(
            text("UPDATE workers SET heartbeat_at = now() - interval '1 hour' WHERE evaluator_version <> 'other'")
        )
    submission, _ = create(database, principal)
    view = view_of(database, principal, submission)
    assert view.workers.alive == 0
    assert view.workers.last_heartbeat_at is not None


def test_a_completed_evaluation_is_read_once_and_shown_to_each_as_far_as_they_may_see_it(
    database: Database, principal: Principal, monkeypatch: pytest.MonkeyPatch
) -> None:
    with database.transaction() as session:
        shown = submit_scored(session, principal, "model", {TASK: make_score(50)})
        evaluation = newest_evaluation(session, shown)
        report = {"task": TASK, "episode": 1, "stored_digest": "a" * 64, "differing_digest": "b" * 64}
        session.add(EpisodeDifference(evaluation_id=evaluation.id, **report))
        evaluation.log_tail = "printed"
    statements: list[int] = []
    for by, sealed, expected in (
        (principal, False, (False, None)),
        (principal, False, (False, None)),
        (CONSOLE, False, (False, 1)),
        (principal, True, (True, None)),
        (CONSOLE, True, (False, 1)),
        (principal, False, (False, None)),
    ):
        monkeypatch.setattr(visibility, "known_task", (lambda *_: None) if sealed else known_task)
        with database.transaction() as session:
            kind = ListKind.SEALED if sealed else ListKind.PUBLIC
            newest_evaluation(session, session.get_one(Submission, shown.id)).list_kind = kind
            session.flush()
            with database_work(session) as work:
                (item,) = listing.list_submissions(session, SETTINGS, by).items
            alone = listing.get(session, SETTINGS, by, shown.id)
        found, statements = item.evaluation, [*statements, work.statements]
        differing = None if found.differing_episodes is None else len(found.differing_episodes)
        assert (found.episodes_hidden, differing) == expected
        assert (found.list_kind, found.log_tail) == (kind, "")
        assert alone.evaluation.log_tail == ("" if found.episodes_hidden else "printed")
    assert statements[1] == statements[-1] < statements[0]
