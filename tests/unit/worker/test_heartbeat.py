import threading

import pytest
from sqlalchemy import text
from structlog.testing import capture_logs
from vitac.server.database.schema import newest_revision
from vitac.server.database.states import WorkerState
from vitac.server.services import Services
from vitac.worker.capabilities import IsolationReport
from vitac.worker.heartbeat import Heartbeat


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "installed"),
    [("UPDATE alembic_version SET version_num = '0001'", "0001"), ("DELETE FROM alembic_version", "none")],
    ids=["older", "emptied"],
)
def test_worker_of_another_schema_ends_and_says_which_it_expected(
    services: Services, change: str, installed: str
) -> None:
    ended = threading.Event()
    report = IsolationReport(level="none", problems=())
    heartbeat = Heartbeat(services, state=WorkerState.READY, report=report, on_upgrade=ended.set)
    with capture_logs() as logs:
        heartbeat.start()
        assert not ended.wait(0.3)
        with services.database.transaction() as session:
            session.execute(text(change))
        assert ended.wait(120.0)
        heartbeat.stop()
    (said,) = [line["message"] for line in logs if line["event"] == "other_schema"]
    assert said.startswith(f"The database has schema {installed}, expected {newest_revision()}.")
