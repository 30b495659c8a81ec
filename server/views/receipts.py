"""The log of receipts as everybody sees it."""

from datetime import datetime
from typing import Any

from pydantic import Field

from .base import View


class PublicLogEntryView(View):
    """One entry of the log; of submissions, results and ends it shows nothing but a hash."""

    number: int = Field(description="From 1; the index in the tree is one less.")
    content: str = Field(
        description="What it stands for: submission, result, end, competition, sealed_list, advancement, rejudgement "
        "or board."
    )
    content_sha256: str = Field(description="SHA-256 of the content, salted where the statement is null.")
    issued_at: datetime = Field(description="Never before that of the entry before.")
    board: str = Field(description="Competition, track, stage and kind of the submission.")
    statement: dict[str, Any] | None = Field(description="The content, where everybody may read it.")
    leaf_hash: str = Field(description="RFC 6962 hash of the entry's bytes, as in the tiles of /log/.")


class WitnessView(View):
    """A witness of a competition, and how far it has come."""

    witness: str = Field(description="Its verifier key: NAME+ID+KEY.")
    size: int = Field(description="Number of entries of the longest log that it has signed; 0 before the first.")
    behind: int = Field(description="Number of entries that it has not signed.")
    behind_s: float = Field(description="Age of the oldest entry that it has not signed; 0 where there is none.")
    signed_at: datetime | None = Field(description="When it signed last, as it says; null before.")


class PublicLogView(View):
    """A page of the log, or of the entries of one competition, from the beginning."""

    public_key: str = Field(description="Ed25519 key of this service (32 bytes, hexadecimal); keep a copy of it.")
    verifier_key: str = Field(description="The same key as NAME+ID+KEY, for tools that read signed notes.")
    receipts: int = Field(description="Length of the whole log.")
    root: str = Field(description="RFC 6962 root hash of the whole log.")
    checkpoint: str = Field(description="Signed by the service and by witnesses; the same as /log/checkpoint.")
    witnesses: list[WitnessView] = Field(description="Of all competitions of this service.")
    items: list[PublicLogEntryView]
    next_after: int | None = Field(description="Give this as `after` for the next page; null on the last one.")
