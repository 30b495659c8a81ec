"""How every numerical kernel is compiled: Numba, float64, no reassociation, cached on disk by content."""

import logging
from collections.abc import Callable
from functools import cache
from typing import Any, ParamSpec, TypeVar, cast

import numba
from vitac.errors import require_compilation

TRIED = ("0.68",)
"""Versions of Numba whose private classes `numba_internals` fits."""

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
    """
    require_compilation()
    options: dict[str, Any] = {
        "nopython": True,
        "boundscheck": None,
        "fastmath": False,
        "error_model": "numpy",
        "nogil": True,
    }
    dispatcher = _find_dispatcher()
    if dispatcher is None:
        return cast("Callable[Parameters, Result]", numba.jit(**options)(function))
    return dispatcher(function, targetoptions={**options, "forceinline": inlined, "_nrt": counts_references})  # type: ignore[no-any-return]


@cache
def _find_dispatcher() -> Any:
    """Return our dispatcher, which saves time, where it was tried with this version of Numba; None elsewhere."""
    if numba.__version__.rpartition(".")[0] not in TRIED:
        logging.getLogger("vitac.envs.compilation").warning(
            "Numba %s is not one of %s: every process compiles the physics for itself, which takes long, with the same "
            "numbers.",
            numba.__version__,
            ", ".join(TRIED),
        )
        return None
    from .numba_internals import KernelDispatcher

    return KernelDispatcher
