"""What is in a model's archive, for its model card; nothing of it is imported. Called by `models`."""

import re
from pathlib import Path
from typing import Final

from vitac.evaluator.submission.likeness import WEIGHTS_SUFFIXES

from ..views.submissions import ArchiveContents

FRAMEWORKS: Final = ("torch", "tensorflow", "jax", "onnxruntime", "sklearn", "scipy", "cv2", "numpy")
"""Modules whose import says with what a policy computes."""
_IMPORT: Final = re.compile(rb"^[ \t]*(?:from|import)[ \t]+([^\n#]+)", re.MULTILINE)
_CODE_BYTES: Final = 2**19
"""Size of a file of code up to which it is looked at."""


def read_contents(folder: Path) -> ArchiveContents:
    """Return what an unpacked archive holds."""
    files = [path for path in folder.rglob("*") if path.is_file() and not path.is_symlink()]
    code = [path for path in files if path.suffix == ".py"]
    imported = {name for path in code for name in _find_imports(path)}
    return ArchiveContents(
        frameworks=[name for name in FRAMEWORKS if name in imported],
        code_bytes=sum(path.stat().st_size for path in code),
        weights_bytes=sum(path.stat().st_size for path in files if path.suffix in WEIGHTS_SUFFIXES),
    )


def _find_imports(path: Path) -> set[str]:
    with path.open("rb") as file:
        lines = _IMPORT.findall(file.read(_CODE_BYTES))
    return {name for line in lines for name in re.findall(r"\w+", line.decode("utf-8", errors="replace"))}
