"""A team's shards of a sealed list never run beside its public ones."""

import threading
from uuid import uuid4

import pytest
from service_factories import make_principal, make_settings, submit
from sqlalchemy import select, update
from vitac.evaluator.isolation_kinds import IsolationKind
from vitac.evaluator.version import evaluator_version
from vitac.server.database.engine import Database
from vitac.server.database.models import Shard, Work
from vitac.server.database.states import WorkState
from vitac.server.queue.work import Claim, claim, name_requirement


def requirements(isolation: IsolationKind) -> list[str]:
    """Of a shard of the public list, and of one of a sealed list."""
    return [name_requirement(evaluator_version(), sealed=sealed, isolation=isolation) for sealed in (False, True)]


HERE = [need for kind in (IsolationKind.NAMESPACES, IsolationKind.VM) for need in requirements(kind)]


def next_claim(database: Database) -> Claim | None:
    return claim(database, make_settings(), uuid4(), HERE)


def queue_both(database: Database, team: str = "Ants", isolation: IsolationKind = IsolationKind.NAMESPACES) -> None:
    """A public evaluation of a team, of which every second shard is said to be of a sealed list."""
    with database.transaction() as session:
        submit(session, make_principal(session, team))
        ids = session.scalars(select(Shard.id).order_by(Shard.id)).all()
        for each, requires in zip((ids[::2], ids[1::2]), requirements(isolation), strict=True):
            session.execute(update(Work).where(Work.id.in_(each)).values(requires=requires))


def running(database: Database) -> set[bool]:
    with database.transaction() as session:
        found = session.scalars(select(Work.requires).where(Work.state == WorkState.RUNNING))
        return {" sealed" in requires for requires in found}


@pytest.mark.parametrize("isolation", [IsolationKind.NAMESPACES, IsolationKind.VM])
def test_while_one_kind_of_list_runs_the_other_waits(database: Database, isolation: IsolationKind) -> None:
    queue_both(database, isolation=isolation)
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
