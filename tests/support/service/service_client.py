"""A running service and a client for tests of the API, and archives to upload."""

import asyncio
import io
import shutil
import socket
import ssl
import threading
import time
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import uvicorn
from databases import copied_database, make_template, opened_database
from fastapi import FastAPI
from httpx import Client, Response
from service_factories import TASK, TRACK, make_principal, make_secret, make_settings
from sqlalchemy import text
from sqlalchemy.orm import Session
from vitac.server.api.app import create_app
from vitac.server.database.engine import Database
from vitac.server.database.models import Team
from vitac.server.principals import CONSOLE, Principal
from vitac.server.services import Services, open_services
from vitac.server.settings import Settings
from vitac.server.storage.blobs import BlobStore

API = "/api/v1"
ANSWER_LIMIT_S = 60.0
"""A request that takes longer when its server ends makes its test fail: a page was left open, or something hangs."""

MANIFEST = f"track: {TRACK}\ntasks: [{TASK}]\nname: zero\n"
POLICY = """
import numpy as np

class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        return np.zeros(3, np.float32)
"""


def make_archive(
    files: Mapping[str, str | bytes] | None = None, *, manifest: str = MANIFEST, policy: str = POLICY
) -> bytes:
    """A zip; without `files` that of a small valid submission."""
    buffer = io.BytesIO()
    if files is None:
        files = {"Track_1/submission.yaml": manifest, "Track_1/policy.py": policy}
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(zipfile.ZipInfo(name, (2025, 1, 1, 0, 0, 0)), content, zipfile.ZIP_DEFLATED)
    return buffer.getvalue()


@dataclass(frozen=True, kw_only=True)
class Service:
    """A service in this process and the tokens to talk to it."""

    client: Client
    address: tuple[str, int]
    services: Services
    principal: Principal
    token: str
    other_token: str
    organizer_token: str

    @property
    def settings(self) -> Settings:
        return self.services.settings

    @property
    def database(self) -> Database:
        return self.services.database

    def get(self, path: str, token: str | None = None, **options: Any) -> Response:
        return self.client.get(f"{API}{path}", headers=bearer(token or self.token), **options)

    def post(self, path: str, token: str | None = None, **options: Any) -> Response:
        headers = bearer(token or self.token) | options.pop("headers", {})
        return self.client.post(f"{API}{path}", headers=headers, **options)

    def upload(self, body: Any, token: str | None = None, query: str = "", **headers: str) -> Response:
        given = {"Content-Type": "application/zip"} | {name.replace("_", "-"): value for name, value in headers.items()}
        return self.post(f"/submissions{query}", token, content=body, headers=given)

    def leftovers(self) -> list[Path]:
        """Files that an upload has left in scratch or store."""
        folders = (self.settings.scratch_dir, self.settings.state_dir / "blobs")
        return [path for folder in folders for path in folder.rglob("*") if path.is_file()]

    def count(self, table: str) -> int:
        """Number of rows."""
        with self.database.transaction() as session:
            return session.scalar(text(f"SELECT count(*) FROM {table}")) or 0  # noqa: S608 - fixed names

    def assert_nothing_left(self) -> None:
        """A refused upload leaves no file, row or job."""
        assert self.leftovers() == []
        assert [self.count(table) for table in ("submissions", "evaluations", "work", "partial_uploads")] == [0] * 4


@dataclass(frozen=True, kw_only=True)
class People:
    """A principal of Team A and the tokens of both teams and of an organizer."""

    principal: Principal
    token: str
    other_token: str
    organizer_token: str


def make_people(session: Session) -> People:
    principal = make_principal(session, "Team A")
    tokens = [make_secret(session, one) for one in (principal, make_principal(session, "Team B"), CONSOLE)]
    return People(principal=principal, token=tokens[0], other_token=tokens[1], organizer_token=tokens[2])


@cache
def template_with_people() -> tuple[str, People]:
    """The name of a template in which these people are already, and who they are."""
    database = make_template("vitac_people")
    with database.transaction() as session:
        people = make_people(session)
    database.dispose()
    return "vitac_people", people


@contextmanager
def database_with_people() -> Iterator[Database]:
    """A fresh database in which a service finds its people."""
    with opened_database(template_with_people()[0]) as database:
        yield database


def _people_of(session: Session) -> People:
    _, people = template_with_people()
    return people if session.get(Team, people.principal.team_id) is not None else make_people(session)


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


@contextmanager
def running_service(database: Database, state_dir: Path, **settings: Any) -> Iterator[Service]:
    """A service on an open database that looks for no lost work; `settings` change the defaults."""
    made = make_settings(state_dir=state_dir, **settings)
    services = Services(settings=made, database=database, blobs=BlobStore.from_settings(made), postgres=None)
    made.scratch_dir.mkdir(parents=True, exist_ok=True)
    with _served(services, sweeps=False) as service:
        yield service


@contextmanager
def copied_service(service: Service, state_dir: Path) -> Iterator[Service]:
    """A copy of a service that has ended, with the same tokens; tests may change it."""
    shutil.copytree(service.settings.state_dir, state_dir, dirs_exist_ok=True)
    settings = service.settings.model_copy(update={"state_dir": state_dir})
    with copied_database(service.database.address) as database:
        services = Services(
            settings=settings, database=database, blobs=BlobStore.from_settings(settings), postgres=None
        )
        app = create_app(settings, services=services, sweeps=False)
        with serving(app) as address, _client(address) as client:
            yield replace(service, services=services, client=client, address=address)


@contextmanager
def live_service(settings: Settings) -> Iterator[Service]:
    """A service that starts everything that the settings name."""
    with open_services(settings) as services, _served(services) as service:
        yield service


def _client(address: tuple[str, int]) -> Client:
    # Without the usual certificates, which a plain connection does not need and which take 20 ms to read.
    no_certificates = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    return Client(base_url=f"http://{address[0]}:{address[1]}", timeout=60.0, verify=no_certificates)


@contextmanager
def _served(services: Services, *, sweeps: bool = True) -> Iterator[Service]:
    with services.database.transaction() as session:
        people = _people_of(session)
    app = create_app(services.settings, services=services, sweeps=sweeps)
    with serving(app) as address, _client(address) as client:
        yield Service(
            client=client,
            address=address,
            services=services,
            principal=people.principal,
            token=people.token,
            other_token=people.other_token,
            organizer_token=people.organizer_token,
        )


class _QuickServer(uvicorn.Server):
    """Ends as soon as it is asked to, where uvicorn looks ten times a second and then waits for a tenth of one.

    Once it has ended, none of its connections is left: the garbage collector would find it during another test.
    """

    def __init__(self, app: FastAPI) -> None:
        super().__init__(uvicorn.Config(app, log_config=None, access_log=False))
        self.stopping = threading.Event()

    async def main_loop(self) -> None:
        await self.on_tick(0)
        await asyncio.to_thread(self.stopping.wait)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        for server in self.servers:
            server.close()
        try:
            async with asyncio.timeout(ANSWER_LIMIT_S):
                await self._close_connections()
        finally:
            for task in self.server_state.tasks:
                task.cancel()
            await asyncio.gather(*self.server_state.tasks, return_exceptions=True)
            for connection in self.server_state.connections:
                connection.transport.abort()
            await _next_rounds()
            await self.lifespan.shutdown()

    async def _close_connections(self) -> None:
        await _next_rounds()
        while self.server_state.connections or self.server_state.tasks:
            for connection in self.server_state.connections:
                if not connection.transport.is_closing():
                    connection.shutdown()  # again and again: a client may just have connected
            await asyncio.sleep(0.005)


async def _next_rounds() -> None:
    """Let a connection that was just accepted be made, and one that was just aborted be lost."""
    for _ in range(5):
        await asyncio.sleep(0)


@contextmanager
def serving(app: FastAPI) -> Iterator[tuple[str, int]]:
    """Host and port of a real HTTP server in a thread of this process."""
    listener = socket.create_server(("127.0.0.1", 0))
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # as `vitac serve` does; else 40 ms a request
    server = _QuickServer(app)
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
    thread.start()
    try:
        while not server.started:
            assert thread.is_alive(), "the server did not start"
            time.sleep(0.005)
        yield listener.getsockname()
    finally:
        server.stopping.set()
        thread.join()
        listener.close()


def problem_of(response: Response, status: int, code: str) -> dict[str, Any]:
    """Asserts that an answer is that problem and returns it."""
    assert response.headers["content-type"] == "application/problem+json", response.text
    problem: dict[str, Any] = response.json()
    assert (response.status_code, problem["status"], problem["code"]) == (status, status, code), problem
    assert problem["type"] == f"urn:vitac:problem:{code}"
    assert problem["detail"].endswith((".", "?")), problem
    return problem
