"""The video of a trial: motion JPEG whose frames are chained by hashes from the trial's one-time code on.

The file is one JPEG after the other, as players take it (`ffplay trial.mjpeg`). Each has a comment that says which
frame it is. Its link of the chain is SHA-256 over the link before, number, time and picture; the first follows the
code. The trial's record has the link after every env step: its state hashes, the result hash and the receipt cover it.
"""

import hashlib
import math
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Event, Lock, Thread
from typing import Any, BinaryIO, Final, NamedTuple, Self

import numpy as np
from pydantic import NonNegativeInt, PositiveInt
from vitac.errors import VitacError
from vitac.evaluator.episodes.records import StateHash, TrialVideo, canonical_json
from vitac.evaluator.strict_model import StrictModel

from .devices.cameras import Picture
from .eyes import OpenStation

PERIOD_S: Final = 0.2
"""Time between frames."""
_QUALITY: Final = 80
_GEL_SIZE: Final = (320, 240)
_OVERVIEW_SIZE: Final = (640, 480)
_START, _COMMENT = b"\xff\xd8", b"\xff\xfe"
_LARGEST_COMMENT: Final = 1024


class VideoUnreadable(VitacError):
    """The file is no video of a trial, or ends within a frame; the message says where."""


class FrameNote(StrictModel):
    """What the comment of a frame says.

    Attributes:
        code: of the trial.
        frame: its number, from 1.
        time_ns: when its pictures were taken [ns since 1970].
        picture: SHA-256 of the JPEG without this comment.
        n_bytes: length of that JPEG.
        link: of the chain, which covers all of the above and the link before.
        force_n: on the force/torque sensor; None where it has sent nothing.
        last: whether the video ends with it.
    """

    code: str
    frame: PositiveInt
    time_ns: NonNegativeInt
    picture: StateHash
    n_bytes: PositiveInt
    link: StateHash
    force_n: float | None = None
    last: bool = False

    def find_link(self, before: str) -> str:
        """Return the link that follows the one before."""
        content = self.model_dump(mode="json", exclude={"link"})
        return hashlib.sha256(before.encode() + canonical_json(content)).hexdigest()


def find_first_link(code: str) -> str:
    """Return what the first frame's link follows."""
    return hashlib.sha256(code.encode()).hexdigest()


class StoredFrame(NamedTuple):
    """A frame of a file: its comment, and the JPEG without it."""

    note: FrameNote
    jpeg: bytes


def encode_frame(note: FrameNote, jpeg: bytes) -> bytes:
    """Return a JPEG with a comment."""
    content = note.model_dump_json().encode()
    return _START + _COMMENT + struct.pack(">H", len(content) + 2) + content + jpeg[len(_START) :]


def read_frames(file: Path) -> Iterator[StoredFrame]:
    """Yield the frames of a video.

    Raises:
        VideoUnreadable: while it is iterated, at the first thing that is no frame.
    """
    with file.open("rb") as video:
        number = 0
        while head := video.read(6):
            number += 1
            yield _read_frame(video, head, number)


def _read_frame(video: BinaryIO, head: bytes, number: int) -> StoredFrame:
    length = struct.unpack(">H", head[4:])[0] - 2 if len(head) == 6 and head[:4] == _START + _COMMENT else 0
    if not 0 < length <= _LARGEST_COMMENT:
        raise VideoUnreadable(f"Expected frame {number} of a trial's video, got other bytes. Take the file as stored.")
    try:
        note = FrameNote.model_validate_json(video.read(length))
    except ValueError as error:
        raise VideoUnreadable(f"The comment of frame {number} cannot be read: {error}") from error
    body = video.read(note.n_bytes - len(_START))
    if len(body) + len(_START) != note.n_bytes:
        raise VideoUnreadable(f"The video was cut: it ends within frame {note.frame}.")
    return StoredFrame(note, _START + body)


def compose(station: OpenStation) -> tuple[Picture, int] | None:
    """Return one picture of all cameras and its time [ns since 1970]; None before they have sent any.

    The overview stands left, both gels beside it, the left one above.
    """
    import cv2

    taken = station.eyes.pictures
    if taken is None:
        return None
    (left, right), time_ns = taken
    gels = [cv2.resize(picture, _GEL_SIZE, interpolation=cv2.INTER_AREA) for picture in (left, right)]
    overview = None if station.overview is None else station.overview.latest
    if overview is None:
        return np.asarray(np.hstack(gels), dtype=np.uint8), time_ns
    whole = cv2.resize(overview, _OVERVIEW_SIZE, interpolation=cv2.INTER_AREA)
    return np.asarray(np.hstack((whole, np.vstack(gels))), dtype=np.uint8), time_ns


def find_overview(picture: Picture) -> Picture | None:
    """Return the overview's part of a composed picture; None without one."""
    width, height = _OVERVIEW_SIZE
    return picture[:, :width] if picture.shape[0] == height else None


class VideoRecorder:
    """Records what all cameras of an open station see; use it in `with`.

    The station stops where the video cannot be written: a trial without one has to be played again.
    """

    def __init__(
        self,
        station: OpenStation,
        file: Path,
        code: str,
        share: Callable[[str, bytes], None] = lambda _code, _jpeg: None,
    ) -> None:
        """Write to a file, which is replaced, and give the code and each picture (JPEG) to `share`."""
        self._station, self.file, self._code, self._share = station, file, code, share
        self._frames, self._link, self._time_ns = 0, find_first_link(code), 0
        self._waiting: tuple[bytes, int, float | None] | None = None
        self._digest, self._n_bytes = hashlib.sha256(), 0
        self._over, self._lock = Event(), Lock()
        self._is_whole = True

    def __enter__(self) -> Self:
        if self._station.overview is not None:
            self._station.overview.show_code(self._code)
        self._output = self.file.open("wb", buffering=0)
        self._thread = Thread(target=self._record, name="video of the trial", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()
        self._attempt(lambda: self._write_waiting(last=True))
        self._output.close()

    def mark(self) -> dict[str, Any]:
        """Return number and link of the last frame that was written, for the record of an env step."""
        with self._lock:
            return {"frame": self._frames, "link": self._link}

    @property
    def video(self) -> TrialVideo | None:
        """What the record says of it once it is over; None where it could not be written."""
        if not self._is_whole or not self._frames:
            return None
        return TrialVideo(
            code=self._code,
            frames=self._frames,
            link=self._link,
            sha256=self._digest.hexdigest(),
            n_bytes=self._n_bytes,
        )

    def _record(self) -> None:
        while not self._over.wait(PERIOD_S):
            self._attempt(self._take)

    def _attempt(self, write: Callable[[], None]) -> None:
        try:
            if self._is_whole:
                write()
        except OSError as error:
            self._is_whole = False
            self._station.guard.stop(
                f"The video of the trial cannot be written to {self.file.parent}: {error.strerror or error}. Free "
                "space there; the trial is played again."
            )

    def _take(self) -> None:
        import cv2

        picture = compose(self._station)
        if picture is None or picture[1] == self._time_ns:
            return
        jpeg = cv2.imencode(".jpg", picture[0], [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()
        self._write_waiting(last=False)
        self._share(self._code, jpeg)
        wrench = self._station.guard.wrench()
        force_n = None if wrench is None else round(math.hypot(*wrench[:3]), 3)
        self._waiting, self._time_ns = (jpeg, picture[1], force_n), picture[1]

    def _write_waiting(self, *, last: bool) -> None:
        """Write the frame that waits until it is known whether another one follows."""
        if self._waiting is None:
            return
        jpeg, time_ns, force_n = self._waiting
        note = FrameNote(
            code=self._code,
            frame=self._frames + 1,
            time_ns=time_ns,
            picture=hashlib.sha256(jpeg).hexdigest(),
            n_bytes=len(jpeg),
            link=self._link,
            force_n=force_n,
            last=last,
        )
        note = note.model_copy(update={"link": note.find_link(self._link)})
        content = encode_frame(note, jpeg)
        if self._output.write(content) != len(content):
            raise OSError(f"only a part of frame {note.frame} was written")
        self._digest.update(content)
        with self._lock:
            self._frames, self._link, self._n_bytes = note.frame, note.link, self._n_bytes + len(content)
