"""Array indices of the physics' kernels are taken as written: none of them counts from the back."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from numba.core import types
from numba.np import arrayobj

_PHYSICS = "vitac.envs.fem."
_fix_index = arrayobj.fix_integer_index


@contextmanager
def indices_as_written(module: str) -> Iterator[None]:
    """Let Numba compile a kernel of the physics without asking of each index whether it is negative.

    While a kernel is compiled, those that it calls are, each by the rule of its own module.
    """
    before = arrayobj.fix_integer_index
    arrayobj.fix_integer_index = _take_index if module.startswith(_PHYSICS) else _fix_index
    try:
        yield
    finally:
        arrayobj.fix_integer_index = before


def _take_index(context: Any, builder: Any, index_type: Any, index: Any, size: Any) -> Any:  # noqa: ARG001 - Numba's
    return context.cast(builder, index, index_type, types.intp)
