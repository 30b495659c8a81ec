from datetime import UTC, datetime
from types import SimpleNamespace
from uuid import uuid4

import pytest
from database_work import database_work
from service_factories import (
    TASK,
    TRACK,
    add_result,
    claim,
    complete_scored,
    make_principal,
    make_record,
    make_score,
    play,
    store,
    submit_refuted_log,
    submit_scored,
)
from sqlalchemy import text
from submission_steps import SETTINGS, break_policy, create, ids_of, make_worker, refused, view_of
from vitac.envs.tasks.definition import Family
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.evaluator.logs.findings import VerificationResult
from vitac.evaluator.tracks import ListKind, load_track
from vitac.server import visibility
from vitac.server.database.engine import Database
from vitac.server.database.models import EpisodeDifference, Submission, Team
from vitac.server.database.states import EvaluationState, WorkerState
from vitac.server.errors import ProblemCode
from vitac.server.evaluations import view as evaluation_view
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.principals import CONSOLE, Principal
from vitac.server.submissions import listing, runs
from vitac.server.tracks import find_family, known_task


def test_foreign_submission_looks_like_a_missing_one(database: Database, principal: Principal) -> None:
    submission, _ = create(database, principal)
    with database.transaction() as session:
        other = make_principal(session, "Team B")
    for identity in (submission.id, uuid4()):
        for call in (
            lambda session, wanted: listing.get(session, SETTINGS, other, wanted),
            lambda session, wanted: runs.cancel(session, other, wanted),
            lambda session, wanted: listing.episodes(session, other, wanted),
            lambda session, wanted: listing.list_submissions(session, SETTINGS, other, before=wanted),
        ):
            with refused(ProblemCode.NOT_FOUND), database.transaction() as session:
                call(session, identity)
    assert view_of(database, CONSOLE, submission).id == submission.id


def test_lists_show_own_submissions_to_a_team_and_all_to_an_organizer_page_by_page(
    database: Database, principal: Principal
) -> None:
    with database.transaction() as session:
        other = make_principal(session, "Team B")
    mine = [create(database, principal, f"m{n}")[0].id for n in range(3)]
    theirs = create(database, other, "t")[0].id
    with database.transaction() as session:
        page = listing.list_submissions(session, SETTINGS, principal, limit=2)
        rest = listing.list_submissions(session, SETTINGS, principal, limit=2, before=page.next_before)
        assert [item.id for item in (*page.items, *rest.items)] == mine[::-1]
        assert rest.next_before is None
        assert len(listing.list_submissions(session, SETTINGS, CONSOLE).items) == 4
        of_b = listing.list_submissions(session, SETTINGS, CONSOLE, team="team b")
        assert [item.id for item in of_b.items] == [theirs]
        queued = listing.list_submissions(session, SETTINGS, CONSOLE, state=EvaluationState.QUEUED, track=TRACK)
        assert len(queued.items) == 4
        assert listing.list_submissions(session, SETTINGS, CONSOLE, state=EvaluationState.FAILED).items == []
        assert listing.list_submissions(session, SETTINGS, CONSOLE, track="other").items == []


def test_episodes_are_listed_in_order(database: Database, principal: Principal) -> None:
    submission, _ = create(database, principal)
    lease = claim(database, ids_of(database, submission)[0])
    store(database, lease, [make_record(4, EpisodeOutcome.TACTILE), make_record(2)])
    with database.transaction() as session:
        listed = listing.episodes(session, principal, submission.id)
    assert [(view.episode, view.outcome, view.success) for view in listed] == [
        (2, "success", True),
        (4, "tactile", False),
    ]


def test_episodes_of_a_completed_evaluation_are_read_once_and_shown_to_each_as_far_as_they_may_see_them(
    database: Database, principal: Principal, monkeypatch: pytest.MonkeyPatch
) -> None:
    submission, _ = create(database, principal)
    store(database, claim(database, ids_of(database, submission)[0]), [make_record(1)])
    with database.transaction() as session:
        complete_scored(session, session.get_one(Submission, submission.id), {TASK: make_score(1)})
    statements, found = [], []
    for by, is_sealed in ((principal, False), (principal, False), (CONSOLE, True), (principal, True)):
        monkeypatch.setattr(visibility, "known_task", (lambda *_: None) if is_sealed else known_task)
        with database.transaction() as session:
            shown = session.get_one(Submission, submission.id)
            evaluation = newest_evaluation(session, shown)
            evaluation.list_kind = ListKind.SEALED if is_sealed else ListKind.PUBLIC
            session.flush()
            with database_work(session) as work:
                found.append([view.episode for view in listing.list_episodes(session, by, evaluation)])
        statements.append(work.statements)
    assert found == [[1], [1], [1], []]
    assert statements == [1, 0, 0, 0]


def test_a_long_list_takes_no_more_statements_than_a_short_one(database: Database, principal: Principal) -> None:
    """Whatever its submissions are: scored, running, queued, logs that were refuted."""
    for number in range(4):
        with database.transaction() as session:
            submit_scored(session, principal, f"model {number}", {TASK: make_score(number)})
        with database.transaction() as session:
            submit_refuted_log(session, principal, f"log {number}")
    make_worker(database)
    for number in range(4):
        submission, _ = create(database, principal, f"runs {number}")
        store(database, claim(database, ids_of(database, submission)[0]), [make_record(1)])
        create(database, principal, f"waits {number}")
    statements = []
    for limit in (16, 10, 16):  # the first one reads the boards, too
        with database.transaction() as session, database_work(session) as work:
            found = listing.list_submissions(session, SETTINGS, CONSOLE, limit=limit).items
        assert len({item.evaluation.state for item in found}) == 4
        statements.append(work.statements)
    assert [item.evaluation.queue_position for item in found[:8]] == [4, None, 3, None, 2, None, 1, None]
    assert [item.evaluation.progress.episodes_done for item in found[:2]] == [0, 1]
    assert [item.log.verdict for item in found if item.log] == [VerificationResult.DIVERGED] * 4
    assert statements[1] == statements[2] < statements[0] < 20


def test_who_can_run_the_same_is_found_once_for_a_whole_list(
    database: Database, principal: Principal, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And for each evaluator version on its own."""
    older = create(database, principal, "of an older version")[0]
    for number in range(5):
        create(database, principal, f"waits {number}")
    make_worker(database)
    with database.transaction() as session:
        newest_evaluation(session, older).evaluator_version = "1+older"
    asked: list[str] = []

    def noted(track: str, task: str) -> Family:
        asked.append(task)
        return find_family(track, task)

    monkeypatch.setattr("vitac.server.submissions.listing.find_family", noted)
    with database.transaction() as session:
        items = listing.list_submissions(session, SETTINGS, principal).items
    assert [item.workers.alive for item in items] == [1] * 5 + [0]
    assert len({item.workers.last_heartbeat_at for item in items}) == 1
    assert asked == [*items[0].tasks, *items[-1].tasks]


@pytest.mark.slow
def test_a_teams_list_reads_no_other_teams_rows_and_no_output(database: Database, principal: Principal) -> None:
    with database.transaction() as session:
        for other in range(20):
            stranger = session.get_one(Team, make_principal(session, f"Team {other}").team_id)
            for number in range(10):
                add_result(session, number, stranger, {TASK: make_score(number)}, datetime.now(UTC))
        for number in range(30):
            submit_scored(session, principal, f"model {number}", {TASK: make_score(number)})
        session.execute(text("UPDATE evaluations SET log_tail = 'printed'"))
    with database.transaction() as session:
        session.execute(text("ANALYZE"))
    with database.transaction() as session, database_work(session) as work:
        found = listing.list_submissions(session, SETTINGS, principal, limit=5).items
    assert work.rows_read["submissions"] <= 6 + 2  # PostgreSQL looks at some while it plans the query of copies
    assert work.rows_read["evaluations"] <= 6 + 1
    assert {item.evaluation.log_tail for item in found} == {""}
    with database.transaction() as session, database_work(session) as work:
        assert listing.get(session, SETTINGS, principal, found[0].id).evaluation.log_tail == "printed"
    assert work.statements <= 6
    assert work.rows_read["submissions"] <= 2 + 1
    assert work.rows_read["evaluations"] <= 3


def test_what_was_drawn_for_an_episode_is_listed_with_it(
    database: Database, principal: Principal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(listing, "known_track", lambda _: load_track("track_1_peg_robust"))
    submission, _ = create(database, principal)
    lease = claim(database, ids_of(database, submission)[0])
    record = make_record(2)
    infos = tuple(info | {"draws": {"clearance_mm": 0.75}} for info in record.infos)
    store(database, lease, [record.model_copy(update={"infos": infos}), make_record(4)])
    with database.transaction() as session:
        listed = listing.episodes(session, principal, submission.id)
    assert [view.draws for view in listed] == [{"clearance_mm": 0.75}, {}]


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
