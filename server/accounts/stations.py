"""Stations: each has a key of its own, and one agent at a time that plays with it."""

import hashlib
import os
import platform
import secrets
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from typing import Final
from uuid import UUID

from sqlalchemy import delete, select
from sqlalchemy.orm import Session

from .. import names
from ..audit import record
from ..database.clock import read_clock
from ..database.models import LivePicture, Station, Worker
from ..database.states import WorkerState
from ..errors import ProblemCode, ServiceError, not_found
from ..principals import Principal
from ..settings import Settings

PREFIX: Final = "station_"
_KEY_BYTES: Final = 32
_NAME_LENGTH: Final = 64
CLOCK_TOLERANCE: Final = timedelta(seconds=30)
"""Largest difference between a station's clock and the database's."""


def add_station(session: Session, by: Principal, name: str) -> str:
    """Add a station and return its key, which nobody can read again.

    Raises:
        ServiceError: not an organizer, the name cannot be shown, or there is one of that name.
    """
    by.require_organizer()
    name = names.clean(name, what="A station's name", min_length=1, max_length=_NAME_LENGTH)
    if session.get(Station, name) is not None:
        raise ServiceError(ProblemCode.NAME_TAKEN, f"There is a station {name} already; choose another name.")
    key = PREFIX + secrets.token_urlsafe(_KEY_BYTES)
    session.add(Station(name=name, key_sha256=_digest(key)))
    record(session, by, "station.add", name, {"name": name})
    return key


def remove_station(session: Session, by: Principal, name: str) -> None:
    """Remove a station; an agent with its key is refused from its next start on.

    Raises:
        ServiceError: not an organizer, or there is none of that name.
    """
    by.require_organizer()
    station = session.get(Station, name)
    if station is None:
        raise not_found("station", name)
    session.delete(station)
    record(session, by, "station.remove", name, {}, before={"name": name})


def list_stations(session: Session) -> Sequence[Station]:
    """Return all stations by name."""
    return session.scalars(select(Station).order_by(Station.name)).all()


def enrol(session: Session, settings: Settings, key: str, worker_id: UUID, twin: str | None) -> str:
    """Make a worker the agent of the station with a key, and return the station's name.

    Pictures from before it became a twin, another one or hardware are deleted: nobody may take them for the station's.

    Args:
        session: of the transaction.
        settings: of the service.
        key: of the station.
        worker_id: of the agent.
        twin: what kind of twin it plays on, in words; None for hardware.

    Raises:
        ServiceError: no station has this key, its clock is wrong, or another agent has it and is alive.
    """
    station = session.scalar(select(Station).where(Station.key_sha256 == _digest(key)).with_for_update())
    if station is None:
        raise _refusal("No station has this key. Ask an organizer for one: vitac admin station add NAME.")
    _refuse_wrong_clock(session)
    other = session.get(Worker, station.worker_id) if station.worker_id not in (None, worker_id) else None
    if other is not None and _is_alive(session, settings, other):
        raise _refusal(
            f"The key of station {station.name} is in use by process {other.pid} on {other.host}, which was heard at "
            f"{other.heartbeat_at:%H:%M:%S} UTC. End that agent; one that died can be followed after "
            f"{settings.worker_lost_after_s:g} s."
        )
    if station.twin != twin:
        session.execute(delete(LivePicture).where(LivePicture.station == station.name))
    station.worker_id, station.twin = worker_id, twin
    return station.name


def _refuse_wrong_clock(session: Session) -> None:
    here = datetime.now(UTC)
    difference = here - read_clock(session)
    if abs(difference) > CLOCK_TOLERANCE:
        raise _refusal(
            f"The clock of this station is off by {difference.total_seconds():.0f} s from the database's: expected at "
            f"most {CLOCK_TOLERANCE.total_seconds():.0f} s. Set it, best by NTP, and start the agent again."
        )


def _is_alive(session: Session, settings: Settings, worker: Worker) -> bool:
    """Say whether an agent runs: one that died on this machine is known at once, another one by its heartbeat."""
    now = read_clock(session)
    silent = now - worker.heartbeat_at > timedelta(seconds=settings.worker_lost_after_s)
    if worker.state is WorkerState.STOPPED or silent:
        return False
    return worker.host != platform.node() or _runs(worker.pid)


def _runs(pid: int) -> bool:
    with suppress(PermissionError):
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return False
    return True


def _refusal(sentence: str) -> ServiceError:
    return ServiceError(ProblemCode.FORBIDDEN, sentence)


def _digest(key: str) -> str:
    return hashlib.sha256(key.encode()).hexdigest()
