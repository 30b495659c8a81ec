"""A worker that makes results up instead of simulating, for tests of what surrounds it: `python quick_worker.py [PID]`.

`VITAC_TEST_WORKER=refuses` makes it one whose sandbox does not hold.
"""

import os
import signal
import threading

from service_factories import make_record, play
from sqlalchemy import select
from vitac.evaluator.episodes.records import EpisodeOutcome, EpisodeRecord
from vitac.evaluator.version import evaluator_version, platform_class
from vitac.server.database.engine import Database
from vitac.server.database.models import Evaluation, Shard, Worker
from vitac.server.database.states import EvaluationState, WorkerState
from vitac.server.settings import load_settings

ISOLATION = "user: root, memory: cgroup-v1, episodes: frozen-copy"


def record_of(episode: int, *, task: str) -> EpisodeRecord:
    """Two of three succeed."""
    return make_record(episode, EpisodeOutcome.TACTILE if episode % 3 == 0 else EpisodeOutcome.SUCCESS, task)


def main() -> None:
    """Plays whatever is queued until SIGTERM."""
    address = load_settings().database_url
    assert address is not None, "VITAC_DATABASE_URL names the test's database"
    stopping = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stopping.set())
    database = Database(address.get_secret_value())
    refuses = os.environ.get("VITAC_TEST_WORKER") == "refuses"
    with database.transaction() as session:
        session.add(_row(WorkerState.REFUSING if refuses else WorkerState.READY))
    while not stopping.wait(0.05):
        if not refuses:
            play_queued(database)


def play_queued(database: Database) -> None:
    """Plays the evaluations that wait."""
    with database.transaction() as session:
        of_queued = select(Shard.id).join(Evaluation).where(Evaluation.state == EvaluationState.QUEUED)
        shards = session.scalars(of_queued.order_by(Shard.id)).all()
    for shard in shards:
        play(database, shard, record_of)


def _row(state: WorkerState) -> Worker:
    return Worker(
        host="test",
        pid=os.getpid(),
        slots=1,
        state=state,
        evaluator_version=evaluator_version(),
        platform_class=platform_class(),
        isolation=ISOLATION,
        message="The sandbox is not sound." if state is WorkerState.REFUSING else "",
    )


if __name__ == "__main__":
    main()
