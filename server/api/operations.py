"""Routes by which organizers run the service: workers, stations, notices to teams, and the audit log."""

from datetime import datetime
from http import HTTPStatus
from typing import Annotated
from uuid import UUID

from fastapi import APIRouter, Path, Query, Response
from pydantic import BaseModel, ConfigDict, Field

from ..accounts import outbox, stations
from ..audit import entry_view, list_audit_digests, newest_entries
from ..database.states import WorkerOrder
from ..queue import workers
from ..views.correspondence import NoticeView
from ..views.operations import WorkerView
from ..views.teams import AuditDigestView, AuditEntryView
from .access import ChangingServicesOf, OrganizerOf, ServicesOf
from .inputs import Input
from .problems import RESPONSES
from .teams import ONE_LINE

router = APIRouter(tags=["operations"], responses=RESPONSES)

Rows = Annotated[int, Query(ge=1, le=10_000, description="Maximum number of rows.")]


class Order(Input):
    """What a worker is to do."""

    order: WorkerOrder


class NewStation(Input):
    """A laboratory whose agent plays trials."""

    name: str = Field(max_length=100, pattern=ONE_LINE)


class StationRow(BaseModel):
    """A station, with the agent that used its key last."""

    model_config = ConfigDict(from_attributes=True)
    name: str
    worker_id: UUID | None
    twin: str | None = Field(
        description="What kind of twin that agent plays on, in words; null for hardware, and before the first agent."
    )
    created_at: datetime


class AddedStation(BaseModel):
    """A new station; its key is shown this once."""

    name: str
    key: str


@router.get("/workers")
def list_workers(services: ServicesOf, principal: OrganizerOf) -> list[WorkerView]:  # noqa: ARG001 - says who may
    """List the workers of the last week, the one with the newest heartbeat first."""
    with services.database.transaction() as session:
        return workers.list_views(session, services.settings)


@router.get("/workers/{worker_id}")
def get_worker(services: ServicesOf, principal: OrganizerOf, worker_id: UUID) -> WorkerView:  # noqa: ARG001
    """Show a worker: its state, versions and shards."""
    with services.database.transaction() as session:
        return workers.view_worker(session, services.settings, worker_id)


@router.put("/workers/{worker_id}/order")
def put_order(services: ChangingServicesOf, principal: OrganizerOf, worker_id: UUID, order: Order) -> WorkerView:
    """Have a worker take shards, take no new ones, or end after those that it runs; from its next heartbeat on."""
    with services.database.transaction() as session:
        workers.give_order(session, principal, worker_id, order.order)
        return workers.view_worker(session, services.settings, worker_id)


@router.get("/stations")
def list_stations(services: ServicesOf, principal: OrganizerOf) -> list[StationRow]:  # noqa: ARG001
    """List the stations, with the agent that used the key of each last."""
    with services.database.transaction() as session:
        return list(map(StationRow.model_validate, stations.list_stations(session)))


@router.post("/stations", status_code=HTTPStatus.CREATED)
def post_station(services: ChangingServicesOf, principal: OrganizerOf, new: NewStation) -> AddedStation:
    """Add a station and give its key, which is shown once: `vitac station run` needs it."""
    with services.database.transaction() as session:
        return AddedStation(name=new.name, key=stations.add_station(session, principal, new.name))


@router.delete("/stations/{name}", status_code=HTTPStatus.NO_CONTENT, response_class=Response)
def delete_station(
    services: ChangingServicesOf,
    principal: OrganizerOf,
    name: Annotated[str, Path(description="Name of the station.")],
) -> None:
    """Remove a station; its agent is refused when it starts next."""
    with services.database.transaction() as session:
        stations.remove_station(session, principal, name)


@router.get("/notices")
def list_notices(
    services: ServicesOf,
    principal: OrganizerOf,  # noqa: ARG001
    *,
    unsent: Annotated[bool, Query(description="Only notices that wait or were given up.")] = False,
    limit: Rows = 50,
) -> list[NoticeView]:
    """List e-mails and webhook calls to teams, newest first."""
    with services.database.transaction() as session:
        return [outbox.notice_view(notice) for notice in outbox.newest(session, limit, unsent_only=unsent)]


@router.post("/notices/{notice_id}/retry")
def retry_notice(services: ChangingServicesOf, principal: OrganizerOf, notice_id: UUID) -> NoticeView:
    """Send a notice again that was given up."""
    with services.database.transaction() as session:
        return outbox.notice_view(outbox.retry(session, principal, notice_id))


@router.get("/audit")
def list_audit(
    services: ServicesOf,
    principal: OrganizerOf,  # noqa: ARG001
    *,
    action: Annotated[str | None, Query(description="Only this action, such as team.quota.")] = None,
    subject: Annotated[str | None, Query(description="Only this thing, such as team:ID.")] = None,
    limit: Rows = 50,
) -> list[AuditEntryView]:
    """List the changes that people made, newest first: who, when, what, before and after."""
    with services.database.transaction() as session:
        return [entry_view(entry) for entry in newest_entries(session, limit, action=action, subject=subject)]


@router.get("/audit/digests")
def list_digests(services: ServicesOf, principal: OrganizerOf) -> list[AuditDigestView]:  # noqa: ARG001
    """List the digests of the audit log in the public log, and whether the audit log still agrees with each."""
    with services.database.transaction() as session:
        return list_audit_digests(session)
