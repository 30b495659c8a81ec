"""Parts of pages as they were last rendered or read. Held by `site`."""

from collections.abc import Awaitable, Callable, Hashable
from time import monotonic
from typing import Generic, TypeVar

from markupsafe import Markup
from vitac.server.cache import Cache

ValueT = TypeVar("ValueT")
MAX_FRAGMENTS = 8192
"""Rows of boards are about 1 kB each."""


class Fragments:
    """The parts of pages that were asked for last."""

    def __init__(self, *, at_most: int = MAX_FRAGMENTS) -> None:
        self._cache: Cache[Hashable, Markup] = Cache(at_most=at_most)

    def get(self, key: Hashable, make: Callable[[], str]) -> Markup:
        """Return the part under a key, which names all that it depends on; rendered only where it is not cached."""
        return self._cache.get(key, lambda: Markup(make()))  # noqa: S704 - a rendered template, whose values are escaped


class Recent(Generic[ValueT]):
    """Something that many ask for and that may be some seconds old.

    Args:
        kept_s: after this time it is read again, perhaps by several requests at once [s].
    """

    def __init__(self, *, kept_s: float) -> None:
        self._kept_s = kept_s
        self._read: tuple[float, ValueT] | None = None

    async def get(self, read: Callable[[], Awaitable[ValueT]]) -> ValueT:
        """Return it as it was read last, or read it."""
        found = self._read
        if found is None or monotonic() - found[0] >= self._kept_s:
            found = (monotonic(), await read())
            self._read = found
        return found[1]
