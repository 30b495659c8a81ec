"""Routes of receipts: those of a submission, and for everybody the log with its files below `/log/`."""

from typing import Annotated, Any
from uuid import UUID

from fastapi import APIRouter, Body, Query, Response
from pydantic import BaseModel

from ..errors import not_found
from ..receipts.receipt import Receipt, SubmissionReceipt
from ..receipts.witnesses import add_cosignatures, list_witnessed_checkpoints
from ..submissions import files
from ..transparency.log import make_checkpoint, read_entries, read_hashes, read_log_key, read_tree
from ..transparency.notes import MAX_NOTE_CHARS
from ..transparency.tiles import pack_entries, parse_tile_name
from ..views.receipts import PublicLogView
from .access import ReaderOf, ServicesOf
from .problems import RESPONSES

router = APIRouter(tags=["receipts"], responses=RESPONSES)
log_router = APIRouter(prefix="/log", tags=["receipts"], responses=RESPONSES)
"""Files of the log, which anybody may read and store, and what witnesses sign."""

PAGE_ENTRIES = 1000
FOR_GOOD = {"Cache-Control": "public, max-age=31536000, immutable"}
FOR_SECONDS = {"Cache-Control": "public, max-age=2"}
FILE: dict[int | str, dict[str, Any]] = {200: {"content": {"application/octet-stream": {}}}}
NOTE: dict[int | str, dict[str, Any]] = {200: {"content": {"text/plain": {}}}}


@router.get("/competitions/{competition}/receipts")
@router.get("/receipts")
def get_log(
    services: ServicesOf,
    *,
    competition: str | None = None,
    after: Annotated[int, Query(ge=0, le=2**53, description="`next_after` from the previous page.")] = 0,
    limit: Annotated[int, Query(ge=1, le=PAGE_ENTRIES)] = PAGE_ENTRIES,
) -> PublicLogView:
    """Return the public key that signs the log of receipts, and its entries, or those of a competition."""
    with services.database.transaction() as session:
        return files.log_view(session, after=after, limit=limit, competition=competition)


@router.get("/submissions/{submission_id}/receipts")
def get_receipts(services: ServicesOf, principal: ReaderOf, submission_id: UUID) -> list[Receipt]:
    """Return the receipt of each final result of a submission, the first one first."""
    with services.database.transaction() as session:
        return files.receipts(session, principal, submission_id)


@router.get("/submissions/{submission_id}/arrival")
def get_receipt_of_arrival(services: ServicesOf, principal: ReaderOf, submission_id: UUID) -> SubmissionReceipt:
    """Return the receipt that a submission got when it arrived, before anybody knew its result."""
    with services.database.transaction() as session:
        return files.receipt_of_arrival(session, principal, submission_id)


class Stored(BaseModel):
    """What was taken of a posted checkpoint."""

    signatures: int


@log_router.get("/checkpoint", response_class=Response, responses=NOTE)
def get_checkpoint(services: ServicesOf) -> Response:
    """Return the size and root of the log, signed by the service and by witnesses (c2sp.org/tlog-checkpoint)."""
    with services.database.transaction() as session:
        text = str(make_checkpoint(session, read_tree(session)))
    return Response(text, media_type="text/plain; charset=utf-8", headers=FOR_SECONDS)


@log_router.get("/key", response_class=Response, responses=NOTE)
def get_key(services: ServicesOf) -> Response:
    """Return the key that signs the log, as NAME+ID+KEY; compare it with the one that you noted."""
    with services.database.transaction() as session:
        return Response(f"{read_log_key(session)}\n", media_type="text/plain; charset=utf-8", headers=FOR_SECONDS)


@log_router.get("/witnessed.json")
def get_witnessed(services: ServicesOf, response: Response) -> list[str]:
    """Return the newest checkpoint that each witness has signed."""
    response.headers.update(FOR_SECONDS)
    with services.database.transaction() as session:
        return [str(checkpoint) for checkpoint in list_witnessed_checkpoints(session)]


@log_router.get("/tile/entries/{name:path}", response_class=Response, responses=FILE)
def get_entries(services: ServicesOf, name: str) -> Response:
    """Return up to 256 entries, each after its length (c2sp.org/tlog-tiles)."""
    number, width = _parse(f"entries/{name}", name)
    with services.database.transaction() as session:
        entries = read_entries(session, number, width)
    return _file(f"entries/{name}", pack_entries(entries), len(entries) == width)


@log_router.get("/tile/{level}/{name:path}", response_class=Response, responses=FILE)
def get_tile(services: ServicesOf, level: int, name: str) -> Response:
    """Return up to 256 hashes of the tree (c2sp.org/tlog-tiles)."""
    number, width = _parse(f"{level}/{name}", name)
    with services.database.transaction() as session:
        hashes = read_hashes(session, level, number, width) if 0 <= level < 8 else ()
    return _file(f"{level}/{name}", b"".join(hashes), len(hashes) == width)


@log_router.post("/cosignatures", responses=NOTE)
def add_signatures(
    services: ServicesOf, note: Annotated[bytes, Body(media_type="text/plain", max_length=4 * MAX_NOTE_CHARS)]
) -> Stored:
    """Take what witnesses signed of a checkpoint of this log: the note with their lines (c2sp.org/tlog-cosignature)."""
    with services.database.transaction() as session:
        return Stored(signatures=add_cosignatures(session, note.decode(errors="replace")))


def _parse(path: str, name: str) -> tuple[int, int]:
    parsed = parse_tile_name(name)
    if parsed is None:
        raise not_found("tile", path)
    return parsed


def _file(path: str, content: bytes, is_whole: bool) -> Response:
    if not is_whole:
        raise not_found("tile", path)
    return Response(content, media_type="application/octet-stream", headers=FOR_GOOD)
