"""Where pictures go: one PNG, an animated GIF or WebP, or a folder of PNGs. Looked at before anything is simulated."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..errors import VitacError

Picture = NDArray[np.uint8]

_WEBP_QUALITY = 88


class PicturesNotWritable(VitacError):
    """Pictures cannot be written where they were asked for; the message names the path, the reason and what to give."""


class Kind(StrEnum):
    """What a path asks for."""

    PNG = ".png"  # one picture
    GIF = ".gif"  # animated
    WEBP = ".webp"  # animated
    FOLDER = ""  # one PNG for each moment

    @property
    def is_animated(self) -> bool:
        """Whether pictures follow one another in one file."""
        return self in (Kind.GIF, Kind.WEBP)


@dataclass(frozen=True, kw_only=True)
class Destination:
    """A place for pictures that was looked at."""

    path: Path
    kind: Kind

    @classmethod
    def at(cls, path: Path) -> "Destination":
        """Return the kind that the suffix names; no suffix means a folder.

        Raises:
            PicturesNotWritable: the suffix is of another kind, or the place is not free or cannot be written to.
        """
        try:
            kind = Kind(path.suffix.lower())
        except ValueError:
            raise PicturesNotWritable(
                f"{path} ends in {path.suffix!r}; expected .png, .gif, .webp, or no suffix for a folder of pictures."
            ) from None
        destination = cls(path=path, kind=kind)
        destination._try()
        return destination

    def write(self, pictures: Sequence[Picture], *, names: Sequence[str], durations_ms: Sequence[int]) -> list[Path]:
        """Write the pictures, RGB of shape [height, width, 3]; the files that were written.

        Args:
            pictures: one for a PNG, at least one for the others.
            names: of the files in a folder, without suffix.
            durations_ms: how long each picture of an animation is shown [ms].

        Raises:
            PicturesNotWritable: the disk is full, or the place has gone.
        """
        images = [Image.fromarray(picture) for picture in pictures]
        try:
            if self.kind is Kind.FOLDER:
                return [self._save_in_folder(image, name) for image, name in zip(images, names, strict=True)]
            if self.kind is Kind.PNG:
                images[0].save(self.path, "png", optimize=True)
            else:
                self._save_animation(images, durations_ms)
        except OSError as error:
            raise self._refusal(error) from error
        return [self.path]

    def _save_in_folder(self, image: Image.Image, name: str) -> Path:
        path = self.path / f"{name}.png"
        image.save(path, optimize=True)
        return path

    def _save_animation(self, images: list[Image.Image], durations_ms: Sequence[int]) -> None:
        shown_ms = list(durations_ms)
        if self.kind is Kind.GIF:
            first, *others = [
                image.quantize(256, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE) for image in images
            ]
            first.save(self.path, save_all=True, append_images=others, duration=shown_ms, loop=0)
        else:
            first, *others = images
            first.save(
                self.path,
                save_all=True,
                append_images=others,
                duration=shown_ms,
                loop=0,
                quality=_WEBP_QUALITY,
                method=4,
            )

    def _try(self) -> None:
        """Write nothing, but as a writer would; a folder is made and must be empty."""
        try:
            if self.kind is not Kind.FOLDER:
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
