"""`vitac remote connect`: a policy server of one's own plays at a service that cannot dial it."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Final
from urllib.parse import urlsplit, urlunsplit

import typer
from vitac.errors import VitacError

from ..evaluate import Image, check_lines, find_playing_kind
from ..terminal.output import Server, TokenFile, existing, warn
from ..terminal.own_policy import fall_back_where_nothing_isolates
from .http import make_client
from .status import show_when_ended
from .submit import describe, packed

if TYPE_CHECKING:
    from vitac.evaluator.submission.manifest import SubmissionManifest

app = typer.Typer(no_args_is_help=True)
_RETRY_S: Final = 1.0
_RETRY_MAX_S: Final = 30.0
_REFUSED: Final = 1008
_GATE_PATH: Final = "/remote"


class GateRefused(VitacError):
    """The gate of the service takes no lines of this token; the message says why."""


@app.callback()
def remote() -> None:
    """Have a policy server of your own play at a service."""


@app.command()
def connect(
    policy: Annotated[
        Path, typer.Argument(callback=existing, help="Folder or zip with submission.yaml, or tar of an image.")
    ],
    remote: Annotated[
        str | None,
        typer.Option(help="Your policy server, such as ws://127.0.0.1:8000; without it the policy itself plays here."),
    ] = None,
    image: Image = False,
    track: Annotated[
        str | None, typer.Option(help="Track to submit to; by default the one named in the submission.")
    ] = None,
    competition: Annotated[
        str | None, typer.Option(help="Name of the competition; needed where several take submissions to the track.")
    ] = None,
    lines: Annotated[int, typer.Option(min=1, max=16, help="Episodes that your server can play at once.")] = 1,
    gate: Annotated[
        str | None, typer.Option(help="Where the service's gate listens; by default its address with /remote.")
    ] = None,
    again: Annotated[bool, typer.Option("--again", help="Run all episodes, including stored ones.")] = False,
    server: Server = None,
    token_file: TokenFile = None,
) -> None:
    """Submit what describes your policy, and carry the service's questions to it until there is a result.

    It is a policy server, or the policy of a folder or an image, which plays on this machine as with `evaluate`.

    A line that is cut is dialled again; the episode that it cut is played again. Ctrl-C ends the lines: the service
    waits a minute for others.
    """
    client = make_client(server, token_file)
    with ExitStack() as stack:
        folder, address = stack.enter_context(_answering(policy, remote, is_image=image, lines=lines))
        stack.enter_context(connected(gate or gate_address(client.server), client.token or "", address, lines))
        with packed(folder) as archive:
            answer = client.upload(
                archive,
                track=track,
                competition=competition,
                again=again,
                file_name=policy.resolve().name,
                on_position=lambda _: None,
            )
        describe(client, answer, is_known=False)
        show_when_ended(client, answer["id"], as_json=False)


@contextmanager
def _answering(policy: Path, remote: str | None, *, is_image: bool, lines: int) -> Iterator[tuple[Path, str]]:
    """Return the folder that describes a policy to the service, and the address of what answers.

    A policy server is asked in its own words. A policy that plays here, and a server of LeRobot, whose pickles no
    service reads, are served in those of vla-eval, and the folder names the policy's digest: for another one all
    episodes are played again.
    """
    from vitac.evaluator.agent.limits import Limits
    from vitac.evaluator.evaluation.serving import served
    from vitac.evaluator.remote.description import RemoteProtocol
    from vitac.evaluator.remote.protocols import check_address
    from vitac.evaluator.shards.policy import load_in_sandbox, load_remote
    from vitac.evaluator.submission.manifest import load_manifest
    from vitac.evaluator.submission.sources import staged, submission_digest
    from vitac.evaluator.tracks import load_track

    kind = find_playing_kind(policy, is_image=is_image)
    with staged(policy, kind) as submission:
        manifest = load_manifest(submission)
        track = load_track(manifest.track)
        if remote is None:
            if manifest.remote is not None:
                raise typer.BadParameter(
                    "submission.yaml has a policy server play; give its address.", param_hint="--remote"
                )
            fall_back_where_nothing_isolates()
            load = partial(load_in_sandbox, submission, Limits(), track.packages, kind=kind)
        else:
            protocol = manifest.server().protocol
            check_address(remote, protocol)
            if protocol is not RemoteProtocol.LEROBOT:
                yield policy, remote
                return
            check_lines(protocol, lines, "--lines")
            load = partial(load_remote, submission, Limits(), remote)
        with TemporaryDirectory(prefix="vitac-remote-") as folder, served(track, load) as address:
            _write_description(Path(folder), manifest, submission_digest(policy, kind=kind))
            yield Path(folder), address


def _write_description(folder: Path, manifest: SubmissionManifest, digest: str) -> None:
    import yaml
    from vitac.evaluator.remote.description import DIALS_IN, RemoteProtocol
    from vitac.evaluator.submission.names import MANIFEST_NAME

    content = manifest.model_dump(mode="json", include={"track", "tasks", "name", "control_modes"})
    content["remote"] = {"protocol": str(RemoteProtocol.VLA_EVAL), "address": DIALS_IN}
    if manifest.observation_keys is not None:
        content["remote"]["observations"] = {key: key for key in manifest.observation_keys}
    (folder / MANIFEST_NAME).write_text(yaml.safe_dump(content), encoding="utf-8")
    (folder / "policy.sha256").write_text(f"{digest}\n", encoding="utf-8")


def gate_address(server: str) -> str:
    """Return where a service's gate is by default: below its own address."""
    parts = urlsplit(server)
    return urlunsplit((parts.scheme.replace("http", "ws"), parts.netloc, _GATE_PATH, "", ""))


@contextmanager
def connected(gate: str, token: str, server: str, lines: int) -> Iterator[None]:
    """Hold lines to a gate while the block runs.

    Args:
        gate: its address.
        token: of the team.
        server: address of the policy server that answers.
        lines: number of them.

    Raises:
        GateRefused: the token is refused, or nobody listens at first.
    """
    loop = asyncio.new_event_loop()
    first: asyncio.Future[None] = loop.create_future()
    held = [loop.create_task(_hold(gate, token, server, first)) for _ in range(lines)]
    thread = threading.Thread(target=loop.run_forever, name="lines", daemon=True)
    thread.start()
    try:
        asyncio.run_coroutine_threadsafe(asyncio.wait_for(asyncio.shield(first), _RETRY_MAX_S), loop).result()
        yield
    except TimeoutError as error:
        raise GateRefused(
            f"Nobody answered at the gate {gate} within {_RETRY_MAX_S:g} s; ask the organizers."
        ) from error
    finally:
        asyncio.run_coroutine_threadsafe(_end(held), loop).result()
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()


async def _end(held: list[asyncio.Task[None]]) -> None:
    for task in held:
        task.cancel()
    await asyncio.gather(*held, return_exceptions=True)


async def _hold(gate: str, token: str, server: str, first: asyncio.Future[None]) -> None:
    """Dial the gate again whenever its line ends."""
    from vitac.evaluator.remote.line import join
    from websockets.asyncio.client import connect
    from websockets.exceptions import ConnectionClosedError, ConnectionClosedOK, WebSocketException

    retry_s = _RETRY_S
    while True:
        try:
            headers = {"Authorization": f"Bearer {token}"}
            async with connect(gate, additional_headers=headers, max_size=None, compression=None) as line:
                await line.recv()  # it waits
                if not first.done():
                    first.set_result(None)
                retry_s = _RETRY_S
                await line.recv()  # somebody plays
                async with connect(server, max_size=None, compression=None) as local:
                    await join(line, local)
        except ConnectionClosedOK:
            continue
        except (OSError, WebSocketException) as error:
            if isinstance(error, ConnectionClosedError) and error.rcvd and error.rcvd.code == _REFUSED:
                if not first.done():
                    first.set_exception(GateRefused(f"The gate takes no line: {error.rcvd.reason}"))
                return
            warn(f"a line is away ({error}); dialling again in {retry_s:g} s")
            await asyncio.sleep(retry_s)
            retry_s = min(2 * retry_s, _RETRY_MAX_S)
