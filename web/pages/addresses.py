"""What the addresses of pages name. Called by the pages."""

from __future__ import annotations

from uuid import UUID

from vitac.server.errors import not_found


def as_id(text: str) -> UUID:
    """Return the id in an address.

    Raises:
        ServiceError: it is not an id, so there is no such submission.
    """
    try:
        found = UUID(text)
    except ValueError as error:
        raise not_found("submission", text) from error
    if str(found) != text.lower():  # UUID also reads braces and digits of other scripts
        raise not_found("submission", text)
    return found
