"""`vitac witness`: signs logs for as long as they only grow."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from vitac.errors import VitacError

from .client.http import make_client
from .receipt import open_log

if TYPE_CHECKING:
    from vitac.server.receipts.witness import Witness

CONNECTIONS = 64
"""Maximum number of open connections of `serve`; others get 503."""
app = typer.Typer(no_args_is_help=True, rich_markup_mode=None, pretty_exceptions_enable=False)

Folder = Annotated[
    Path | None,
    typer.Option(help="Holds key and last checkpoints; back it up. Default: vitac/witness in the user's state folder."),
]
Name = Annotated[
    str | None, typer.Option(help="Needed once: an address that is yours, such as witness.example.org/vitac.")
]


@app.command()
def key(folder: Folder = None, name: Name = None) -> None:
    """Print the key of this witness, made at the first call, which the organizers put into the competition file."""
    print(_load(folder, name).key)


@app.command()
def run(
    address: Annotated[str, typer.Argument(help="Of the service.")],
    folder: Folder = None,
    name: Name = None,
    log_key: Annotated[
        str | None, typer.Option("--key", help="Of the log; without it the one that the service shows first.")
    ] = None,
    every: Annotated[float, typer.Option(min=1, help="Seconds between two looks.")] = 60.0,
    once: Annotated[bool, typer.Option("--once", help="Look once, as from cron.")] = False,
) -> None:
    """Sign the log of a service whenever it has grown, and never where it was rewritten; then the exit code is 1.

    What was signed last is on the disk before the signature is sent: a witness that is killed, or its machine
    restarted, refuses the same as before.
    """
    from vitac.server.receipts.witness import HistoryRewritten

    witness, signed = _load(folder, name), -1
    print(f"witness {witness.key}", flush=True)
    while True:
        try:
            signed = _look(witness, address, log_key, signed)
        except HistoryRewritten:
            raise
        except VitacError as error:
            if once:
                raise
            print(f"vitac: {error}", file=sys.stderr, flush=True)
        if once:
            return
        time.sleep(every)


@app.command()
def serve(
    log: Annotated[list[str], typer.Option(help="Key of a log to sign, as NAME+ID+KEY; may be repeated.")],
    folder: Folder = None,
    name: Name = None,
    host: Annotated[str, typer.Option(help="Address to listen at; put TLS in front of it.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="0: any free one.")] = 8010,
) -> None:
    """Sign the logs that ask for it: `add-checkpoint` of c2sp.org/tlog-witness, which any log may use."""
    import uvicorn
    from vitac.server.receipts.witness_server import make_app
    from vitac.server.transparency.notes import VerifierKey

    from .service.web_server import bind, format_address

    logs = list(map(VerifierKey.parse, log))
    witness, listener = _load(folder, name), bind(host, port)
    listener.listen(CONNECTIONS)
    print(f"witness {witness.key}\nsigns at {format_address(listener)}/add-checkpoint", flush=True)
    configuration = uvicorn.Config(make_app(witness, logs), log_config=None, limit_concurrency=CONNECTIONS)
    uvicorn.Server(configuration).run(sockets=[listener])


def _load(folder: Path | None, name: str | None) -> Witness:
    from vitac.server.receipts.witness import Witness

    state = os.environ.get("XDG_STATE_HOME")
    return Witness(folder or (Path(state) if state else Path.home() / ".local/state") / "vitac/witness", name)


def _look(witness: Witness, address: str, log_key: str | None, signed: int) -> int:
    """Sign the log once, and return the number of entries; nothing is sent again for those that were signed already."""
    log = open_log(address, log_key or witness.known_key(address))
    note = witness.observe(log, address)
    if note.size != signed:
        client = make_client(address.removesuffix("/").removesuffix("/log"), None, with_token=False)
        client.send("POST", "/log/cosignatures", headers={"Content-Type": "text/plain"}, content=[str(note).encode()])
        print(f"signed {note.size} entries, root {note.root.hex()}", flush=True)
    return note.size
