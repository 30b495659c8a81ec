"""A kernel's machine code: looked for in our cache, and compiled in turn with other processes."""

import logging
from functools import cache
from pathlib import Path
from typing import Any

from numba.core import compiler, event, sigutils, types
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import _FunctionCompiler  # type: ignore[attr-defined]
from numba.core.registry import CPUDispatcher
from numba.core.typing.templates import make_concrete_template

from ..kernel_cache import STARTED_LOG, CompileProgress, CompilingTurn, cache_directory
from .cache import KernelCache
from .indexing import indices_as_written
from .libraries import EntryLibrary, PartLibrary
from .sources import read_source

_LOG = logging.getLogger("vitac.envs.compilation")
_TURN = CompilingTurn()
_COUNTS = {"compiled": 0, "kernels": 0}


class KernelDispatcher(CPUDispatcher):
    """Numba's dispatcher, with our cache, which compiles a kernel for kernels that call it only into LLVM's IR.

    Numba makes machine code of every kernel, and within it once more of all that it calls. Here only *entries*, which
    Python calls, become machine code, together with the *parts* that they call, directly or not; these are optimised
    there for the first time. So compiling takes a third of the time. A part is compiled for the types of its arguments,
    and not once more for each constant that a caller hands over.

    What is not in the cache is compiled by one process at a time: the others wait, and find it there then. Each
    compilation is logged at the level INFO and counted where others see it (`vitac.envs.kernel_cache`).
    """

    _cache: Any

    def __init__(self, function: Any, **options: Any) -> None:
        super().__init__(function, **options)
        _COUNTS["kernels"] += 1
        read_source(Path(function.__code__.co_filename))
        self._compiler = _EntryCompiler(function, self.targetdescr, self.targetoptions, {}, compiler.Compiler)
        self.parts: dict[tuple[Any, ...], Any] = {}

    def compile(self, sig: Any) -> Any:
        """Return the entry point for argument types; compiled, loaded, or already there."""
        with global_compiler_lock:
            if not isinstance(self._cache, KernelCache):  # late, for finding the imports of a module takes time
                self._cache = KernelCache(self.py_func)
            args, _ = sigutils.normalize_signature(sig)
            if tuple(args) in self.overloads or self._cache.holds(sig, self.targetctx):
                return super().compile(sig)
            with _TURN.taken(cache_directory(), CompileProgress(**_COUNTS)):
                return super().compile(sig)

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Return what Numba has to know to call this kernel from another one: the types of a part."""
        signature, given = self._compiler.fold_argument_types(args, kws)
        folded = tuple(types.unliteral(each) for each in given)
        self._part(folded)
        known = [part.signature for part in self.parts.values()]
        name = self.py_func.__name__
        template = make_concrete_template(f"CallTemplate({name})", key=name, signatures=known)
        return template, signature, folded, {}

    def get_overload(self, sig: Any) -> Any:
        """Return the key under which Numba finds a part."""
        args, _ = sigutils.normalize_signature(sig)
        return self._part(tuple(args)).entry_point

    def _part(self, args: tuple[Any, ...]) -> Any:
        if args not in self.parts:
            self.parts[args] = self._compile_part(args)
        return self.parts[args]

    def _compile_part(self, args: tuple[Any, ...]) -> Any:
        context: Any = self.targetctx
        library = PartLibrary(context.codegen(), self.py_func.__qualname__)
        options = {"no_compile": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
        with event.trigger_event("numba:compile", data={"dispatcher": self, "args": args}):
            part = _lower(self, args, library, **options)
        key = object()
        context.insert_user_function(key, part.fndesc, [library])
        return part._replace(entry_point=key)


class _EntryCompiler(_FunctionCompiler):
    def _compile_core(self, args: Any, return_type: Any) -> Any:  # noqa: ARG002 - Numba's protocol
        library = EntryLibrary(self.targetdescr.target_context.codegen(), self.py_func.__qualname__)
        library.enable_object_caching()
        entry = _lower(self, args, library)
        for environment in entry._find_referenced_environments():
            library.codegen.set_env(environment.env_name, environment)
        return entry


def _lower(kernel: Any, args: tuple[Any, ...], library: Any, **flags: bool) -> Any:
    """Compile into a library with Numba's own stages."""
    _announce()
    chosen = compiler.Flags()
    kernel.targetdescr.options.parse_as_flags(chosen, kernel.targetoptions)
    for name, value in flags.items():
        setattr(chosen, name, value)
    with indices_as_written(kernel.py_func.__module__):
        lowered = compiler.compile_extra(
            kernel.targetdescr.typing_context,
            kernel.targetdescr.target_context,
            kernel.py_func,
            args=args,
            return_type=None,
            flags=chosen,
            locals={},
            library=library,
        )
    if lowered.typing_error is not None:
        raise lowered.typing_error
    _COUNTS["compiled"] += 1
    _TURN.tell(CompileProgress(**_COUNTS))
    _LOG.info("Compiled %s.%s", kernel.py_func.__module__, kernel.py_func.__qualname__)
    return lowered


@cache
def _announce() -> None:
    """Say once in a process why nothing happens for a while."""
    logging.getLogger(STARTED_LOG).warning(
        "Compiling the physics into %s, once for each version and kind of CPU: up to half a minute.", cache_directory()
    )
