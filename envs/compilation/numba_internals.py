"""How our kernels use Numba beyond its public options: in turn, in parts, cached by content, indices as written.

All that rests on Numba's private classes is here. It saves time only: of versions that it does not fit, `kernel` takes
Numba's own dispatcher, with the same bits.
"""

import logging
import os
import pickle
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from inspect import signature
from pathlib import Path
from typing import Any

from llvmlite import binding  # type: ignore[import-untyped]
from numba.core import compiler, event, sigutils, types
from numba.core.caching import CompileResultCacheImpl, FunctionCache, _CacheLocator
from numba.core.codegen import CPUCodeLibrary, JITCodeLibrary
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import _FunctionCompiler  # type: ignore[attr-defined]
from numba.core.registry import CPUDispatcher
from numba.core.typing.templates import make_concrete_template
from numba.np import arrayobj

from ..kernel_cache import STARTED_LOG, CompileProgress, CompilingTurn, cache_directory, note_use, remove_unused
from ..signals import signals_act
from .sources import read_source, source_digest

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
            overload = super().load_overload(sig, target_context)
        except _UNREADABLE as error:
            _LOG.warning("Compiled kernels in %s cannot be read (%s); compiling again.", self.cache_path, error)
            return None
        if overload is not None:
            note_use(Path(self.cache_path))
        return overload

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


class PartLibrary(CPUCodeLibrary):
    """The IR of one kernel alone, to be linked into entries; it never becomes machine code by itself."""

    def finalize(self) -> None:
        """Leave it as it is: nothing is linked, optimised or made executable."""
        self._finalized = True


class EntryLibrary(JITCodeLibrary):
    """A kernel that Python calls, with everything it calls: linked, optimised and compiled together."""

    def finalize(self) -> None:
        """Link all parts, then do what Numba does."""
        self._linking_libraries = _callers_first(self._linking_libraries)
        super().finalize()

    def serialize_using_object_code(self) -> tuple[str, str, tuple[bytes, bytes]]:
        """Return what the cache stores: machine code, and the names of its functions.

        Numba stores the IR, too, for others to link. None links an entry, and to read it takes 50 ms of all entries.
        """
        self._ensure_finalized()
        return self.name, "object", (self._get_compiled_object(), _empty_functions(self._final_module))


def _empty_functions(module: Any) -> bytes:
    """Return the bitcode of a module with the same functions that do nothing."""
    names = [function.name for function in module.functions if not function.is_declaration]
    lines = [f'define void @"{name}"() {{ ret void }}' for name in names]
    bitcode: bytes = binding.parse_assembly("\n".join(lines)).as_bitcode()
    return bitcode


def _callers_first(libraries: list[Any]) -> list[Any]:
    """Return libraries and the parts that they call, each once, callers first, for LLVM links only what is called."""
    callers: dict[Any, None] = {}

    def visit(library: Any) -> None:
        if library not in callers and isinstance(library, PartLibrary):
            for called in library._linking_libraries:
                visit(called)
        callers.setdefault(library)

    for library in libraries:
        visit(library)
    return list(callers)[::-1]


_PHYSICS = "vitac.envs.fem."
_PARAMETERS = ["context", "builder", "idxty", "idx", "size"]


@contextmanager
def indices_as_written(module: str, compiler: Any = arrayobj) -> Iterator[None]:
    """Let Numba compile a kernel of the physics without asking of each index whether it is negative.

    While a kernel is compiled, those that it calls are, each by the rule of its own module. A version of Numba that
    does this elsewhere is left alone: kernels have the same bits then, and take 1.1 times as long.

    Args:
        module: of the kernel.
        compiler: Numba's module that has the function for it.
    """
    before = getattr(compiler, "fix_integer_index", None)
    if before is None or list(signature(before).parameters) != _PARAMETERS:
        yield
        return
    compiler.fix_integer_index = _take_index if module.startswith(_PHYSICS) else _fix_index
    try:
        yield
    finally:
        compiler.fix_integer_index = before


def _take_index(context: Any, builder: Any, idxty: Any, idx: Any, size: Any) -> Any:  # noqa: ARG001 - Numba's
    return context.cast(builder, idx, idxty, types.intp)


_fix_index = getattr(arrayobj, "fix_integer_index", None)


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
            with signals_act(), _TURN.taken(cache_directory(), CompileProgress(**_COUNTS)):
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
        "Compiling the physics into %s, once for each version, Python and kind of CPU: half a minute or more.",
        cache_directory(),
    )
