"""Combines the two single-task examples: `python examples/track_1_heuristic/compose.py NEW_FOLDER`."""

import sys
from pathlib import Path
from shutil import copy, copytree, ignore_patterns

HERE = Path(__file__).resolve().parent
TASKS = ("peg_insertion", "lock_opening")


def compose(folder: Path) -> None:
    """Write the submission to a new folder: policy.py and submission.yaml of this example, and a folder per task."""
    top = folder / "Track_1"
    for task in TASKS:
        source = HERE.parent / f"{task}_heuristic" / "Track_1"
        copytree(source, top / task, ignore=ignore_patterns("submission.yaml", "__pycache__"))
    for name in ("policy.py", "submission.yaml"):
        copy(HERE / name, top)


if __name__ == "__main__":
    compose(Path(sys.argv[1]))
