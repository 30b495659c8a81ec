"""The chain of receipts as everybody sees it."""

from datetime import datetime

from pydantic import Field

from .base import View


class LinkView(View):
    """One link of the chain; it shows nothing of the content that it stands for."""

    number: int
    previous: str | None = Field(description="Digest of the link before; null for the first.")
    content: str = Field(description="What it stands for: submission, result or end.")
    content_sha256: str = Field(description="Salted SHA-256 of the content.")
    issued_at: datetime = Field(description="Never before that of the link before.")
    public_key: str
    signature: str = Field(description="Ed25519, by that key.")
    digest: str = Field(description="SHA-256 of all but the signature.")
    board: str = Field(description="Competition, track, stage and kind of the submission.")


class ChainView(View):
    """A page of the chain, or of the links of one competition, from the beginning."""

    public_key: str = Field(description="Ed25519 key of this service (32 bytes, hexadecimal); keep a copy of it.")
    receipts: int = Field(description="Length of the whole chain.")
    last: str | None = Field(description="Digest of the last link of the whole chain; null without one.")
    items: list[LinkView]
    next_after: int | None = Field(description="Give this as `after` for the next page; null on the last one.")
