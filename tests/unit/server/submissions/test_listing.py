from datetime import UTC, datetime
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
    store,
    submit_refuted_log,
    submit_scored,
)
from sqlalchemy import text
from submission_steps import SETTINGS, create, ids_of, make_worker, refused, view_of
from vitac.envs.tasks.definition import Family
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.evaluator.logs.findings import VerificationResult
from vitac.evaluator.tracks import ListKind, load_track
from vitac.server import visibility
from vitac.server.database.engine import Database
from vitac.server.database.models import Submission, Team
from vitac.server.database.states import EvaluationState
from vitac.server.errors import ProblemCode
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

    monkeypatch.setattr("vitac.server.submissions.view.find_family", noted)
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
