"""The one statement that gives out work: in turn, by kind within its share, to one worker, to whom that can do it."""

import threading
from collections.abc import Callable, Iterator
from uuid import UUID, uuid4

import pytest
from asked_playbacks import Played, played
from service_factories import (
    claim,
    finish,
    make_principal,
    make_record,
    make_settings,
    shard_ids,
    store,
    submit,
    take,
)
from sqlalchemy import select, text, update
from sqlalchemy.orm import Session
from submission_steps import make_worker, view_of
from vitac.evaluator.version import evaluator_version
from vitac.server.database.engine import Database
from vitac.server.database.models import Evaluation, SensorCheck, Shard, Submission, Work
from vitac.server.database.states import WorkKind, WorkState
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.principals import CONSOLE, Principal
from vitac.server.queue import work
from vitac.server.queue.work import KINDS, Claim, name_requirement

MANY, SMALL_TEAMS = 10, 6
HERE = name_requirement(evaluator_version())
SETTINGS = make_settings(lease_s=60.0)


@pytest.fixture
def busy(database: Database) -> Principal:
    """A team that has submitted much."""
    with database.transaction() as session:
        principal = make_principal(session, "busy")
        for number in range(MANY):
            submit(session, principal, f"busy {number}")
    return principal


def submit_small(database: Database, teams: int = SMALL_TEAMS) -> list[Submission]:
    with database.transaction() as session:
        return [submit(session, make_principal(session, f"small {number}"), "one") for number in range(teams)]


def next_claim(database: Database, *abilities: str) -> Claim | None:
    with database.transaction() as session:
        over_share = work.list_over_share(session, SETTINGS)
    return work.claim(database, SETTINGS, uuid4(), abilities or (HERE,), over_share)


def started(database: Database) -> Iterator[UUID]:
    """Submissions in the order in which workers start them."""
    known = set()
    while (claimed := next_claim(database)) is not None:
        with database.transaction() as session:
            submission_id = session.get_one(Shard, claimed.work_id).evaluation.submission_id
        if submission_id not in known:
            known.add(submission_id)
            yield submission_id


def start(database: Database, count: int) -> list[UUID]:
    order = started(database)
    return [next(order) for _ in range(count)]


def ids(submissions: list[Submission]) -> list[UUID]:
    return [submission.id for submission in submissions]


def test_teams_with_one_submission_need_not_wait_for_all_of_a_busy_team(database: Database, busy: Principal) -> None:
    small = submit_small(database)
    order = start(database, SMALL_TEAMS + 1)
    assert set(ids(small)) < set(order)
    for submission in small:
        assert order.index(submission.id) <= SMALL_TEAMS


def test_of_one_team_and_of_one_turn_the_earlier_goes_first(database: Database, busy: Principal) -> None:
    small = submit_small(database, 3)
    assert start(database, 4)[1:] == ids(small)


def test_who_comes_later_shares_from_then_on_and_does_not_overtake(database: Database, busy: Principal) -> None:
    start(database, 5)
    with database.transaction() as session:
        late = make_principal(session, "late")
        theirs = ids([submit(session, late, f"late {number}") for number in range(3)])
    # First the rest of the busy team's fifth, which is running and whose turn the newcomer's first shares.
    order = start(database, 7)[1:]
    assert [submission in theirs for submission in order] == [True, False] * 3


def test_shard_that_comes_back_goes_first(database: Database, busy: Principal) -> None:
    (small,) = submit_small(database, 1)
    with database.transaction() as session:
        last = shard_ids(session, small)[-1]
    lease = claim(database, last)
    with database.transaction() as session:
        work.hand_back(session, lease)
    claimed = next_claim(database)
    assert claimed is not None
    assert (claimed.work_id, claimed.token, claimed.attempt) == (last, 2, 1)


def test_place_in_the_queue_is_by_turn(database: Database, busy: Principal) -> None:
    (small,) = submit_small(database, 1)
    assert view_of(database, CONSOLE, small).evaluation.queue_position == 2


def test_turns_begin_anew_when_nothing_waits(database: Database) -> None:
    def turn(session: Session, content: str) -> int:
        return newest_evaluation(session, submit(session, principal, content)).turn

    with database.transaction() as session:
        principal = make_principal(session)
        assert [turn(session, content) for content in "abc"] == [0, 1, 2]
        session.execute(text("UPDATE work SET state = 'cancelled', finished_at = now()"))
        assert turn(session, "d") == 0


def test_each_of_many_claims_at_once_gets_work_of_its_own(database: Database) -> None:
    with database.transaction() as session:
        waiting = set(shard_ids(session, submit(session, make_principal(session))))
    got: list[int] = []

    def take_all() -> None:
        while (claimed := next_claim(database)) is not None:
            got.append(claimed.work_id)

    in_threads(take_all, 8)
    assert len(got) == len(waiting)
    assert set(got) == waiting
    assert next_claim(database) is None


def in_threads(run: Callable[[], object], count: int) -> None:
    threads = [threading.Thread(target=run) for _ in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def test_a_worker_gets_only_what_it_can_do_and_nothing_that_is_over(database: Database) -> None:
    with database.transaction() as session:
        (first, *others) = shard_ids(session, submit(session, make_principal(session)))
        session.execute(update(Work).where(Work.id.in_(others)).values(state=WorkState.CANCELLED))
    assert next_claim(database, "yesterday tactile") is None
    lease = claim(database, first)
    store(database, lease, (make_record(episode) for episode in lease.episodes))
    finish(database, lease)
    assert next_claim(database) is None


def test_work_that_has_to_wait_is_not_taken_before(database: Database) -> None:
    with database.transaction() as session:
        (first, *others) = shard_ids(session, submit(session, make_principal(session)))
        session.execute(update(Work).where(Work.id == first).values(not_before=text("now() + interval '1 hour'")))
    claimed = next_claim(database)
    assert claimed is not None
    assert claimed.work_id == others[0]


def test_a_playback_does_not_wait_for_evaluations(database: Database) -> None:
    team = played(database)
    playback = team.ask(1)
    claimed = next_claim(database)
    assert claimed is not None
    assert (claimed.kind, claimed.work_id) == (WorkKind.PLAYBACK, playback.id)
    claimed = next_claim(database)
    assert claimed is not None
    assert claimed.kind is WorkKind.SHARD


@pytest.mark.parametrize(("slots", "kind"), [(1, WorkKind.SHARD), (1000, WorkKind.PLAYBACK)])
def test_playbacks_have_a_share_of_all_slots_and_then_wait_for_evaluations(
    database: Database, slots: int, kind: WorkKind
) -> None:
    make_worker(database, slots=slots)
    team = played(database)
    done = team.ask(1).id
    take_for(database, done, seconds=work.SHARED_OVER_S / 2)
    team.ask(2)
    claimed = next_claim(database)
    assert claimed is not None
    assert claimed.kind is kind


def test_what_is_over_its_share_is_done_when_nothing_else_waits(database: Database) -> None:
    team = played(database)
    take_for(database, team.ask(1).id, seconds=work.SHARED_OVER_S)
    second = team.ask(2)
    with database.transaction() as session:
        session.execute(text("UPDATE work SET state = 'cancelled' WHERE kind = 'shard' AND state = 'queued'"))
    claimed = next_claim(database)
    assert claimed is not None
    assert claimed.work_id == second.id


def test_a_share_comes_back_with_time(database: Database) -> None:
    team = played(database)
    take_for(database, team.ask(1).id, seconds=work.SHARED_OVER_S, ago_s=2 * work.SHARED_OVER_S)
    second = team.ask(2)
    claimed = next_claim(database)
    assert claimed is not None
    assert claimed.work_id == second.id


def take_for(database: Database, work_id: int, *, seconds: float, ago_s: float = 0.0) -> None:
    """Lets some work have taken a slot for a time."""
    with database.transaction() as session:
        claimed = take(session, work_id)
        work.end(session, claimed, WorkState.FAILED, problem="It took long.")
        session.execute(
            text(
                "UPDATE work SET finished_at = now() - :ago * interval '1 s', "
                "started_at = now() - (:ago + :seconds) * interval '1 s' WHERE id = :id"
            ),
            {"ago": ago_s, "seconds": seconds, "id": work_id},
        )


def add_checks(session: Session, *submissions: Submission) -> list[int]:
    """A check of a sensor for each submission."""
    checks = []
    for submission in submissions:
        evaluation = newest_evaluation(session, submission)
        columns = work.waiting(session, WorkKind.SENSOR_CHECK, owner=f"team:{submission.team_id}", requires=HERE)
        checks.append(SensorCheck(evaluation_id=evaluation.id, **columns))
    session.add_all(checks)
    session.flush()
    return [check.id for check in checks]


def test_one_check_of_a_team_runs_at_a_time_and_keeps_nobody_else_waiting(database: Database) -> None:
    with database.transaction() as session:
        ants, bees = make_principal(session, "Ants"), make_principal(session, "Bees")
        first, second, other = add_checks(
            session, submit(session, ants, "a"), submit(session, ants, "b"), submit(session, bees, "c")
        )
    claims = [next_claim(database) for _ in range(3)]
    assert [claimed and (claimed.kind, claimed.work_id) for claimed in claims[:2]] == [
        (WorkKind.SENSOR_CHECK, first),
        (WorkKind.SENSOR_CHECK, other),
    ]
    assert claims[2] is not None
    assert claims[2].kind is WorkKind.SHARD, "the team's second check waits for its first one"
    with database.transaction() as session:
        assert claims[0] is not None
        work.end(session, claims[0], WorkState.DONE)
    claimed = next_claim(database)
    assert claimed is not None
    assert claimed.work_id == second


def test_of_two_workers_at_once_one_gets_the_place_of_a_team(database: Database) -> None:
    with database.transaction() as session:
        ants = make_principal(session, "Ants")
        add_checks(session, *(submit(session, ants, str(number)) for number in range(8)))
        session.execute(text("DELETE FROM work WHERE kind = 'shard'"))
    barrier, got = threading.Barrier(8), []

    def run() -> None:
        barrier.wait()
        got.append(next_claim(database))

    in_threads(run, 8)
    assert len([claimed for claimed in got if claimed is not None]) == 1


def test_the_index_of_places_is_of_the_kinds_that_have_one(database: Database) -> None:
    with database.transaction() as session:
        query = text("SELECT indexdef FROM pg_indexes WHERE indexname = 'uq_work_place'")
        definition = str(session.scalar(query))
    named = [kind for kind in WorkKind if f"'{kind}'" in definition]
    assert named == [kind for kind, found in KINDS.items() if found.one_per_owner]


def test_shares_leave_evaluations_a_part() -> None:
    assert set(KINDS) == set(WorkKind)
    assert sum(kind.share or 0.0 for kind in KINDS.values()) <= 0.6


def test_an_attempt_cannot_be_renewed_beyond_the_limit_of_its_kind(database: Database) -> None:
    with database.transaction() as session:
        (check,) = add_checks(session, submit(session, make_principal(session)))
        claimed = take(session, check)
    limit_s = KINDS[WorkKind.SENSOR_CHECK].limit_s
    with database.transaction() as session:
        session.execute(
            text("UPDATE work SET started_at = now() - :limit * interval '1 s' WHERE id = :id"),
            {"limit": limit_s, "id": check},
        )
        work.renew(session, claimed, 3600.0)
        work.renew(session, claimed, 1.0)
        left_s = session.scalar(
            text("SELECT extract(epoch FROM lease_expires_at - now()) FROM work WHERE id = :id"), {"id": check}
        )
    assert left_s is not None
    assert float(left_s) < 2.0


def test_shards_of_one_evaluation_know_its_turn(database: Database, busy: Principal) -> None:
    with database.transaction() as session:
        rows = session.execute(select(Shard.turn, Evaluation.turn).join(Shard.evaluation)).all()
    assert {own == of_evaluation for own, of_evaluation in rows} == {True}


@pytest.fixture
def team(database: Database) -> Played:
    return played(database)


def test_the_listener_hears_of_what_waits(database: Database, team: Played) -> None:
    import psycopg

    with psycopg.connect(database.address, autocommit=True) as connection:
        connection.execute(f"LISTEN {work.CHANNEL}")
        team.ask(1)
        assert [found.channel for found in connection.notifies(timeout=10.0, stop_after=1)] == [work.CHANNEL]
