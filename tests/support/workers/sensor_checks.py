"""Checks the sensors of submissions as a worker does."""

from service_factories import take
from sqlalchemy import select
from vitac.server.database.models import SensorCheck
from vitac.server.database.states import WorkState
from vitac.server.queue import leases
from vitac.server.services import Services
from vitac.worker.leased_run import RunEnd
from vitac.worker.short_runs import SensorCheckRun
from vitac.worker.staging import SubmissionStage


def check_sensors(services: Services) -> list[RunEnd]:
    """Does all checks that wait, and returns how they ended."""
    ends = []
    with services.database.transaction() as session:
        waiting = session.scalars(select(SensorCheck.id).where(SensorCheck.state == WorkState.QUEUED)).all()
    for check in sorted(waiting):
        with services.database.transaction() as session:
            lease = leases.begin_check(session, take(session, check))
        stage = SubmissionStage(services.blobs, services.settings.scratch_dir, services.settings.limits)
        ends.append(SensorCheckRun(services, stage, lease).run())
        stage.close()
    return ends
