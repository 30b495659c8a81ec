"""Where the gripper holds a part, in a file that a killed process leaves behind."""

from pathlib import Path

import yaml
from vitac.errors import VitacError
from vitac.evaluator.strict_model import StrictModel, read_yaml

Beside = tuple[float, float]


class NotRemembered(VitacError):
    """The place cannot be written; make the folder of the station's file writable."""


class _Place(StrictModel):
    """From the middle of the part, along the stage's x and z."""

    x_mm: float
    z_mm: float


class HeldPart:
    """Remembers how far beside its middle the gripper has closed on a part.

    Attributes:
        beside_mm: along the stage's x and z from the garage.
    """

    def __init__(self, file: Path | None = None) -> None:
        """Read what an earlier process has written; without a file it is forgotten with the process.

        Raises:
            DocumentRejected: the file was changed by somebody.
        """
        self._file = file
        place = read_yaml(_Place, file) if file and file.exists() else _Place(x_mm=0.0, z_mm=0.0)
        self.beside_mm: Beside = (place.x_mm, place.z_mm)

    @classmethod
    def of_station(cls, description: Path) -> "HeldPart":
        """Return that of the station of a file, beside which it is written."""
        return cls(description.with_suffix(".held.yaml"))

    def remember(self, beside_mm: Beside) -> None:
        """Write it before the gripper closes: nothing is held while both differ.

        Raises:
            NotRemembered: the file cannot be written.
        """
        if self._file is not None and beside_mm != self.beside_mm:
            place = dict(zip(_Place.model_fields, beside_mm, strict=True))
            whole = self._file.with_suffix(".new")
            try:
                whole.write_text(yaml.safe_dump(place), encoding="utf-8")
                whole.replace(self._file)
            except OSError as error:
                raise NotRemembered(
                    f"{self._file} cannot be written ({error.strerror}): a killed agent would not know where the key "
                    "is held. Make its folder writable."
                ) from error
        self.beside_mm = beside_mm
