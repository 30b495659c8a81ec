"""Twin of a tactile camera: an HTTP server that sends pictures as motion JPEG, which OpenCV reads like a camera."""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Event, Thread
from typing import Self

import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]
_BOUNDARY = "picture"
_QUALITY = 95


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
    """

    picture: Callable[[], Picture]
    period_s: float = 0.04
    faults: set[CameraFault] = field(default_factory=set)
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
    def stream(self) -> str:
        """Address of the stream."""
        return f"http://127.0.0.1:{self._server.server_address[1]}/stream.mjpg"

    def send(self, write: Callable[[bytes], object]) -> None:
        """Write parts until the stream ends."""
        import cv2

        jpeg = b""
        while not self._over.is_set() and CameraFault.UNPLUGGED not in self.faults:
            if not jpeg or CameraFault.FROZEN not in self.faults:
                jpeg = cv2.imencode(".jpg", self.picture(), [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()
            head = f"--{_BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
            write(head.encode() + jpeg + b"\r\n")
            self._over.wait(self.period_s)


def _handler(twin: CameraTwin) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={_BOUNDARY}")
            self.end_headers()
            try:
                twin.send(self.wfile.write)
            except OSError:
                return  # the driver closed the stream

        def log_message(self, *_: object) -> None:
            """Write nothing for each request."""

    return Handler
