"""Output of a policy: its end is stored for the team, all of it is counted."""

import os
from typing import Final

CHUNK_BYTES: Final = 64 * 1024
_KEPT_CONTROLS: Final = frozenset("\n\t")


class OutputTail:
    """Reads the policy's output as it comes and keeps the last part of it.

    Args:
        descriptor: end of the pipe to read from; owned from here on.
        kept_bytes: how much of the end to keep.
    """

    def __init__(self, descriptor: int, *, kept_bytes: int) -> None:
        os.set_blocking(descriptor, False)
        self._descriptor = descriptor
        self._kept_bytes = kept_bytes
        self._kept = bytearray()
        self._counted = 0
        self.is_closed = False

    def fileno(self) -> int:
        """Return the descriptor to poll."""
        return self._descriptor

    @property
    def counted_bytes(self) -> int:
        """Bytes printed since the last `restart_count`."""
        return self._counted

    def restart_count(self) -> None:
        """Count from zero and forget the stored output, at the start of an episode."""
        self.read_available()
        self._counted = 0
        self._kept.clear()

    def read_available(self, *, max_bytes: int = 8 * 1024 * 1024) -> None:
        """Read what is in the pipe, but no more than `max_bytes`, so that a flood cannot block the reader."""
        while max_bytes > 0 and not self.is_closed:
            try:
                piece = os.read(self._descriptor, CHUNK_BYTES)
            except BlockingIOError:
                return
            self.is_closed = not piece
            self._counted += len(piece)
            max_bytes -= len(piece)
            self._kept += piece
            del self._kept[: -self._kept_bytes]

    def text(self) -> str:
        """Return the stored end as text that is safe to print."""
        return printable(bytes(self._kept).decode("utf-8", "replace"))

    def close(self) -> None:
        """Close the pipe."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
        self._descriptor, self.is_closed = -1, True


def printable(text: str) -> str:
    """Return text from a policy without anything that would steer a terminal or break a line-based log."""
    text = text.replace("\r\n", "\n")
    return "".join(
        char if char in _KEPT_CONTROLS or char.isprintable() else "\N{REPLACEMENT CHARACTER}" for char in text
    )
