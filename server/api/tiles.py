"""Routes of the log's files below `/log/`, which anybody may read and store, and of what witnesses sign."""

from typing import Annotated, Any

from fastapi import APIRouter, Body, Response
from pydantic import BaseModel

from ..errors import not_found
from ..receipts.witnesses import add_cosignatures, list_witnessed_checkpoints
from ..transparency.log import make_checkpoint, read_entries, read_hashes, read_log_key, read_tree
from ..transparency.notes import MAX_NOTE_CHARS
from ..transparency.tiles import pack_entries, parse_tile_name
from .access import ServicesOf
from .problems import RESPONSES

router = APIRouter(prefix="/log", tags=["receipts"], responses=RESPONSES)

FOR_GOOD = {"Cache-Control": "public, max-age=31536000, immutable"}
FOR_SECONDS = {"Cache-Control": "public, max-age=2"}
FILE: dict[int | str, dict[str, Any]] = {200: {"content": {"application/octet-stream": {}}}}
NOTE: dict[int | str, dict[str, Any]] = {200: {"content": {"text/plain": {}}}}


class Stored(BaseModel):
    """What was taken of a posted checkpoint."""

    signatures: int


@router.get("/checkpoint", response_class=Response, responses=NOTE)
def get_checkpoint(services: ServicesOf) -> Response:
    """Return the size and root of the log, signed by the service and by witnesses (c2sp.org/tlog-checkpoint)."""
    with services.database.transaction() as session:
        text = str(make_checkpoint(session, read_tree(session)))
    return Response(text, media_type="text/plain; charset=utf-8", headers=FOR_SECONDS)


@router.get("/key", response_class=Response, responses=NOTE)
def get_key(services: ServicesOf) -> Response:
    """Return the key that signs the log, as NAME+ID+KEY; compare it with the one that you noted."""
    with services.database.transaction() as session:
        return Response(f"{read_log_key(session)}\n", media_type="text/plain; charset=utf-8", headers=FOR_SECONDS)


@router.get("/witnessed.json")
def get_witnessed(services: ServicesOf, response: Response) -> list[str]:
    """Return the newest checkpoint that each witness has signed."""
    response.headers.update(FOR_SECONDS)
    with services.database.transaction() as session:
        return [str(checkpoint) for checkpoint in list_witnessed_checkpoints(session)]


@router.get("/tile/entries/{name:path}", response_class=Response, responses=FILE)
def get_entries(services: ServicesOf, name: str) -> Response:
    """Return up to 256 entries, each after its length (c2sp.org/tlog-tiles)."""
    number, width = _parse(f"entries/{name}", name)
    with services.database.transaction() as session:
        entries = read_entries(session, number, width)
    return _file(f"entries/{name}", pack_entries(entries), len(entries) == width)


@router.get("/tile/{level}/{name:path}", response_class=Response, responses=FILE)
def get_tile(services: ServicesOf, level: int, name: str) -> Response:
    """Return up to 256 hashes of the tree (c2sp.org/tlog-tiles)."""
    number, width = _parse(f"{level}/{name}", name)
    with services.database.transaction() as session:
        hashes = read_hashes(session, level, number, width) if 0 <= level < 8 else ()
    return _file(f"{level}/{name}", b"".join(hashes), len(hashes) == width)


@router.post("/cosignatures", responses=NOTE)
def add_signatures(
    services: ServicesOf, note: Annotated[bytes, Body(media_type="text/plain", max_length=4 * MAX_NOTE_CHARS)]
) -> Stored:
    """Take what witnesses signed of a checkpoint of this log: the note with their lines (c2sp.org/tlog-cosignature)."""
    with services.database.transaction() as session:
        return Stored(signatures=add_cosignatures(session, note.decode(errors="replace")))


def _parse(path: str, name: str) -> tuple[int, int]:
    found = parse_tile_name(name)
    if found is None:
        raise not_found("tile", path)
    return found


def _file(path: str, content: bytes, is_whole: bool) -> Response:
    if not is_whole:
        raise not_found("tile", path)
    return Response(content, media_type="application/octet-stream", headers=FOR_GOOD)
