"""Videos of what a camera saw, one picture for every frame of the table; by OpenCV."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from vitac.envs.errors import VitacError

_CODEC = "mp4v"


class VideoNotWritten(VitacError):
    """OpenCV cannot write a video here; install its own build, with FFmpeg."""


class VideoFile:
    """A video that is written.

    Args:
        path: of the file.
        fps: pictures per second.
        size: height and width [px].

    Raises:
        VideoNotWritten: OpenCV cannot.
    """

    def __init__(self, path: Path, *, fps: float, size: tuple[int, int]) -> None:
        import cv2

        path.parent.mkdir(parents=True, exist_ok=True)
        code = cv2.VideoWriter.fourcc(*_CODEC)
        self._writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, code, fps, size[::-1])
        if not self._writer.isOpened():
            raise VideoNotWritten(
                f"{path} cannot be written, because OpenCV has no encoder for {_CODEC}; expected "
                "opencv-python-headless. Install that."
            )

    def add(self, pictures: Iterable[NDArray[np.uint8]]) -> None:
        """Add pictures in red, green and blue, shape [h, w, 3] each."""
        for picture in pictures:
            self._writer.write(np.ascontiguousarray(picture[..., ::-1]))

    def close(self) -> None:
        """Write what is left."""
        self._writer.release()


def measure_video(path: Path) -> tuple[int, float]:
    """Return the number of pictures and the pictures per second; 0 pictures where it is no video."""
    import cv2

    video = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    try:
        count = 0
        while video.isOpened() and video.grab():
            count += 1
        return count, float(video.get(cv2.CAP_PROP_FPS))
    finally:
        video.release()
