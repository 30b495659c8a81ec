"""A serial line without hardware: a pseudo-terminal whose other end is a twin."""

import os
import select
import tty
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread
from typing import Protocol, Self


class SerialTwin(Protocol):
    """A device at a serial line."""

    def receive(self, data: bytes) -> bytes:
        """Take bytes from the line and return what the device answers at once."""


class Terminal:
    """A pseudo-terminal that passes bytes to a twin; use it in `with`.

    Attributes:
        port: the device file that a driver opens: a link of this terminal's own, since the number of a pseudo-terminal
            that was closed is soon another program's.
    """

    def __init__(self, twin: SerialTwin) -> None:
        """Open the terminal and begin to listen."""
        self._twin = twin
        self._controller, self._line = os.openpty()
        tty.setraw(self._line)
        self._folder = TemporaryDirectory(prefix="vitac-twin-")
        link = Path(self._folder.name) / "port"
        link.symlink_to(os.ttyname(self._line))
        self.port = str(link)
        self._wake_read, self._wake_write = os.pipe()
        self._thread = Thread(target=self._listen, name=f"twin at {self.port}", daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.unplug()

    def unplug(self) -> None:
        """Close the line, as when a USB cable is pulled; the driver's next call fails."""
        if self._thread.is_alive():
            os.write(self._wake_write, b"x")
            self._thread.join()
            self._folder.cleanup()
            for descriptor in (self._controller, self._line, self._wake_read, self._wake_write):
                os.close(descriptor)

    def _listen(self) -> None:
        while True:
            ready, _, _ = select.select([self._controller, self._wake_read], [], [])
            if self._wake_read in ready:
                return
            answer = self._twin.receive(os.read(self._controller, 4096))
            if answer:
                os.write(self._controller, answer)
