"""The program that makes a sensor of a team's files inside the sandbox; started by `submission.sensor`.

Run as `python -m vitac.evaluator.sensors.making FOLDER KERNELS`. It writes one JSON line: the made sensor, or why it is
refused.
"""

import os
import sys
from pathlib import Path

from vitac.errors import VitacError

from ..strict_model import StrictModel
from .made import MadeSensor, made_sensor


class MakingAnswer(StrictModel):
    """What comes of a team's files: exactly one of the fields."""

    made: MadeSensor | None = None
    refused: str | None = None


def make_answer(folder: Path) -> MakingAnswer:
    """Check and mesh the sensor in a folder."""
    from .check import accepted_sensor

    try:
        return MakingAnswer(made=made_sensor(accepted_sensor(folder)))
    except VitacError as error:
        return MakingAnswer(refused=str(error))


def use_kernels(kept: Path) -> None:
    """Let compiled kernels be found that can only be read here; new ones stay in this process's own folder."""
    own = Path(os.environ["VITAC_CACHE_DIR"]) / "kernels"
    own.mkdir(parents=True, exist_ok=True)
    for folder in kept.iterdir() if kept.is_dir() else ():
        if not (own / folder.name).exists():
            (own / folder.name).symlink_to(folder)


def main() -> None:
    """Answer on standard output."""
    folder, kernels = map(Path, sys.argv[1:])
    use_kernels(kernels)
    sys.stdout.write(make_answer(folder).model_dump_json(exclude_none=True) + "\n")


if __name__ == "__main__":
    main()
