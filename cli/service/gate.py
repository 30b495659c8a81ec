"""`vitac gate`: where policies dial in that cannot be dialled."""

import asyncio
import signal
import socket
from functools import partial
from typing import Annotated

import typer

from .database import load_settings, open_service
from .web_server import no_collections


def command(
    listen: Annotated[str, typer.Option(metavar="HOST:PORT", help="Where policies dial in; behind TLS.")] = (
        "127.0.0.1:8100"
    ),
    inner: Annotated[
        str, typer.Option(metavar="HOST:PORT", help="Where server and workers dial, as VITAC_REMOTE_GATE says.")
    ] = "127.0.0.1:8101",
) -> None:
    """Join the lines of `vitac remote connect` with those of server and workers, until Ctrl-C."""
    with no_collections():
        from vitac.server.operations.remote_gate import Gate, find_team, run_gate

    with (
        open_listener(listen, "--listen") as policies,
        open_listener(inner, "--inner") as players,
        open_service(load_settings()) as services,
    ):

        async def run() -> None:
            stop = asyncio.Event()
            for number in (signal.SIGINT, signal.SIGTERM):
                asyncio.get_running_loop().add_signal_handler(number, stop.set)
            print(f"policies dial ws://{listen}, server and workers ws://{inner}", flush=True)
            await run_gate(Gate(partial(find_team, services.database)), policies=policies, players=players, stop=stop)

        asyncio.run(run())


def open_listener(place: str, option: str) -> socket.socket:
    """Return a socket that listens at `HOST:PORT`."""
    host, _, port = place.rpartition(":")
    try:
        return socket.create_server((host, int(port)))
    except (OSError, ValueError, OverflowError) as error:
        raise typer.BadParameter(
            f"expected HOST:PORT that is free here, such as 0.0.0.0:8100, got {place!r} ({error}).", param_hint=option
        ) from error
