"""What many ask for and may be some seconds old. Held by `site`."""

from collections.abc import Awaitable, Callable
from time import monotonic
from typing import Generic, TypeVar

ValueT = TypeVar("ValueT")


class Recent(Generic[ValueT]):
    """The value as it was read last.

    Args:
        kept_s: after this time it is read again, perhaps by several requests at once [s].
    """

    def __init__(self, *, kept_s: float) -> None:
        self._kept_s = kept_s
        self._read: tuple[float, ValueT] | None = None

    async def get(self, read: Callable[[], Awaitable[ValueT]]) -> ValueT:
        """Return the value of the last reading, or read it."""
        found = self._read
        if found is None or monotonic() - found[0] >= self._kept_s:
            found = (monotonic(), await read())
            self._read = found
        return found[1]
