"""How alike two archives of models are, in code and in weights; called for organizers who look at near copies.

Nothing is imported or unpickled.
"""

import io
import re
import tokenize
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Final

import numpy as np
from numpy.typing import NDArray

_CODE_SUFFIX: Final = ".py"
_PACKED = (".npz", ".pt", ".pth", ".zip")
"""Files of weights that are archives themselves."""
_SHINGLE: Final = 6
"""Tokens that follow each other and are compared as one."""
_FEWEST_FLOATS: Final = 256
"""Smaller files are no weights."""
_MOST_BYTES: Final = 64 * 2**20
"""Number of bytes that are read of a file."""
_LARGEST: Final = 1e3
"""Larger numbers are no weights."""
_DECIMAL: Final = re.compile(rb"-?\d+\.\d+")


@dataclass(frozen=True, kw_only=True)
class ArchiveSketch:
    """What two archives are compared by.

    Attributes:
        shingles: hashes of runs of tokens of the code.
        weights: numbers in each large file, by its name and how many there are.
    """

    shingles: frozenset[int]
    weights: dict[tuple[str, int], NDArray[np.float32]]


@dataclass(frozen=True, kw_only=True)
class ArchiveLikeness:
    """How alike two archives are.

    Attributes:
        code: share of the runs of tokens of both that are in both; None without code.
        weights: correlation of the numbers in files of the same name and size; None without such files.
    """

    code: float | None
    weights: float | None


def make_sketch(archive: Path) -> ArchiveSketch:
    """Return what an archive is compared by."""
    shingles: set[int] = set()
    weights: dict[tuple[str, int], NDArray[np.float32]] = {}
    with zipfile.ZipFile(archive) as opened:
        for name, content in _files(opened):
            if name.endswith(_CODE_SUFFIX):
                shingles |= _shingles(content)
            elif (numbers := _numbers(name, content)).size >= _FEWEST_FLOATS:
                weights[name, numbers.size] = numbers
    return ArchiveSketch(shingles=frozenset(shingles), weights=weights)


def compare_sketches(first: ArchiveSketch, second: ArchiveSketch) -> ArchiveLikeness:
    """Return how alike two archives are."""
    union = first.shingles | second.shingles
    code = len(first.shingles & second.shingles) / len(union) if union else None
    common = sorted(first.weights.keys() & second.weights.keys())
    if not common:
        return ArchiveLikeness(code=code, weights=None)
    ours, theirs = (np.concatenate([sketch.weights[key] for key in common]) for sketch in (first, second))
    return ArchiveLikeness(code=code, weights=_correlation(ours, theirs))


def _files(opened: zipfile.ZipFile) -> Iterator[tuple[str, bytes]]:
    """Yield the files of an archive, and those of archives in it, by their names without folders."""
    for info in opened.infolist():
        if info.is_dir():
            continue
        name = info.filename.rpartition("/")[2]
        with opened.open(info) as file:
            content = file.read(_MOST_BYTES)
        if name.endswith(_PACKED) and zipfile.is_zipfile(io.BytesIO(content)):
            with zipfile.ZipFile(io.BytesIO(content)) as inner:
                yield from ((f"{name}/{part}", found) for part, found in _read_flat(inner))
        else:
            yield name, content


def _read_flat(opened: zipfile.ZipFile) -> Iterator[tuple[str, bytes]]:
    for info in opened.infolist():
        file: IO[bytes]
        with opened.open(info) as file:
            yield info.filename.partition("/")[2] or info.filename, file.read(_MOST_BYTES)


def _shingles(content: bytes) -> set[int]:
    """Return hashes of the runs of tokens of a Python file, without comments, layout and text that is no code."""
    names = []
    try:
        for token in tokenize.tokenize(io.BytesIO(content).readline):
            if token.type in {tokenize.NAME, tokenize.OP, tokenize.NUMBER}:
                names.append(token.string)
    except (SyntaxError, tokenize.TokenError, UnicodeDecodeError):
        pass  # what was read until there is compared
    return {hash(tuple(names[at : at + _SHINGLE])) for at in range(len(names) - _SHINGLE + 1)}


def _numbers(name: str, content: bytes) -> NDArray[np.float32]:
    """Return the numbers of a file: those of an array or of JSON; else 32-bit floats from the end on.

    A header may have any length, and weights come last.
    """
    if name.endswith(".json"):
        numbers = np.array([float(number) for number in _DECIMAL.findall(content)], np.float32)
    elif (array := _array(content)) is not None:
        numbers = array
    else:
        numbers = np.frombuffer(content[len(content) % 4 :], "<f4").astype(np.float32)
    with np.errstate(invalid="ignore"):
        return np.where(np.isfinite(numbers) & (np.abs(numbers) < _LARGEST), numbers, np.float32(0))


def _array(content: bytes) -> NDArray[np.float32] | None:
    """Return an array of NumPy's format; None where it is none, or one of objects, which would be unpickled."""
    if not content.startswith(np.lib.format.MAGIC_PREFIX):
        return None
    try:
        found = np.load(io.BytesIO(content), allow_pickle=False)
        return found.astype(np.float32).ravel() if found.dtype.kind in "fiu" else None
    except (ValueError, OSError, EOFError):
        return None


def _correlation(first: NDArray[np.float32], second: NDArray[np.float32]) -> float:
    ours, theirs = first.astype(float), second.astype(float)
    size = float(np.linalg.norm(ours) * np.linalg.norm(theirs))
    return float(ours @ theirs) / size if size else 0.0
