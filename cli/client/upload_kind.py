"""The kind of a submission by its file name: a model's zip, our log, or a 2025 text log. Called by `submit`."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path

GZIP_MAGIC = b"\x1f\x8b"


class UploadKind(StrEnum):
    """The kinds of submission, as named in the API."""

    MODEL = "model"
    LOG = "log"
    TEXT_LOG = "text_log"


CONTENT_TYPES = {
    UploadKind.MODEL: "application/zip",
    UploadKind.LOG: "application/x-ndjson",
    UploadKind.TEXT_LOG: "text/plain",
}
KIND_OF_SUFFIX = {".jsonl": UploadKind.LOG, ".log": UploadKind.TEXT_LOG, ".txt": UploadKind.TEXT_LOG}


def kind_of(path: Path) -> UploadKind:
    """Return the kind of a file or folder by its name; the service checks the content."""
    if path.is_dir():
        return UploadKind.MODEL
    named = path.with_suffix("") if path.suffix == ".gz" else path
    return KIND_OF_SUFFIX.get(named.suffix.lower(), UploadKind.MODEL)


def content_type(path: Path, kind: UploadKind) -> str:
    """Return how the body of an upload is announced."""
    with path.open("rb") as file:
        packed = file.read(len(GZIP_MAGIC)) == GZIP_MAGIC
    return "application/gzip" if packed and kind is not UploadKind.MODEL else CONTENT_TYPES[kind]
