"""Uploads a file in pieces, so that a lost connection costs little: asks for the offset and continues from there.

The other side is the service's `/uploads`, by the protocol tus 1.0. The service finds an unfinished upload by the
digest of its content, so a command that was killed continues when it is started again. Called by `Client.upload`.
"""

import base64
import shutil
import sys
import time
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from http import HTTPStatus
from pathlib import Path
from typing import Any

import httpx

from .answers import NO_CODE, RequestRefused, ServiceUnreachable, decode_object

UPLOADS = "/api/v1/uploads"
PROTOCOL = {"Tus-Resumable": "1.0.0"}
CHUNK_BYTES = 1 << 18
PAUSES_S = (0.2, 0.5, 1.0, 2.0, 4.0, 8.0, 15.0, 15.0, 15.0)
"""Waits after failures with no byte of progress between them; after the last one the upload is given up."""
TRANSIENT = frozenset(
    {"database_unavailable", "not_found", "service_stopping", "storage_unavailable", "too_many_requests"}
    | {"upload_conflict", "upload_incomplete", "upload_truncated"}
)
"""Refusals that may go away; `not_found` only of an upload, which has expired then, so that a new one is begun."""
MISPLACED = frozenset({"not_found", "upload_conflict", "upload_incomplete"})
"""Refusals after which the client asks again for the offset of the upload."""
PROXY_STATUSES = frozenset({408, 502, 503, 504})
"""What a reverse proxy answers while the service behind it restarts or takes long."""
CHECKING_TIMEOUT_S = 600.0
"""The service unpacks and hashes the whole upload before it answers."""

Send = Callable[..., "httpx.Response"]
"""Sends a request (method, path, headers, content, timeout_s); raises where there is no good answer."""


@dataclass(kw_only=True)
class PieceSender:
    """One upload.

    Attributes:
        send: makes the requests.
        file: what is uploaded.
        metadata: what the service has to know of it, with its `sha256`.
        on_position: called with the number of bytes sent; after a lost connection it may be lower than before.
        on_known: called where the team had submitted the content before, so that nothing was started.
        pause: waits, in seconds.
    """

    send: Send
    file: Path
    metadata: Mapping[str, str]
    on_position: Callable[[int], None]
    on_known: Callable[[], object] = lambda: None
    pause: Callable[[float], None] = time.sleep

    def run(self) -> dict[str, Any]:
        """Upload, and return the submission.

        Raises:
            RequestRefused: the service refuses it.
            ServiceUnreachable: there was no progress for about a minute, at the start too.
        """
        failures, furthest = 0, -1
        place: str | None = None  # path of the upload since the service answered that it has one
        sent: str | None = None  # path of an upload all bytes of which have arrived
        while True:
            try:
                if sent is None:
                    place = None
                    place, offset = self._begin()
                    if offset > furthest:
                        failures, furthest = 0, offset
                    self._send_rest(place, offset)
                    sent = place
                # Asked again after a lost answer, the service returns the submission that it has made.
                answer = self.send("POST", f"{sent}/submission", timeout_s=CHECKING_TIMEOUT_S)
                if answer.status_code == HTTPStatus.OK and failures == 0:
                    self.on_known()
                return decode_object(answer)
            except ServiceUnreachable as error:
                if failures == len(PAUSES_S):
                    raise
                if failures == 0:
                    print(f"{error} Trying again for about a minute.", file=sys.stderr)
            except RequestRefused as error:
                if not is_transient(error, has_upload=place is not None) or failures == len(PAUSES_S):
                    raise
                if error.code in MISPLACED:
                    sent = None
            self.pause(PAUSES_S[failures])
            failures += 1

    def _begin(self) -> tuple[str, int]:
        """Begin the upload, or find it again; return its path and how many bytes the service has."""
        metadata = ",".join(
            f"{name} {base64.b64encode(text.encode()).decode()}" for name, text in self.metadata.items()
        )
        headers = {"Upload-Length": str(self.file.stat().st_size), "Upload-Metadata": metadata}
        answer = self.send("POST", UPLOADS, headers=PROTOCOL | headers)
        below = answer.headers["Location"].partition(UPLOADS)[2]  # the service may stand below a path of its host
        return f"{UPLOADS}{below}", int(answer.headers["Upload-Offset"])

    def _send_rest(self, place: str, offset: int) -> None:
        length = self.file.stat().st_size
        if offset == length:
            return
        headers = PROTOCOL | {
            "Content-Type": "application/offset+octet-stream",
            "Content-Length": str(length - offset),
            "Upload-Offset": str(offset),
        }
        self.send("PATCH", place, headers=headers, content=self._content(offset))

    def _content(self, position: int) -> Iterator[bytes]:
        with self.file.open("rb") as file:
            file.seek(position)
            self.on_position(position)
            while chunk := file.read(CHUNK_BYTES):
                yield chunk
                position += len(chunk)
                self.on_position(position)


def is_transient(error: RequestRefused, *, has_upload: bool = False) -> bool:
    """Return whether a refusal may go away; what is not found before there is an upload is named wrongly."""
    if error.code == "not_found":
        return has_upload
    return error.code in TRANSIENT or (error.code == NO_CODE and error.status in PROXY_STATUSES)


FIXED_TIME = (1980, 1, 1, 0, 0, 0)
READABLE_FILE = 0o100644 << 16
UNIX = 3
COPY_BYTES = 1 << 20
SAMPLE_BYTES = 1 << 20
WORTH_COMPRESSING = 0.9
"""A file whose start does not shrink to less of itself is stored as it is: compressing weights takes far longer than
sending them."""


def pack(folder: Path, archive: Path) -> int:
    """Write the archive of a submission's folder, with fixed order, times and modes and without caches.

    Args:
        folder: contains `submission.yaml`, directly or in a folder of its track such as `Track_1`.
        archive: file to write.

    Returns:
        Number of files packed.

    Raises:
        NoSubmission: the folder contains no submission.
        ManifestRejected: its manifest cannot be read.
        ArchiveRejected: the folder contains a link or a device.
    """
    from vitac.evaluator.submission.sources import find_submission, list_files, top_folder

    source = find_submission(folder)
    top = top_folder(source)
    paths = sorted(list_files(source))
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as writer:
        for path in paths:
            _add(writer, source / path, f"{top}/{path}")
    return len(paths)


def _add(writer: zipfile.ZipFile, file: Path, path: str) -> None:
    entry = zipfile.ZipInfo(path, FIXED_TIME)
    entry.compress_type = zipfile.ZIP_DEFLATED if _shrinks(file) else zipfile.ZIP_STORED
    entry.create_system = UNIX
    entry.external_attr = READABLE_FILE
    entry.file_size = file.stat().st_size
    with file.open("rb") as source, writer.open(entry, "w") as target:
        shutil.copyfileobj(source, target, COPY_BYTES)


def _shrinks(file: Path) -> bool:
    with file.open("rb") as source:
        sample = source.read(SAMPLE_BYTES)
    return len(zlib.compress(sample, level=1)) < WORTH_COMPRESSING * len(sample)
