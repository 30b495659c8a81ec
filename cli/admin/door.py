"""The service that an organizer's command works on: at an address with a token, or the one of this machine.

On the service's machine the same application answers in this process, to whoever has the database's password, so no
server has to run. Called by every verb.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import httpx
import typer

from ..client.answers import RequestRefused
from ..client.http import Client, make_client
from ..client.verbs import Door

if TYPE_CHECKING:
    from fastapi import FastAPI

IN_PROCESS = "http://localhost"
Server = Annotated[
    str | None, typer.Option(help="Address of a service elsewhere, with an organizer's token; default: this machine's.")
]


class InProcess(httpx.BaseTransport):
    """Has requests answered by an application of this process."""

    def __init__(self, app: FastAPI) -> None:
        self._transport = httpx.ASGITransport(app)

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        """Return the whole answer."""
        return asyncio.run(self._answer(request))

    async def _answer(self, request: httpx.Request) -> httpx.Response:
        answer = await self._transport.handle_async_request(request)
        return httpx.Response(answer.status_code, headers=answer.headers, content=await answer.aread())


@contextmanager
def open_door(context: typer.Context, server: str | None, token_file: Path | None) -> Iterator[Door]:
    """Open the service at an address, given to the verb or to `admin`; without one that of this machine.

    Raises:
        VitacError: the address or the token's file is wrong, or the database does not answer.
    """
    given = context.find_root().obj or {}
    address, token_file = server or given.get("server"), token_file or given.get("token_file")
    if address is not None:
        yield Door(client=make_client(address, token_file))
        return
    from ..service.web_server import no_collections

    with no_collections():
        from vitac.server.api.app import create_app
        from vitac.server.principals import CONSOLE

        from ..service.database import open_for_command

    with open_for_command() as services:
        app = create_app(services.settings, services, caller=CONSOLE)
        try:
            yield Door(client=Client(server=IN_PROCESS, transport=InProcess(app)))
        except RequestRefused as error:
            error.args = (error.detail,)  # status, hints and request ids are for who asks over a network
            raise
