"""Pictures of a gel under three coloured lights, and the HTTP server that sends them as motion JPEG, like a camera."""

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
        quality: of its JPEG.
        faults: what is broken now.
        streams: number of readers.
    """

    picture: Callable[[], Picture]
    period_s: float = 0.04
    quality: int = _QUALITY
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
                jpeg = cv2.imencode(".jpg", self.picture(), [cv2.IMWRITE_JPEG_QUALITY, self.quality])[1].tobytes()
            head = f"--{_BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
            write(head.encode() + jpeg + b"\r\n")
            due_s = max(due_s + self.period_s, monotonic() - self.period_s)
            self._over.wait(max(due_s - monotonic(), 0.0))


def _handler(twin: CameraTwin) -> type[BaseHTTPRequestHandler]:
    class StreamHandler(BaseHTTPRequestHandler):
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

    return StreamHandler


def _is_closed(connection: socket) -> bool:
    poll = select.poll()
    poll.register(connection, select.POLLRDHUP)
    return bool(poll.poll(0))


def _unsent_bytes(connection: socket) -> int:
    return int(struct.unpack("i", ioctl(connection, _SIOCOUTQ, b"\0\0\0\0"))[0])


_WIDTH_PX, _HEIGHT_PX = 320, 240
_BORDER: Final = 7
_MORE_ROWS_AT_THE_TOP: Final = 2
_LIGHTS: Final = (  # direction in the picture, and colour (blue first)
    ((1.0, 0.0), (120.0, 30.0, 20.0)),
    ((-0.5, 0.87), (20.0, 110.0, 30.0)),
    ((-0.5, -0.87), (30.0, 30.0, 120.0)),
)
_AMBIENT: Final = 70.0
_MOMENTS: Final = (-0.5, -0.25, 0.0, 0.25, 0.5)
"""Parts of an exposure, from its middle, of which a smeared picture is the mean."""
_SUBPIXEL_BITS: Final = 4
SUBPIXELS: Final = 1 << _SUBPIXEL_BITS
"""Markers are printed at places of as many parts of a pixel."""


@dataclass(frozen=True, kw_only=True)
class GelCamera:
    """A camera behind a gel.

    Attributes:
        width: of its pictures [pixel].
        height: of its pictures.
        marker_radius_px: of a printed marker in the cut picture of 320 x 240.
        darkness: part of the light that a marker swallows.
        defocus_px: standard deviation of the blur in the cut picture.
        noise: standard deviation of a colour's value.
    """

    width: int = 640
    height: int = 480
    marker_radius_px: float = 4.0
    darkness: float = 0.75
    defocus_px: float = 1.0
    noise: float = 2.0

    def picture(
        self,
        markers_px: NDArray[np.float64],
        generator: np.random.Generator,
        *,
        darkness: NDArray[np.float64] | None = None,
        tilt: tuple[float, float] = (0.0, 0.0),
    ) -> NDArray[np.uint8]:
        """Return a picture of the camera, blue first.

        Args:
            markers_px: centres in the cut picture, shape [n, 2] [pixel].
            generator: draws the noise.
            darkness: of each marker, shape [n]; a worn one is paler.
            tilt: slope of the gel's face, which shifts the light.
        """
        shading = self._shading(tilt)
        noise = self.noise * generator.standard_normal(shading.shape, dtype=np.float32)
        return self.expose(self.print_markers(shading, markers_px, darkness), noise)

    @staticmethod
    def expose(lit: NDArray[np.float32], noise: NDArray[np.float32]) -> NDArray[np.uint8]:
        """Return a picture of what is seen, with noise, both of shape [height, width, 3]."""
        import cv2

        return np.asarray(cv2.add(lit, noise, dtype=cv2.CV_8U), dtype=np.uint8)

    def print_markers(
        self,
        shading: NDArray[np.float32],
        markers_px: NDArray[np.float64],
        darkness: NDArray[np.float64] | None,
        smear_px: NDArray[np.float64] | None = None,
    ) -> NDArray[np.float32]:
        """Return a lit gel with its markers, without noise, shape [height, width, 3].

        Args:
            shading: of the gel without markers.
            markers_px: their centres in the cut picture, shape [n, 2] [pixel].
            darkness: of each, shape [n].
            smear_px: how far each moves while the shutter is open, shape [n, 2] [pixel].
        """
        import cv2

        scale_x, scale_y = self._scales()
        depths = np.full(len(markers_px), self.darkness) if darkness is None else darkness
        moments = (0.0,) if smear_px is None else _MOMENTS
        light = np.zeros((self.height, self.width), np.float32)
        for moment in moments:
            there_px = markers_px if smear_px is None else markers_px + moment * smear_px
            light += self._shadows(there_px, depths) / len(moments)
        blurred = cv2.GaussianBlur(light, (0, 0), self.defocus_px * scale_x, sigmaY=self.defocus_px * scale_y)
        return np.asarray(cv2.multiply(shading, cv2.merge((blurred, blurred, blurred))), dtype=np.float32)

    def _shadows(self, markers_px: NDArray[np.float64], darkness: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return what sharp markers leave of the light, shape [height, width]."""
        import cv2

        light = np.ones((self.height, self.width), np.float32)
        radius = round(self.marker_radius_px * self._scales()[0] * SUBPIXELS)
        for (u, v), depth in zip(self.from_cut(markers_px), darkness, strict=True):
            centre = (round(u * SUBPIXELS), round(v * SUBPIXELS))
            cv2.circle(light, centre, radius, 1.0 - float(depth), -1, cv2.LINE_8, _SUBPIXEL_BITS)
        return light

    def from_cut(self, positions_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where positions of the cut picture are in the camera's, shape [n, 2] [pixel]."""
        corner = (self.width // _BORDER, self.height // _BORDER + _MORE_ROWS_AT_THE_TOP)
        moved: NDArray[np.float64] = (positions_px + 0.5) * self._scales() - 0.5 + corner
        return moved

    def _scales(self) -> tuple[float, float]:
        columns = self.width - 2 * (self.width // _BORDER)
        rows = self.height - 2 * (self.height // _BORDER) - _MORE_ROWS_AT_THE_TOP
        return columns / _WIDTH_PX, rows / _HEIGHT_PX

    def framed(self, surface: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Return a cut picture with what the camera sees beyond its borders: the same as at them."""
        import cv2

        left, top = self.width // _BORDER, self.height // _BORDER + _MORE_ROWS_AT_THE_TOP
        middle = cv2.resize(surface, (self.width - 2 * left, self.height - 2 * top + _MORE_ROWS_AT_THE_TOP))
        bottom = top - _MORE_ROWS_AT_THE_TOP
        framed = cv2.copyMakeBorder(middle, top, bottom, left, left, cv2.BORDER_REPLICATE)
        return np.asarray(framed, dtype=np.float32)

    def _shading(self, tilt: tuple[float, float]) -> NDArray[np.float32]:
        x = np.linspace(-1, 1, self.width, dtype=np.float32)[None, :]
        y = np.linspace(-1, 1, self.height, dtype=np.float32)[:, None]
        shading = np.full((self.height, self.width, 3), _AMBIENT, np.float32)
        for (along_x, along_y), colour in _LIGHTS:
            towards = 0.5 + 0.25 * (along_x * (x + tilt[0]) + along_y * (y + tilt[1]))
            shading += np.clip(towards, 0, 1)[..., None] * np.array(colour, np.float32)
        return shading
