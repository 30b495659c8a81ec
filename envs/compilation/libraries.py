"""What Numba collects LLVM's IR in: of a kernel that Python calls, and of one that other kernels call."""

from typing import Any

from llvmlite import binding  # type: ignore[import-untyped]
from numba.core.codegen import CPUCodeLibrary, JITCodeLibrary


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
    found: dict[Any, None] = {}

    def visit(library: Any) -> None:
        if library not in found and isinstance(library, PartLibrary):
            for called in library._linking_libraries:
                visit(called)
        found.setdefault(library)

    for library in libraries:
        visit(library)
    return list(found)[::-1]
