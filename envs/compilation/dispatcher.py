"""A compiled function that looks for its machine code in our cache, and compiles in turn with other processes."""

import logging
from typing import Any

from numba.core import sigutils
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher

from .cache import KernelCache
from .folders import cache_directory
from .turns import CompilingTurn

_LOG = logging.getLogger("vitac.envs.compilation")
_TURN = CompilingTurn()


class KernelDispatcher(CPUDispatcher):
    """Numba's dispatcher with a `KernelCache`.

    What is not in the cache is compiled by one process at a time: the others wait, and find it there then. Every
    compilation is logged at the level INFO, so that a program which warms up can show how far it is.
    """

    def __init__(self, function: Any, **options: Any) -> None:
        super().__init__(function, **options)
        self._cache = KernelCache(function)  # type: ignore[no-untyped-call]

    def compile(self, sig: Any) -> Any:
        """Return the entry point for argument types; compiled, loaded, or already there."""
        with global_compiler_lock:
            types, _ = sigutils.normalize_signature(sig)  # type: ignore[no-untyped-call]
            if tuple(types) in self.overloads or self._cache.holds(sig, self.targetctx):
                return super().compile(sig)
            with _TURN.taken(cache_directory()):
                entry_point = super().compile(sig)
            _LOG.info("Compiled %s.%s", self.py_func.__module__, self.py_func.__qualname__)
            return entry_point
