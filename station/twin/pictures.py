"""Twin of a tactile camera: an HTTP server that sends pictures as motion JPEG, which OpenCV reads like a camera."""

import select
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from fcntl import ioctl
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from socket import SO_SNDBUF, SOL_SOCKET, socket
from threading import Event, Thread
from time import monotonic, sleep
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]
_BOUNDARY = "picture"
_QUALITY = 95
_SENT_AHEAD_BYTES: Final = 16_384
"""Less than a picture."""
_SIOCOUTQ: Final = 0x5411
"""Linux: asks for the bytes that the other side has not received."""
_POLL_S: Final = 5e-4


class CameraFault(StrEnum):
    """What a script can break."""

    FROZEN = "frozen"
    """It sends the same picture again and again."""
    UNPLUGGED = "unplugged"
    """The stream ends."""


@dataclass(kw_only=True)
class CameraTwin:
    """A camera; use it in `with`.

    Attributes:
        picture: gives the next picture, shape [height, width, 3], blue first.
        period_s: time between pictures.
        faults: what is broken now.
        streams: number of readers.
    """

    picture: Callable[[], Picture]
    period_s: float = 0.04
    faults: set[CameraFault] = field(default_factory=set)
    streams: int = 0
    _over: Event = field(default_factory=Event)

    def __enter__(self) -> Self:
        self._server = ThreadingHTTPServer(("127.0.0.1", 0), _handler(self))
        self._server.daemon_threads = True
        self._thread = Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._server.shutdown()
        self._server.server_close()

    @property
    def is_over(self) -> bool:
        """Whether it has ended."""
        return self._over.is_set()

    @property
    def stream(self) -> str:
        """Address of the stream."""
        return f"http://127.0.0.1:{self._server.server_address[1]}/stream.mjpg"

    def send(self, write: Callable[[bytes], object]) -> None:
        """Write parts until the stream ends."""
        self.streams += 1
        try:
            self._send(write)
        finally:
            self.streams -= 1

    def _send(self, write: Callable[[bytes], object]) -> None:
        import cv2

        jpeg, due_s = b"", monotonic()
        while not self._over.is_set() and CameraFault.UNPLUGGED not in self.faults:
            if not jpeg or CameraFault.FROZEN not in self.faults:
                jpeg = cv2.imencode(".jpg", self.picture(), [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()
            head = f"--{_BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
            write(head.encode() + jpeg + b"\r\n")
            due_s = max(due_s + self.period_s, monotonic() - self.period_s)
            self._over.wait(max(due_s - monotonic(), 0.0))


def _handler(twin: CameraTwin) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.connection.setsockopt(SOL_SOCKET, SO_SNDBUF, _SENT_AHEAD_BYTES)
            self.send_response(200)
            self.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={_BOUNDARY}")
            self.end_headers()
            try:
                twin.send(self._write)
            except OSError:
                return  # the driver closed the stream

        def _write(self, part: bytes) -> None:
            """Write a part, and wait until the reader has taken nearly all of it: it is to get no old pictures."""
            self.wfile.write(part)
            while not twin.is_over and _unsent_bytes(self.connection):
                if _is_closed(self.connection):
                    raise ConnectionResetError("the reader left")
                sleep(_POLL_S)

        def log_message(self, *_: object) -> None:
            """Write nothing for each request."""

    return Handler


def _is_closed(connection: socket) -> bool:
    poll = select.poll()
    poll.register(connection, select.POLLRDHUP)
    return bool(poll.poll(0))


def _unsent_bytes(connection: socket) -> int:
    return int(struct.unpack("i", ioctl(connection, _SIOCOUTQ, b"\0\0\0\0"))[0])
