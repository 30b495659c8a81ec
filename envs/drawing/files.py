"""Where pictures go: one PNG, an animated GIF or WebP, or a folder of PNGs. Looked at before anything is simulated."""

import os
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from tempfile import TemporaryFile

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from PIL.TiffImagePlugin import AppendingTiffWriter
from vitac.errors import VitacError

Picture = NDArray[np.uint8]

_WEBP_QUALITY = 88


class PicturesNotWritable(VitacError):
    """Pictures cannot be written where they were asked for; the message names the path, the reason and what to give."""


class Format(StrEnum):
    """What a path asks for."""

    PNG = ".png"  # one picture
    GIF = ".gif"  # animated
    WEBP = ".webp"  # animated
    FOLDER = ""  # one PNG for each moment

    @property
    def is_animated(self) -> bool:
        """Whether pictures follow one another in one file."""
        return self in (Format.GIF, Format.WEBP)


@dataclass(frozen=True, kw_only=True, eq=False)
class Frame:
    """A picture to be written.

    Attributes:
        picture: RGB, shape [height, width, 3].
        name: of its file in a folder, without suffix.
        duration_ms: how long an animation shows it [ms].
    """

    picture: Picture
    name: str
    duration_ms: int = 0


@dataclass(frozen=True, kw_only=True)
class Destination:
    """A place for pictures that was looked at."""

    path: Path
    format: Format

    @classmethod
    def from_path(cls, path: Path) -> "Destination":
        """Return what the suffix names; no suffix means a folder.

        Raises:
            PicturesNotWritable: the suffix is another one, or the place is not free or cannot be written to.
        """
        try:
            kind = Format(path.suffix.lower())
        except ValueError:
            raise PicturesNotWritable(
                f"{path} ends in {path.suffix!r}; expected .png, .gif, .webp, or no suffix for a folder of pictures."
            ) from None
        destination = cls(path=path, format=kind)
        destination._try()
        return destination

    def write(self, frames: Iterable[Frame], *, end_ms: int = 0) -> list[Path]:
        """Write pictures as they come, one at a time in memory; return the files.

        Of a GIF, Pillow keeps one byte a pixel of all pictures. An old animation is replaced when the new one is
        whole.

        Args:
            frames: one for a PNG, any number for the others; of none, nothing is written.
            end_ms: minimum time for which an animation shows its last picture [ms].

        Raises:
            PicturesNotWritable: the disk is full, or the place has gone.
        """
        if self.format.is_animated:
            return self._save_animation(frames, end_ms)
        return [self._save(frame) for frame in frames]

    def _save(self, frame: Frame) -> Path:
        path = self.path / f"{frame.name}.png" if self.format is Format.FOLDER else self.path
        with self._writing():
            Image.fromarray(frame.picture).save(path, "png")  # `optimize` takes five times as long for 2 %
        return path

    def _save_animation(self, frames: Iterable[Frame], end_ms: int) -> list[Path]:
        """Collect the pictures in a file beside the animation, from which Pillow takes one after the other."""
        shown_ms = []
        with ExitStack() as stack:
            with self._writing():
                collected = stack.enter_context(TemporaryFile(dir=self.path.parent))
            pages = AppendingTiffWriter(collected, new=True)
            for frame in frames:
                shown_ms.append(frame.duration_ms)
                with self._writing():
                    self._append(frame.picture, pages)
            if not shown_ms:
                return []
            shown_ms[-1] = max(shown_ms[-1], end_ms)
            with self._writing(), Image.open(collected) as pictures, self._replacing() as new:
                # A GIF has neither quality nor method.
                pictures.save(
                    new, self.format.name, save_all=True, duration=shown_ms, loop=0, quality=_WEBP_QUALITY, method=4
                )
        return [self.path]

    @contextmanager
    def _replacing(self) -> Iterator[Path]:
        """Give the path of a file that takes the place of the old one once it is whole."""
        path = self.path.resolve()
        new = path.with_name(f".{path.name}.{os.getpid()}.new")
        try:
            yield new
            new.replace(path)
        finally:
            new.unlink(missing_ok=True)

    def _append(self, picture: Picture, pages: AppendingTiffWriter) -> None:
        image = Image.fromarray(picture)
        if self.format is Format.GIF:
            image = image.quantize(256, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
        image.save(pages, "tiff", compression="tiff_adobe_deflate")
        pages.newFrame()

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise self._refusal(error) from error

    def _try(self) -> None:
        """Write nothing, but as a writer would; a folder is made and must be empty."""
        try:
            if self.format is not Format.FOLDER:
                existed = self.path.exists()
                self.path.open("ab").close()
                if not existed:
                    self.path.unlink()
                return
            self.path.mkdir(exist_ok=True)
            occupied = next(self.path.iterdir(), None)
        except OSError as error:
            raise self._refusal(error) from error
        if occupied is not None:
            raise PicturesNotWritable(f"The folder {self.path} is not empty ({occupied.name}); name a new one.")

    def _refusal(self, error: OSError) -> PicturesNotWritable:
        reason = error.strerror or str(error)
        return PicturesNotWritable(f"Cannot write pictures to {self.path}: {reason}; name a place that can be written.")
