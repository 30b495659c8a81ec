"""A witness that logs ask: `add-checkpoint` of https://c2sp.org/tlog-witness. Run by `vitac witness serve`.

Apart from `witness`, which signs without a web server being installed.
"""

import re
from base64 import b64decode
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final, Self

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route
from vitac.errors import VitacError

from ..transparency.merkle import ProofRejected
from ..transparency.notes import MAX_NOTE_CHARS, Checkpoint, NoteRejected, Signature, VerifierKey
from .witness import HistoryRewritten, OtherSizeSigned, Witness

MAX_BODY_BYTES: Final = 4 * MAX_NOTE_CHARS
SIZE_TYPE: Final = "text/x.tlog.size"
_OLD_AND_PROOF = re.compile(r"old (0|[1-9]\d{0,15})((?:\n[A-Za-z0-9+/]{43}=){0,63})", re.ASCII)


class RequestRejected(VitacError):
    """A witness does not sign what it was asked to."""

    def __init__(self, status: int, message: str, media_type: str = "text/plain") -> None:
        super().__init__(message)
        self.answer = Response(f"{message}\n", status, {"Content-Type": media_type})


@dataclass(frozen=True, kw_only=True)
class CheckpointRequest:
    """A checkpoint to sign, and the proof that it continues the log from `old_size` entries."""

    old_size: int
    proof: tuple[bytes, ...]
    checkpoint: Checkpoint

    @classmethod
    def parse(cls, body: bytes) -> Self:
        """Read the body of a request.

        Raises:
            RequestRejected: it does not have the form of one.
        """
        head, _, checkpoint = body.decode(errors="replace").partition("\n\n")
        match = _OLD_AND_PROOF.fullmatch(head)
        if match is None:
            raise RequestRejected(400, f"Expected a line 'old SIZE' and at most 63 hashes, got {head[:60]!r}.")
        try:
            signed = Checkpoint.parse(checkpoint)
        except NoteRejected as error:
            raise RequestRejected(400, str(error)) from error
        return cls(old_size=int(match[1]), proof=tuple(map(b64decode, match[2].split())), checkpoint=signed)


def make_app(witness: Witness, logs: Iterable[VerifierKey]) -> Starlette:
    """Return the application of a witness that signs some logs; the name of each key is the origin of its log."""
    keys = {key.name: key for key in logs}

    async def add_checkpoint(request: Request) -> Response:
        try:
            asked = CheckpointRequest.parse(await _read(request))
            return PlainTextResponse(str(await run_in_threadpool(_sign, witness, keys, asked)))
        except RequestRejected as rejected:
            return rejected.answer

    return Starlette(routes=[Route("/add-checkpoint", add_checkpoint, methods=["POST"])])


async def _read(request: Request) -> bytes:
    body = bytearray()
    async for piece in request.stream():
        body += piece
        if len(body) > MAX_BODY_BYTES:
            raise RequestRejected(400, f"Expected at most {MAX_BODY_BYTES} bytes.")
    return bytes(body)


def _sign(witness: Witness, keys: Mapping[str, VerifierKey], asked: CheckpointRequest) -> Signature:
    """Return the witness's line for a checkpoint; each refusal has the status that the standard gives it."""
    new = asked.checkpoint
    key = keys.get(new.origin)
    if key is None:
        raise RequestRejected(404, f"This witness does not know the log {new.origin}.")
    try:
        new.require_signature(key)
    except NoteRejected as error:
        raise RequestRejected(403, str(error)) from error
    if asked.old_size > new.size:
        raise RequestRejected(400, f"Expected an old size of at most {new.size}, got {asked.old_size}.")
    try:
        return witness.sign_next(key, asked.old_size, asked.proof, new)
    except OtherSizeSigned as error:
        raise RequestRejected(409, str(error.size), SIZE_TYPE) from error
    except HistoryRewritten as error:
        raise RequestRejected(409, str(error)) from error
    except ProofRejected as error:
        raise RequestRejected(422, str(error)) from error
