"""Machine code on disk, found by what it was compiled from: a folder for each module and digest of its sources."""

import logging
import os
import pickle
from functools import cache
from pathlib import Path
from typing import Any

from numba.core.caching import CompileResultCacheImpl, FunctionCache, _CacheLocator

from ..kernel_cache import cache_directory, note_use, remove_unused
from .sources import source_digest

_LOG = logging.getLogger("vitac.envs.compilation")


class _SourceLocator(_CacheLocator):
    """Tells Numba the folder of a kernel's module, which no path and no time enters."""

    def __init__(self, function: Any, file: str) -> None:
        self._py_file = file
        self._line = function.__code__.co_firstlineno
        self._digest = source_digest(Path(file))
        self._folder = cache_directory() / f"{function.__module__}-{self._digest[:16]}"

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> "_SourceLocator":
        return cls(py_func, py_file)

    def get_cache_path(self) -> str:
        return str(self._folder)

    def ensure_cache_path(self) -> None:
        """Make the folder, which Numba asks for before it reads, where the one above it can be written to."""
        if os.access(cache_directory(), os.W_OK):
            super().ensure_cache_path()

    def get_source_stamp(self) -> str:
        return self._digest

    def get_disambiguator(self) -> str:
        return str(self._line)


class _KernelCacheFiles(CompileResultCacheImpl):
    _locator_classes: list[type[object]] = [_SourceLocator]  # noqa: RUF012 - as Numba declares it


class KernelCache(FunctionCache):
    """Stores the machine code of one kernel, for all argument types and CPUs that it was compiled for.

    Numba writes every file under another name and renames it. A file that cannot be read back is compiled again.
    """

    _impl_class = _KernelCacheFiles

    def holds(self, signature: Any, target_context: Any) -> bool:
        """Return whether machine code is stored for these argument types and this CPU."""
        try:
            key = self._index_key(signature, target_context.codegen())
            return key in self._cache_file._load_index()
        except _UNREADABLE:
            return False

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load machine code; None if there is none."""
        try:
            found = super().load_overload(sig, target_context)
        except _UNREADABLE as error:
            _LOG.warning("Compiled kernels in %s cannot be read (%s); compiling again.", self.cache_path, error)
            return None
        if found is not None:
            note_use(Path(self.cache_path))
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep machine code, and remove what is no longer used; a disk that does not take it is no error."""
        try:
            super().save_overload(sig, data)
            remove_unused(Path(self.cache_path).parent)
        except OSError as error:
            _warn_not_stored(Path(self.cache_path).parent, str(error))


@cache
def _warn_not_stored(directory: Path, reason: str) -> None:
    """Say it once for each reason, not for every kernel."""
    _LOG.warning("Compiled kernels cannot be stored in %s (%s); continuing without.", directory, reason)


# What reading a file raises that was cut off, is no pickle, or belongs to another user.
_UNREADABLE = (OSError, EOFError, pickle.UnpicklingError, ValueError, AttributeError, ImportError, IndexError)
