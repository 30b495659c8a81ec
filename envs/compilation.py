"""How every numerical kernel is compiled: Numba, float64, no reassociation, cached on disk per version of sources."""

import hashlib
import os
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import ParamSpec, TypeVar

import numba

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")


def kernel(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Compile a function that makes and returns no array, and calls only such functions; it is inlined into callers.

    Numba counts the references to every array, slice and tuple of arrays that a function handles, with atomic
    operations, and hands an array over as seven numbers; both together took a third of an IPC step. What makes no
    array needs no counting, and what is inlined hands nothing over.
    """
    return _compiled(function, counts_references=False, inlined=True)


def large_kernel(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Compile the same, but to be called: for what would take long to compile once more in every caller."""
    return _compiled(function, counts_references=False, inlined=False)


def allocating_kernel(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Compile a function that makes or returns arrays, or calls one that does."""
    return _compiled(function, counts_references=True, inlined=False)


def _compiled(
    function: Callable[Parameters, Result], *, counts_references: bool, inlined: bool
) -> Callable[Parameters, Result]:
    """Compile with the options that keep a function's bits equal on every CPU.

    `fastmath=False` forbids reordering and fused multiply-add, so a generic and a native build agree; no threads.
    Machine code is cached under `cache_directory()`: Numba notices only changes of the file that holds a kernel, not
    of the kernels it calls or of these options, so the directory's name carries the digest of all our modules.
    """
    previous = numba.config.CACHE_DIR  # type: ignore[attr-defined]
    numba.config.CACHE_DIR = str(cache_directory())  # type: ignore[attr-defined]
    try:
        compiled: Callable[Parameters, Result] = numba.njit(
            cache=True,
            fastmath=False,
            error_model="numpy",
            nogil=True,
            forceinline=inlined,
            _nrt=counts_references,  # type: ignore[call-overload]
        )(function)
    finally:
        numba.config.CACHE_DIR = previous  # type: ignore[attr-defined]
    return compiled


@cache
def cache_directory() -> Path:
    """Folder of compiled kernels: `VITAC_CACHE_DIR`, else the user's cache folder, else a private temporary one."""
    name = f"kernels-{source_digest(Path(__file__).parent)[:16]}"
    for root in _candidate_roots():
        directory = root / name
        try:
            directory.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(directory, os.W_OK):
            return directory
    return Path(tempfile.mkdtemp(prefix="vitac-")) / name


def source_digest(folder: Path) -> str:
    """SHA-256 [hex] of all modules below a folder, in order of their paths.

    All, not only those with kernels: kernels also freeze constants and field orders of the others.
    """
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        digest.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def _candidate_roots() -> list[Path]:
    if explicit := os.environ.get("VITAC_CACHE_DIR"):
        return [Path(explicit)]
    home_cache = os.environ.get("XDG_CACHE_HOME")
    return [(Path(home_cache) if home_cache else Path.home() / ".cache") / "vitac"]
