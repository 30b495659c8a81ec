"""Drivers of the cameras: the RGB-D camera by `pyrealsense2`, and tactile sensors, which are UVC cameras, by OpenCV."""

import json
import os
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self
from urllib.request import urlopen

import numpy as np
from numpy.typing import NDArray

from ..description import DepthCameraSettings as Described
from .stage import DeviceFault, DeviceNotFound, Identity

WIDTH, HEIGHT, RATE_HZ = 640, 480, 30
_ANSWER_MS: Final = 2000
_STREAM_MS: Final = 8000
"""Longest wait for a picture of a stream; `patience` is a factor of it."""


@dataclass(frozen=True, kw_only=True)
class ColourIntrinsics:
    """Intrinsics of the colour camera [pixel]."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float


@dataclass(frozen=True, kw_only=True)
class ColourDepth:
    """One aligned pair.

    Attributes:
        colour: shape [480, 640, 3], blue first.
        depth_m: shape [480, 640], 0 where unknown [m].
    """

    colour: NDArray[np.uint8]
    depth_m: NDArray[np.float32]


class DepthCamera:
    """An open D415; use it in `with`."""

    def __init__(self, serial_number: str) -> None:
        """Start both streams; raise DeviceNotFound where no such camera is plugged in."""
        rs = _library()
        self._name = f"RGB-D camera {serial_number}"
        self._device = _find(rs, serial_number)
        settings = rs.config()
        settings.enable_device(serial_number)
        settings.enable_stream(rs.stream.depth, WIDTH, HEIGHT, rs.format.z16, RATE_HZ)
        settings.enable_stream(rs.stream.color, WIDTH, HEIGHT, rs.format.bgr8, RATE_HZ)
        self._pipeline = rs.pipeline()
        try:
            self._profile = self._pipeline.start(settings)
        except RuntimeError as error:
            raise DeviceFault(f"The {self._name} does not start: {error}. Plug it into a USB 3 port.") from error
        self._align = rs.align(rs.stream.color)
        self._metres_per_unit = self._profile.get_device().first_depth_sensor().get_depth_scale()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._pipeline.stop()

    def identify(self) -> Identity:
        """Return its serial number and firmware."""
        rs = _library()
        return Identity(
            serial_number=self._device.get_info(rs.camera_info.serial_number),
            firmware=self._device.get_info(rs.camera_info.firmware_version),
        )

    def intrinsics(self) -> ColourIntrinsics:
        """Return the intrinsics of the colour camera that its maker stored in it."""
        rs = _library()
        of_stream = self._profile.get_stream(rs.stream.color).as_video_stream_profile().get_intrinsics()
        return ColourIntrinsics(
            width=of_stream.width,
            height=of_stream.height,
            fx=of_stream.fx,
            fy=of_stream.fy,
            cx=of_stream.ppx,
            cy=of_stream.ppy,
        )

    def read(self) -> ColourDepth:
        """Return the next pair; raise DeviceFault if the camera stopped sending."""
        try:
            frames = self._align.process(self._pipeline.wait_for_frames(_ANSWER_MS))
        except RuntimeError as error:
            raise DeviceFault(f"The {self._name} stopped sending: {error}. Plug it in again.") from error
        depth = np.asanyarray(frames.get_depth_frame().get_data())
        colour = np.asanyarray(frames.get_color_frame().get_data()).copy()
        return ColourDepth(colour=colour, depth_m=depth.astype(np.float32) * np.float32(self._metres_per_unit))


class StreamedDepthCamera:
    """A camera whose pairs another program gives over HTTP, as a twin does; used as `DepthCamera`."""

    def __init__(self, serial_number: str, stream: str, *, patience: float = 1.0) -> None:
        """Ask for its identity; raise DeviceNotFound if nothing answers in time, which `patience` is a factor of."""
        self._name, self._stream = f"RGB-D camera {serial_number} at {stream}", stream
        self._answer_s = 1e-3 * _ANSWER_MS * patience
        try:
            self._about: dict[str, Any] = json.loads(self._get("about"))
        except DeviceFault as error:
            raise DeviceNotFound(str(error)) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing stays open."""

    def identify(self) -> Identity:
        """Return its serial number and firmware."""
        return Identity(serial_number=self._about["serial_number"], firmware=self._about["firmware"])

    def intrinsics(self) -> ColourIntrinsics:
        """Return the intrinsics of the colour camera."""
        return ColourIntrinsics(**self._about["intrinsics"])

    def read(self) -> ColourDepth:
        """Return a pair that is taken now; raise DeviceFault if the camera does not send one."""
        import cv2

        body = self._get("pair")
        (length,) = struct.unpack(">I", body[:4])
        colour = cv2.imdecode(np.frombuffer(body[4 : 4 + length], np.uint8), cv2.IMREAD_COLOR)
        depth = cv2.imdecode(np.frombuffer(body[4 + length :], np.uint8), cv2.IMREAD_UNCHANGED)
        if colour is None or depth is None:
            raise DeviceFault(f"The {self._name} sent no pictures, but {len(body)} bytes. Restart it.")
        depth_m = depth.astype(np.float32) / np.float32(self._about["units_per_m"])
        return ColourDepth(colour=np.asarray(colour, dtype=np.uint8), depth_m=depth_m)

    def _get(self, what: str) -> bytes:
        try:
            with urlopen(f"{self._stream}/{what}", timeout=self._answer_s) as answer:  # noqa: S310 - of the station's file
                return bytes(answer.read())
        except OSError as error:
            raise DeviceFault(f"The {self._name} does not answer: {error}. Check that it runs and sees.") from error


AnyDepthCamera = DepthCamera | StreamedDepthCamera


def open_depth_camera(described: Described, *, patience: float = 1.0) -> AnyDepthCamera:
    """Open the camera of a station's file; `patience` is a factor of the time within which a stream has to answer.

    Raises:
        DeviceNotFound: it is not there.
    """
    if described.stream is not None:
        return StreamedDepthCamera(described.serial_number, described.stream, patience=patience)
    return DepthCamera(described.serial_number)


def _library() -> Any:
    try:
        import pyrealsense2
    except ImportError as error:  # also of the system library that it loads
        raise DeviceNotFound(f"pyrealsense2 cannot be loaded: {error}. Install it, and libusb-1.0.") from error
    return pyrealsense2


def _find(rs: Any, serial_number: str) -> Any:
    there = {device.get_info(rs.camera_info.serial_number): device for device in rs.context().query_devices()}
    if serial_number not in there:
        names = ", ".join(sorted(there)) or "none"
        raise DeviceNotFound(f"No RealSense with serial number {serial_number}. Here: {names}. Check cable and file.")
    return there[serial_number]


Picture = NDArray[np.uint8]

_SYSTEM_CAMERAS: Final = Path("/sys/class/video4linux")
_STREAM_OPTIONS: Final = "OPENCV_FFMPEG_CAPTURE_OPTIONS"
_FROZEN_PICTURES: Final = 10
"""A camera's noise makes every picture differ, so equal ones are a frozen stream."""


class UsbCamera:
    """An open camera; use it in `with`."""

    def __init__(
        self,
        name: str,
        serial_number: str,
        stream: str | None = None,
        cameras: Path = _SYSTEM_CAMERAS,
        *,
        patience: float = 1.0,
    ) -> None:
        """Open the camera with a serial number, or a stream in its place.

        Args:
            name: for messages.
            serial_number: as on its label, 28F0-GX7F.
            stream: address that OpenCV reads in place of the USB camera.
            cameras: where the kernel lists cameras.
            patience: factor of the time within which a stream has to send a picture.

        Raises:
            DeviceNotFound: no such camera, or it cannot be opened.
        """
        self._name = name
        self._capture = _open(stream or find_camera(serial_number, cameras), self._name, patience)
        self._last: Picture | None = None
        self._equal = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._capture.release()

    def read(self) -> Picture:
        """Return the next picture, shape [height, width, 3], blue first.

        Raises:
            DeviceFault: the camera stopped sending, or sends the same picture again and again.
        """
        is_read, picture = self._capture.read()
        if not is_read:
            raise DeviceFault(f"The {self._name} stopped sending pictures. Check its USB cable.")
        is_same = self._last is not None and np.array_equal(picture, self._last)
        self._equal = self._equal + 1 if is_same else 0
        if self._equal >= _FROZEN_PICTURES:
            raise DeviceFault(f"The {self._name} is frozen: {self._equal + 1} equal pictures. Plug it in again.")
        self._last = np.asarray(picture, dtype=np.uint8)
        return self._last


class GelSightCamera(UsbCamera):
    """An open tactile camera; use it in `with`."""

    def __init__(
        self,
        serial_number: str,
        *,
        stream: str | None = None,
        cameras: Path = _SYSTEM_CAMERAS,
        patience: float = 1.0,
    ) -> None:
        """Open it as any camera."""
        super().__init__(f"tactile camera {serial_number}", serial_number, stream, cameras, patience=patience)


def find_camera(serial_number: str, cameras: Path = _SYSTEM_CAMERAS) -> str:
    """Return the device file of the camera whose name has a serial number: GelSight Mini R0B 28F0-GX7F: Ge.

    Raises:
        DeviceNotFound: naming the cameras that are there.
    """
    names = {node.parent.name: node.read_text().strip() for node in sorted(cameras.glob("video*/name"))}
    for node, name in names.items():
        index = cameras / node / "index"
        is_pictures = not index.exists() or index.read_text().strip() == "0"  # others carry metadata
        if serial_number in name and is_pictures:
            return f"/dev/{node}"
    there = ", ".join(sorted(set(names.values()))) or "none"
    raise DeviceNotFound(
        f"No camera has the serial number {serial_number}. Cameras here: {there}. Check cable and file."
    )


@contextmanager
def _short_buffer() -> Iterator[None]:
    """Have OpenCV open streams that hold few old pictures; it takes this from the environment only."""
    before = os.environ.get(_STREAM_OPTIONS)
    os.environ[_STREAM_OPTIONS] = "recv_buffer_size;8192"
    try:
        yield
    finally:
        del os.environ[_STREAM_OPTIONS]
        if before is not None:
            os.environ[_STREAM_OPTIONS] = before


def _open(address: str, name: str, patience: float) -> Any:
    import cv2

    answer_ms = round(_ANSWER_MS * patience)
    options = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, answer_ms, cv2.CAP_PROP_READ_TIMEOUT_MSEC, round(_STREAM_MS * patience)]
    if address.startswith("/dev/"):
        capture = cv2.VideoCapture(address, cv2.CAP_V4L2)
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # the newest picture rather than an old one
    else:
        with _short_buffer():
            capture = cv2.VideoCapture(address, cv2.CAP_FFMPEG, options)
    if not capture.isOpened():
        raise DeviceNotFound(f"The {name} at {address} cannot be opened. Is it plugged in, and used by nothing else?")
    return capture
