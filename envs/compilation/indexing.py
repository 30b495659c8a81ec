"""Array indices of the physics' kernels are taken as written: none of them counts from the back."""

from collections.abc import Iterator
from contextlib import contextmanager
from inspect import signature
from typing import Any

from numba.core import types
from numba.np import arrayobj

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
