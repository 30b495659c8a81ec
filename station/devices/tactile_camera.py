"""Driver of a tactile camera: a GelSight Mini is a UVC camera, read with OpenCV."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from .device import DeviceFault, DeviceNotFound

Picture = NDArray[np.uint8]

_SYSTEM_CAMERAS: Final = Path("/sys/class/video4linux")
_STREAM_OPTIONS: Final = "OPENCV_FFMPEG_CAPTURE_OPTIONS"
_ANSWER_MS: Final = 2000
_FROZEN_PICTURES: Final = 10
"""A camera's noise makes every picture differ, so equal ones are a frozen stream."""


class TactileCamera:
    """An open camera; use it in `with`."""

    def __init__(self, serial_number: str, *, stream: str | None = None, cameras: Path = _SYSTEM_CAMERAS) -> None:
        """Open the camera with a serial number, or a stream in its place.

        Args:
            serial_number: as on its label, 28F0-GX7F.
            stream: address that OpenCV reads in place of the USB camera.
            cameras: where the kernel lists cameras.

        Raises:
            DeviceNotFound: no such camera, or it cannot be opened.
        """
        self._name = f"tactile camera {serial_number}"
        self._capture = _open(stream or find_camera(serial_number, cameras), self._name)
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


def _open(address: str, name: str) -> Any:
    import cv2

    options = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, _ANSWER_MS, cv2.CAP_PROP_READ_TIMEOUT_MSEC, _ANSWER_MS]
    if address.startswith("/dev/"):
        capture = cv2.VideoCapture(address, cv2.CAP_V4L2)
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # the newest picture rather than an old one
    else:
        with _short_buffer():
            capture = cv2.VideoCapture(address, cv2.CAP_FFMPEG, options)
    if not capture.isOpened():
        raise DeviceNotFound(f"The {name} at {address} cannot be opened. Is it plugged in, and used by nothing else?")
    return capture
