"""A container image that plays: its unpacked files and its own command."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from .gpu import Gpu

MOUNT_POINTS: Final = ("dev", "proc", "sys", "tmp")
"""Folders at the top of an image that the sandbox has of its own, or leaves empty."""
CHANNEL: Final = 3
"""Descriptor of the channel that the command inherits."""
CHANNEL_VARIABLE: Final = "VITAC_CHANNEL"


@dataclass(frozen=True, kw_only=True)
class ImageProgram:
    """What is run, and where.

    Attributes:
        root: folder of the unpacked files, with the folders `MOUNT_POINTS`.
        arguments: the command.
        variables: environment variables that the image sets.
        folder: working directory inside.
        gpu: that it needs, of this machine; None: it needs none.
    """

    root: Path
    arguments: tuple[str, ...]
    variables: Mapping[str, str]
    folder: str
    gpu: Gpu | None = None
