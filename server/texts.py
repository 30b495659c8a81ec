"""Texts of several lines that people write: announcements, questions and answers, appeals and rulings."""

from .errors import ProblemCode, ServiceError

TEXT_LENGTH = 4000


def clean_text(text: str, *, what: str) -> str:
    """Return a text as it is stored: plain, without controls and characters that draw nothing.

    Raises:
        ServiceError: it is empty or too long, or has such characters.
    """
    lines = [line.rstrip() for line in text.replace("\r\n", "\n").strip().split("\n")]
    kept = "\n".join(lines)
    if not 2 <= len(kept) <= TEXT_LENGTH or any(not line.replace("\t", "").isprintable() for line in lines):
        raise ServiceError(
            ProblemCode.INVALID_REQUEST,
            f"{what} has 2 to {TEXT_LENGTH} printable characters; got {len(kept)}: {kept[:60]!r}.",
        )
    return kept
