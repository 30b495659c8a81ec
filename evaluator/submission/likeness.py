"""How alike two archives of models are, in code and in weights; called for each model that is uploaded.

Each archive leaves a small sketch. Nothing is imported or unpickled, and what is read of an archive is bounded, so that
a hostile one costs no more than a large one.
"""

import hashlib
import io
import keyword
import re
import tokenize
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

SAME_WEIGHTS: Final = 0.98
"""Correlation from which weights were made from each other; those of two seeds of one recipe stay far below."""
SAME_CODE: Final = 0.8
"""Share of common code from which two archives without weights are alike."""
_CODE_SUFFIX: Final = ".py"
WEIGHTS_SUFFIXES = (".json", ".npy", ".npz", ".pt", ".pth", ".bin", ".safetensors", ".onnx", ".h5", ".pkl")
_PACKED = (".npz", ".pt", ".pth")
"""Files of weights that are zip archives themselves."""
_SHINGLE: Final = 10
"""Tokens that follow each other and are compared as one."""
_MINIMA: Final = 128
_FEWEST_FLOATS: Final = 16
"""Smaller files are no weights."""
_ARRAYS, _SAMPLES = 8, 512
"""Number of values by which the largest arrays are sketched."""
_CODE_BYTES, _FILE_BYTES, _PACKED_BYTES, _ALL_BYTES = 2**19, 2**26, 2**23, 2**27
"""What is read of code, of a file, of a file that is unpacked, and of an archive in all."""
_LARGEST: Final = 1e3
"""Larger numbers are no weights."""
_DECIMAL: Final = re.compile(rb"-?\d+\.\d+")
_NOTHING: Final = 2**64 - 1
_FACTORS, _SUMMANDS = np.random.default_rng(0).integers(1, 2**63, (2, _MINIMA), dtype=np.uint64)


@dataclass(frozen=True, kw_only=True, eq=False)
class ArchiveSketch:
    """What two archives are compared by.

    Attributes:
        code: smallest of the hashes of runs of tokens under each of 128 hash functions, shape [128].
        sizes: how many numbers each of the largest arrays has, the largest first, shape [n].
        samples: some of the numbers of each, shape [n, 512].
    """

    code: NDArray[np.uint64]
    sizes: NDArray[np.int64]
    samples: NDArray[np.float16]

    def to_bytes(self) -> bytes:
        """Return it as it is stored."""
        return self.code.tobytes() + self.sizes.tobytes() + self.samples.tobytes()

    @classmethod
    def from_bytes(cls, content: bytes) -> Self:
        """Read what `to_bytes` wrote."""
        code_bytes = 8 * _MINIMA
        count = (len(content) - code_bytes) // (8 + 2 * _SAMPLES)
        samples_at = code_bytes + 8 * count
        return cls(
            code=np.frombuffer(content[:code_bytes], np.uint64),
            sizes=np.frombuffer(content[code_bytes:samples_at], np.int64),
            samples=np.frombuffer(content[samples_at:], np.float16).reshape(count, _SAMPLES),
        )


@dataclass(frozen=True, kw_only=True)
class ArchiveLikeness:
    """How alike two archives are.

    Attributes:
        code: share of the runs of tokens of both that are in both, to about 5 %, whatever their names; None without
            code.
        weights: correlation of arrays of the same size; None without weights, 0 where less than half are of one size.
    """

    code: float | None
    weights: float | None

    @property
    def is_copy(self) -> bool:
        """Whether one was made from the other: by its weights, and without any by its code."""
        if self.weights is not None:
            return self.weights >= SAME_WEIGHTS
        return self.code is not None and self.code >= SAME_CODE


def make_sketch(folder: Path) -> ArchiveSketch:
    """Return the sketch of an unpacked archive."""
    code = np.full(_MINIMA, _NOTHING, np.uint64)
    arrays: list[NDArray[np.float32]] = []
    code_left, left = _CODE_BYTES, _ALL_BYTES
    for path in sorted(each for each in folder.rglob("*") if each.is_file() and not each.is_symlink()):
        is_code = path.suffix == _CODE_SUFFIX
        if is_code or path.suffix in WEIGHTS_SUFFIXES:
            with path.open("rb") as file:
                content = file.read(min(code_left if is_code else _FILE_BYTES, left))
            left -= len(content)
            if is_code:
                code_left -= len(content)
                code = np.minimum(code, _minima(content))
            else:
                arrays = _largest([*arrays, *_arrays(path.name, content)])
    return ArchiveSketch(
        code=code,
        sizes=np.array([array.size for array in arrays], np.int64),
        samples=np.array([_sample(array) for array in arrays], np.float16).reshape(-1, _SAMPLES),
    )


def compare_sketches(first: ArchiveSketch, second: ArchiveSketch) -> ArchiveLikeness:
    """Return how alike two archives are."""
    has_code = (first.code != _NOTHING).any() and (second.code != _NOTHING).any()
    code = float((first.code == second.code).mean()) if has_code else None
    if not first.sizes.size and not second.sizes.size:
        return ArchiveLikeness(code=code, weights=None)
    pairs = [
        (int(size), _correlation(ours, theirs))
        for size, ours in zip(first.sizes, first.samples, strict=True)
        for theirs in second.samples[second.sizes == size]
    ]
    best: dict[int, float] = {}
    for size, correlation in pairs:
        best[size] = max(correlation, best.get(size, -1.0))
    common, larger = sum(best), max(first.sizes.sum(), second.sizes.sum())
    if 2 * common < larger:
        return ArchiveLikeness(code=code, weights=0.0)
    return ArchiveLikeness(code=code, weights=sum(size * likeness for size, likeness in best.items()) / common)


def _minima(content: bytes) -> NDArray[np.uint64]:
    """Return the minima of a Python file's runs of tokens, without comments, layout, text and names of its own.

    Names after a dot stay: they are mostly those of libraries.
    """
    tokens: list[str] = []
    try:
        for token in tokenize.tokenize(io.BytesIO(content).readline):
            if token.type == tokenize.NAME:
                is_own = not keyword.iskeyword(token.string) and tokens[-1:] != ["."]
                tokens.append("name" if is_own else token.string)
            elif token.type in {tokenize.OP, tokenize.NUMBER}:
                tokens.append(token.string)
    except (SyntaxError, tokenize.TokenError, UnicodeDecodeError):
        pass  # what was read until there is compared
    runs = {" ".join(tokens[at : at + _SHINGLE]) for at in range(len(tokens) - _SHINGLE + 1)}
    minima = np.full(_MINIMA, _NOTHING, np.uint64)
    for run in runs:
        hashed = np.uint64(int.from_bytes(hashlib.blake2b(run.encode(), digest_size=8).digest(), "little"))
        minima = np.minimum(minima, hashed * _FACTORS + _SUMMANDS)
    return minima


def _arrays(name: str, content: bytes) -> Iterator[NDArray[np.float32]]:
    """Yield the numbers of a file, or of each file in it."""
    if name.endswith(_PACKED) and len(content) <= _PACKED_BYTES and zipfile.is_zipfile(io.BytesIO(content)):
        left = _FILE_BYTES
        try:
            with zipfile.ZipFile(io.BytesIO(content)) as opened:
                for info in opened.infolist()[: 8 * _ARRAYS]:
                    with opened.open(info) as file:
                        inner = file.read(left)
                    left -= len(inner)
                    yield _numbers(info.filename, inner)
        except (zipfile.BadZipFile, OSError, ValueError, RuntimeError, NotImplementedError, EOFError, zlib.error):
            return
    else:
        yield _numbers(name, content)


def _numbers(name: str, content: bytes) -> NDArray[np.float32]:
    """Return the numbers of a file: those of JSON; else floats from the end on.

    A header may have any length, and weights come last.
    """
    if name.endswith(".json"):
        numbers = np.array([float(number) for number in _DECIMAL.findall(content)], np.float32)
    else:
        data, kind = _strip_header(content)
        with np.errstate(over="ignore", invalid="ignore"):
            numbers = np.frombuffer(data[len(data) % int(kind[-1]) :], kind).astype(np.float32)
    with np.errstate(invalid="ignore"):
        return np.where(np.isfinite(numbers) & (np.abs(numbers) < _LARGEST), numbers, np.float32(0))


def _strip_header(content: bytes) -> tuple[bytes, str]:
    """Return the numbers of an array in NumPy's format and their type; of anything else all, as 32-bit floats."""
    if not content.startswith(np.lib.format.MAGIC_PREFIX) or len(content) < 12:
        return content, "<f4"
    first, size = (10, 2) if content[6] == 1 else (12, 4)
    end = first + int.from_bytes(content[8 : 8 + size], "little")
    kind = next((kind for kind in (b"<f8", b"<f2") if kind in content[:end]), b"<f4").decode()
    return content[end:], kind


def _largest(arrays: list[NDArray[np.float32]]) -> list[NDArray[np.float32]]:
    large = [array for array in arrays if array.size >= _FEWEST_FLOATS]
    return sorted(large, key=lambda array: array.size, reverse=True)[:_ARRAYS]


def _sample(array: NDArray[np.float32]) -> NDArray[np.float16]:
    at = np.linspace(0, array.size - 1, _SAMPLES).astype(int)
    return np.asarray(array[at], np.float16)


def _correlation(first: NDArray[np.float16], second: NDArray[np.float16]) -> float:
    ours, theirs = first.astype(float), second.astype(float)
    size = float(np.linalg.norm(ours) * np.linalg.norm(theirs))
    return float(ours @ theirs) / size if size else 0.0
