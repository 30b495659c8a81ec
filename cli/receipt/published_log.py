"""Opens the log of receipts that a service publishes, or a copy of its files in a folder."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ..client.answers import RequestRefused
from ..client.http import make_client

if TYPE_CHECKING:
    from vitac.server.transparency.notes import VerifierKey
    from vitac.server.transparency.tiles import Fetch, PublishedLog

_MAX_FILE_BYTES = 256 * 65_537 + 1


def open_log(named: str, key: str | None = None) -> PublishedLog:
    """Return the log at an address, or in a folder.

    Args:
        named: address of a service, or folder with the files that it has below `/log/`.
        key: of the log, as hexadecimal digits or NAME+ID+KEY; None: the one that the log says is its own.

    Raises:
        VitacError: there is none, or it is not signed by that key.
    """
    from vitac.server.transparency.tiles import PublishedLog, read_key

    fetch = _fetch_from_folder(Path(named)) if Path(named).is_dir() else _fetch_from_service(named)
    return PublishedLog(fetch, parse_log_key(key) if key else read_key(fetch))


def parse_log_key(text: str) -> VerifierKey:
    """Return the key of a log, as hexadecimal digits or NAME+ID+KEY.

    Raises:
        NoteRejected: it is none.
    """
    from vitac.server.transparency.notes import VerifierKey, make_log_key

    is_plain = len(text) == 64 and set(text) <= set("0123456789abcdef")
    return make_log_key(bytes.fromhex(text)) if is_plain else VerifierKey.parse(text)


def _fetch_from_folder(folder: Path) -> Fetch:
    def fetch(path: str) -> bytes | None:
        try:
            with (folder / path).open("rb") as file:
                return file.read(_MAX_FILE_BYTES)
        except (FileNotFoundError, NotADirectoryError):
            return None

    return fetch


def _fetch_from_service(address: str) -> Fetch:
    client = make_client(address.removesuffix("/").removesuffix("/log"), None, with_token=False)

    def fetch(path: str) -> bytes | None:
        try:
            return client.send("GET", f"/log/{path}", headers={"Accept": "*/*"}).content
        except RequestRefused as error:
            if error.status == 404:
                return None
            raise

    return fetch
