"""The camera that sees a whole platform, and the screen beside it that shows the one-time code of a trial.

The code is a QR code in a picture, which any program for pictures shows on that screen.
"""

from contextlib import suppress
from pathlib import Path
from threading import Event, Thread
from time import monotonic
from typing import Final, Self

import numpy as np

from .description import OverviewSettings
from .devices.cameras import Picture, UsbCamera
from .devices.stage import DeviceFault
from .guard import Guard, StopCause

_MODULE_PX: Final = 8
_QUIET_PX: Final = 32
_SEEN_WITHIN_S, _LOOK_S = 5.0, 0.05


class Overview:
    """An open overview camera; use it in `with`. The guard is stopped where it fails: a trial needs its evidence."""

    def __init__(self, settings: OverviewSettings, guard: Guard, patience: float) -> None:
        """Open the camera; raise DeviceNotFound where it is not there."""
        self._settings, self._guard = settings, guard
        name = f"overview camera {settings.serial_number}"
        self._camera = UsbCamera(name, settings.serial_number, settings.stream, patience=patience)
        self._over = Event()
        self.latest: Picture | None = None

    def __enter__(self) -> Self:
        self._thread = Thread(target=self._look, name="overview of the station", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()
        self._camera.__exit__()

    def show_code(self, code: str) -> None:
        """Write the picture with a code for the screen, and wait a while until the camera sees it there."""
        if self._settings.code_picture is None:
            return
        write_code(code, self._settings.code_picture)
        end_s = monotonic() + _SEEN_WITHIN_S
        while (self.latest is None or read_code(self.latest) != code) and monotonic() < end_s:
            self._over.wait(_LOOK_S)

    def _look(self) -> None:
        while not self._over.is_set():
            try:
                self.latest = self._camera.read()
            except DeviceFault as error:
                self._guard.stop(str(error), cause=StopCause.FAULT)
                return


def write_code(code: str, file: Path) -> None:
    """Write a picture of a code, whole at any time.

    Raises:
        DeviceFault: it cannot be written.
    """
    import cv2

    modules = cv2.QRCodeEncoder.create().encode(code)
    large = cv2.resize(modules, None, fx=_MODULE_PX, fy=_MODULE_PX, interpolation=cv2.INTER_NEAREST)
    framed = np.pad(np.asarray(large), _QUIET_PX, constant_values=255)
    whole = file.with_suffix(".new.png")
    if not cv2.imwrite(str(whole), framed):
        raise DeviceFault(
            f"The trial's code cannot be written to {file}, the `code_picture` of the station's file. Make its folder, "
            "writable for the agent, with free space."
        )
    whole.replace(file)


def read_code(picture: Picture) -> str | None:
    """Return the code that a picture shows; None where none can be read.

    OpenCV's other detector reads one code in a few hundred in none of the pictures that show it.
    """
    import cv2

    with suppress(cv2.error):  # raised for some patterns that are no code
        text, *_ = cv2.QRCodeDetectorAruco().detectAndDecode(np.ascontiguousarray(picture))
        return text or None
    return None
