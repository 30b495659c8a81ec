"""What Numba collects LLVM's IR in: of a kernel that Python calls, and of one that other kernels call."""

from typing import Any

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
