"""A team's shards of a sealed list never run beside its public ones."""

import threading
from uuid import uuid4

from service_factories import make_principal, make_settings, submit
from sqlalchemy import select, update
from vitac.evaluator.version import evaluator_version
from vitac.server.database.engine import Database
from vitac.server.database.models import Shard, Work
from vitac.server.database.states import WorkState
from vitac.server.queue.work import Claim, claim, name_requirement

HERE = [name_requirement(evaluator_version(), sealed=sealed) for sealed in (False, True)]


def next_claim(database: Database) -> Claim | None:
    return claim(database, make_settings(), uuid4(), HERE)


def queue_both(database: Database, team: str = "Ants") -> None:
    """A public evaluation of a team, of which every second shard is said to be of a sealed list."""
    with database.transaction() as session:
        submit(session, make_principal(session, team))
        ids = session.scalars(select(Shard.id).order_by(Shard.id)).all()
        session.execute(update(Work).where(Work.id.in_(ids[1::2])).values(requires=HERE[1]))


def running(database: Database) -> set[bool]:
    with database.transaction() as session:
        found = session.scalars(select(Work.requires).where(Work.state == WorkState.RUNNING))
        return {requires.endswith(" sealed") for requires in found}


def test_while_one_kind_of_list_runs_the_other_waits(database: Database) -> None:
    queue_both(database)
    taken = [next_claim(database) for _ in range(10)]
    assert [claimed is not None for claimed in taken] == [True] * 5 + [False] * 5
    assert running(database) == {False}
    with database.transaction() as session:
        session.execute(
            update(Work).where(Work.state == WorkState.RUNNING).values(state=WorkState.CANCELLED, lease_expires_at=None)
        )
    assert next_claim(database) is not None
    assert running(database) == {True}


def test_of_claims_at_the_same_moment_only_those_of_one_kind_stand(database: Database) -> None:
    queue_both(database)
    threads = [threading.Thread(target=next_claim, args=(database,)) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(running(database)) == 1
