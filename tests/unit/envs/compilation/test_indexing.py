from types import SimpleNamespace
from typing import Any

import pytest
from numba.np import arrayobj
from vitac.envs.compilation.indexing import indices_as_written

PHYSICS, MARKERS = "vitac.envs.fem.contact.ccd", "vitac.envs.tactile.markers"


def moved(context: Any, builder: Any, index: Any) -> Any:
    return context, builder, index


def test_only_the_physics_takes_indices_as_written_also_where_one_kernel_calls_another() -> None:
    numbas_own = arrayobj.fix_integer_index
    with indices_as_written(PHYSICS):
        assert arrayobj.fix_integer_index is not numbas_own
        with indices_as_written(MARKERS):
            assert arrayobj.fix_integer_index is numbas_own
        assert arrayobj.fix_integer_index is not numbas_own
    assert arrayobj.fix_integer_index is numbas_own


@pytest.mark.parametrize("compiler", [SimpleNamespace(), SimpleNamespace(fix_integer_index=moved)])
def test_a_numba_that_fixes_indices_otherwise_is_left_alone(compiler: SimpleNamespace) -> None:
    before = {**vars(compiler)}
    with indices_as_written(PHYSICS, compiler):
        assert vars(compiler) == before
