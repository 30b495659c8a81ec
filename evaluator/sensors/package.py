"""The files of a submission that brings a sensor: which it must have, and the design document."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from vitac.envs.untrusted_file import find_spelling

from .manifest import SENSOR_NAME, SensorRejected

GEL_NAME: Final = "gel.stl"
MESH_NAME: Final = "tet.msh"
DOCUMENT_SUFFIXES: Final = (".pdf", ".md")
MAX_DOCUMENT_BYTES: Final = 20 * 1024 * 1024


@dataclass(frozen=True, kw_only=True)
class DesignDocument:
    """A design document as it was brought: never opened, only handed out.

    Attributes:
        path: where it lies.
        n_bytes: its size.
    """

    path: Path
    n_bytes: int

    @property
    def suffix(self) -> str:
        """`.pdf` or `.md`."""
        return self.path.suffix.lower()


def design_document(folder: Path) -> DesignDocument:
    """Return the one PDF or Markdown file that lies directly in a submission's folder, besides a README.

    Raises:
        SensorRejected: a file of the sensor or the document is missing, or there are several, or it is too large.
    """
    for name in (SENSOR_NAME, GEL_NAME):
        if not find_spelling(folder, name).is_file():
            raise SensorRejected(f"{name} is missing; put it beside submission.yaml.")
    documents = sorted(_documents(folder))
    if len(documents) != 1:
        names = ", ".join(path.name for path in documents[:5]) or "none"
        raise SensorRejected(
            f"Expected one design document (a .pdf or .md file beside submission.yaml, not README.md), got {names}."
        )
    n_bytes = documents[0].stat().st_size
    if not 0 < n_bytes <= MAX_DOCUMENT_BYTES:
        raise SensorRejected(
            f"The design document has {n_bytes} bytes, expected 1 to {MAX_DOCUMENT_BYTES}; make it smaller."
        )
    return DesignDocument(path=documents[0], n_bytes=n_bytes)


def _documents(folder: Path) -> Iterator[Path]:
    for path in folder.iterdir():
        is_named = path.suffix.lower() in DOCUMENT_SUFFIXES and path.stem.lower() != "readme"
        if is_named and not path.name.startswith(".") and path.is_file():
            yield path
