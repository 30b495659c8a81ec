from collections.abc import Iterator
from uuid import UUID, uuid4

import pytest
from service_factories import claim, make_principal, make_settings, shard_ids, submit
from sqlalchemy import text
from sqlalchemy.orm import Session
from submission_steps import view_of
from vitac.evaluator.version import evaluator_version
from vitac.server.database.engine import Database
from vitac.server.database.models import Shard, Submission
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.evaluations.lifecycle import fail_by_machines
from vitac.server.principals import CONSOLE, Principal
from vitac.server.queue import leases
from vitac.server.queue.jobs import queue_name
from vitac.server.queue.sweep import sweep

MANY, SMALL_TEAMS = 40, 20


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


def started(database: Database) -> Iterator[UUID]:
    """Submissions in the order in which workers start them; each shard is claimed as a worker does."""
    known = set()
    while (shard_id := fetch(database)) is not None:
        with database.transaction() as session:
            assert leases.claim(session, shard_id, uuid4(), 60.0)
            submission_id = session.get_one(Shard, shard_id).evaluation.submission_id
        if submission_id not in known:
            known.add(submission_id)
            yield submission_id


def fetch(database: Database) -> int | None:
    """The shard of the next job, by the function of the queue that workers call."""
    query = text("SELECT (args ->> 'shard_id')::bigint FROM procrastinate_fetch_job_v2(ARRAY[:queue], NULL)")
    with database.transaction() as session:
        found: int | None = session.scalar(query, {"queue": queue_name(evaluator_version())})
    return found


def take(database: Database, count: int) -> list[UUID]:
    order = started(database)
    return [next(order) for _ in range(count)]


def ids(submissions: list[Submission]) -> list[UUID]:
    return [submission.id for submission in submissions]


def test_teams_with_one_submission_need_not_wait_for_all_of_a_busy_team(database: Database, busy: Principal) -> None:
    small = submit_small(database)
    order = take(database, SMALL_TEAMS + 1)
    assert set(ids(small)) < set(order)
    for submission in small:
        assert order.index(submission.id) <= SMALL_TEAMS


def test_of_one_team_and_of_one_turn_the_earlier_goes_first(database: Database, busy: Principal) -> None:
    small = submit_small(database, 3)
    assert take(database, 4)[1:] == ids(small)


def test_who_comes_later_shares_from_then_on_and_does_not_overtake(database: Database, busy: Principal) -> None:
    take(database, 5)
    with database.transaction() as session:
        late = make_principal(session, "late")
        theirs = ids([submit(session, late, f"late {number}") for number in range(3)])
    # First the rest of the busy team's fifth, which is running and whose turn the newcomer's first shares.
    order = take(database, 7)[1:]
    assert [submission in theirs for submission in order] == [True, False] * 3


def test_woken_shards_keep_their_turn(database: Database, busy: Principal) -> None:
    small = submit_small(database, 2)
    settings = make_settings(lease_s=0.003, lease_renewal_s=0.001)
    with database.transaction() as session:
        lost = session.execute(text("DELETE FROM procrastinate_jobs RETURNING id")).all()
    with database.transaction() as session:
        session.execute(text("SELECT pg_sleep(0.01)"))
        assert sweep(session, settings, give_up=fail_by_machines).woken == len(lost)
    assert take(database, 3)[1:] == ids(small)


def test_shard_that_comes_back_goes_first(database: Database, busy: Principal) -> None:
    (small,) = submit_small(database, 1)
    with database.transaction() as session:
        last = shard_ids(session, small)[-1]
    lease = claim(database, last)
    with database.transaction() as session:
        leases.hand_back(session, lease, counts_as_attempt=False)
    assert fetch(database) == last


def test_place_in_the_queue_is_by_turn(database: Database, busy: Principal) -> None:
    (small,) = submit_small(database, 1)
    assert view_of(database, CONSOLE, small).evaluation.queue_position == 2


def test_turns_begin_anew_when_nothing_waits(database: Database) -> None:
    def turn(session: Session, content: str) -> int:
        return newest_evaluation(session, submit(session, principal, content)).turn

    with database.transaction() as session:
        principal = make_principal(session)
        assert [turn(session, content) for content in "abc"] == [0, 1, 2]
        session.execute(text("UPDATE evaluations SET state = 'cancelled', finished_at = now()"))
        assert turn(session, "d") == 0
