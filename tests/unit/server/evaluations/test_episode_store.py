from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from service_factories import claim, make_principal, make_record, sha256, shard_ids, state_of, store, submit, take_away
from sqlalchemy import event, select, text
from vitac.evaluator.episodes.records import ActionSequence, EpisodeOutcome
from vitac.server.database.engine import Database
from vitac.server.database.locks import lock_evaluation
from vitac.server.database.models import EpisodeResult
from vitac.server.database.states import WorkState
from vitac.server.evaluations.episode_store import (
    OUTPUT_CHARACTERS,
    half_way_state,
    missing_episodes,
    store_episodes,
    stored_episodes,
)
from vitac.server.queue.leases import Lease


@pytest.fixture
def shard_id(database: Database) -> int:
    with database.transaction() as session:
        return shard_ids(session, submit(session, make_principal(session)))[0]


def test_episode_delivered_twice_is_one_row_and_the_first_one_counts(database: Database, shard_id: int) -> None:
    lease = claim(database, shard_id)
    store(database, lease, [make_record(1), make_record(1), make_record(1, EpisodeOutcome.STEPS)])
    with database.transaction() as session:
        rows = session.scalars(select(EpisodeResult)).all()
        assert [(row.episode, row.outcome) for row in rows] == [(1, "success")]


def test_stored_episodes_are_known_to_the_next_claim(database: Database, shard_id: int) -> None:
    store(database, claim(database, shard_id), [make_record(2), make_record(7)])
    take_away(database, shard_id)
    lease = claim(database, shard_id)
    with database.transaction() as session:
        stored = stored_episodes(session, lease)
    assert stored.numbers == {2, 7}
    assert stored.failures == ()


def test_the_end_of_the_output_is_kept_beside_the_record(database: Database, shard_id: int) -> None:
    lease = claim(database, shard_id)
    store(database, lease, [make_record(1, output="first\0" + "x" * OUTPUT_CHARACTERS), make_record(2, output="a\0b")])
    with database.transaction() as session:
        rows = session.scalars(select(EpisodeResult).order_by(EpisodeResult.episode)).all()
        assert [row.output for row in rows] == ["x" * OUTPUT_CHARACTERS, "a\N{REPLACEMENT CHARACTER}b"]
        assert all("output" not in row.record for row in rows)


def test_episodes_are_stored_together_and_known_ones_left_as_they_are(database: Database, shard_id: int) -> None:
    lease = claim(database, shard_id)
    store(database, lease, [make_record(2)])
    with database.transaction() as session:
        store_episodes(session, lease, [make_record(3), make_record(2, EpisodeOutcome.STEPS), make_record(1)])
    with database.transaction() as session:
        rows = session.scalars(select(EpisodeResult).order_by(EpisodeResult.episode)).all()
        assert [(row.episode, row.outcome) for row in rows] == [(1, "success"), (2, "success"), (3, "success")]
        assert missing_episodes(session, lease) == list(range(4, 28))


def test_the_statement_that_stores_is_built_once_for_any_number_of_episodes(database: Database, shard_id: int) -> None:
    lease = claim(database, shard_id)
    built = set()

    def note(*arguments: Any) -> None:
        _, _, statement, _, context, _ = arguments
        if statement.startswith("INSERT INTO episode_results"):
            built.add(context.compiled)

    event.listen(database.engine, "before_cursor_execute", note)
    for numbers in ([1], [2, 3], [3, 4, 5, 6], [6]):
        store(database, lease, [make_record(number) for number in numbers])
    with database.transaction() as session:
        assert missing_episodes(session, lease) == list(range(7, 28))
    assert len(built) == 1
    assert None not in built


def test_evaluations_of_one_content_store_the_same_episodes_at_once_without_a_deadlock(
    database: Database, shard_id: int
) -> None:
    """Each in another order; a deadlock would be an error of one of the two."""
    lease, other = claim(database, shard_id), claim(database, shard_id + 1)
    numbers = range(1, 28)

    def storing(held: Lease, order: list[int]) -> None:
        with database.transaction() as session:
            store_episodes(session, held, [make_record(number) for number in order])

    with ThreadPoolExecutor(2) as threads:
        both = [
            threads.submit(storing, lease, list(numbers)),
            threads.submit(storing, other, list(reversed(numbers))),
        ]
        for each in both:
            each.result(120.0)
    with database.transaction() as session:
        assert missing_episodes(session, lease) == []


def test_storing_and_cancelling_at_once_do_not_wait_for_each_other(database: Database, shard_id: int) -> None:
    lease = claim(database, shard_id)
    with database.transaction() as storing:
        store_episodes(storing, lease, [make_record(1)])
        with database.transaction() as locking:
            locking.execute(text("SET LOCAL lock_timeout = 2000"))
            lock_evaluation(locking, lease.evaluation_id)
    with database.transaction() as session:
        assert state_of(session, shard_id) is WorkState.RUNNING


@pytest.mark.parametrize(("env_steps", "half_way"), [(0, 0), (1, 1), (2, 1), (3, 2), (4, 2), (15, 8)])
def test_the_state_half_way_is_that_after_half_of_the_env_steps_rounded_up(env_steps: int, half_way: int) -> None:
    """With an env step it is never the state of the reset, which episodes of one start have in common."""
    states = tuple(sha256(f"state {number}") for number in range(env_steps + 1))
    actions = ActionSequence.from_array(np.zeros((env_steps, 3), np.float32))
    record = make_record(1, env_steps=env_steps, actions=actions, infos=({},) * env_steps, state_hashes=states)
    assert half_way_state(record) == states[half_way]
