"""Twin of the RGB-D camera: an HTTP server that gives an aligned pair of pictures whenever it is asked.

A D415 speaks to `pyrealsense2` alone, so that this twin takes the place of both: it is no test of the bytes on USB.
"""

import json
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread
from typing import Any, Final, Self

import numpy as np
from vitac.envs.vision.camera import Sight

UNITS_PER_M: Final = 10_000
"""Of stored depths."""


@dataclass(kw_only=True)
class DepthCameraTwin:
    """A camera; use it in `with`.

    Attributes:
        look: gives what is seen; None where nothing is to be seen.
        about: its serial number, firmware and intrinsics.
    """

    look: Callable[[], Sight | None]
    about: dict[str, Any] = field(default_factory=dict)

    def __enter__(self) -> Self:
        self._server = ThreadingHTTPServer(("127.0.0.1", 0), _handler(self))
        self._server.daemon_threads = True
        Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.server_close()

    @property
    def stream(self) -> str:
        """Its address."""
        return f"http://127.0.0.1:{self._server.server_address[1]}"

    def take_pair(self) -> bytes | None:
        """Return the length of the colour picture, that picture, and the depth picture, both as PNG."""
        import cv2

        sight = self.look()
        if sight is None:
            return None
        depth = np.rint(sight.depth_m * UNITS_PER_M).astype(np.uint16)
        colour = cv2.imencode(".png", cv2.cvtColor(sight.colours, cv2.COLOR_RGB2BGR))[1].tobytes()
        return struct.pack(">I", len(colour)) + colour + cv2.imencode(".png", depth)[1].tobytes()


def _handler(twin: DepthCameraTwin) -> type[BaseHTTPRequestHandler]:
    class DepthHandler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            body = json.dumps(twin.about).encode() if self.path == "/about" else twin.take_pair()
            self.send_response(200 if body else 503)
            self.send_header("Content-Length", str(len(body or b"")))
            self.end_headers()
            self.wfile.write(body or b"")

        def log_message(self, *_: object) -> None:
            """Write nothing for each request."""

    return DepthHandler
