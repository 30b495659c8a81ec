"""Kernels without reference counts neither make nor return arrays: one that did would leak or use freed memory."""

import importlib
import subprocess
import sys
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

import numba
import numpy as np
import pytest
import vitac.envs
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaError
from numpy.typing import NDArray
from vitac.envs.compilation import allocating_kernel, kernel

FloatArray = NDArray[np.float64]
FOLDER = Path(vitac.envs.__file__).parent
MODULES = sorted(
    ".".join(["vitac.envs", *path.relative_to(FOLDER).with_suffix("").parts])
    for path in FOLDER.rglob("*.py")
    if "kernel\ndef " in path.read_text()
)


def counts_references(value: object) -> bool:
    return isinstance(value, Dispatcher) and value.targetoptions["_nrt"]


def holds_array(hint: Any) -> bool:
    """Whether values of this type are arrays, or tuples with arrays in them."""
    fields = get_type_hints(hint).values() if hasattr(hint, "_fields") else get_args(hint)
    return get_origin(hint) is np.ndarray or any(holds_array(field) for field in fields)


def offences(function: Any) -> list[str]:
    """What a kernel without reference counts does that only one with them may."""
    source = function.py_func
    called = [name for name in source.__code__.co_names if counts_references(source.__globals__.get(name))]
    found = [f"calls {name}" for name in called]
    if holds_array(get_type_hints(source)["return"]):
        found.append("returns an array")
    return found


@allocating_kernel
def one() -> FloatArray:
    return np.ones(1)


@kernel
def calls_one() -> float:
    return float(one()[0])


@kernel
def hands_back(x: FloatArray) -> tuple[int, FloatArray]:
    return 1, x


@kernel
def allocates() -> float:
    return float(np.ones(1)[0])


@pytest.mark.parametrize("module", MODULES)
def test_kernel_without_reference_counts_handles_no_array_of_its_own(module: str) -> None:
    kernels = [value for value in vars(importlib.import_module(module)).values() if isinstance(value, Dispatcher)]
    assert kernels
    assert {each.py_func.__name__: offences(each) for each in kernels if not counts_references(each)} == {
        each.py_func.__name__: [] for each in kernels if not counts_references(each)
    }


def test_offences_are_seen() -> None:
    assert offences(calls_one) == ["calls one"]
    assert offences(hands_back) == ["returns an array"]


def test_allocation_without_reference_counts_is_refused() -> None:
    with pytest.raises(NumbaError, match="array passed into the function"):
        allocates()


@kernel
def pick(x: FloatArray, i: int) -> float:
    return float(x[i])


def test_a_kernel_outside_of_the_physics_may_count_from_the_back() -> None:
    assert pick(np.arange(5.0)[:3], -1) == 2.0


@pytest.mark.slow
def test_another_version_of_numba_gives_the_same_numbers_by_its_own_dispatcher(tmp_path: Path) -> None:
    script = (
        "import sys, numba\n"
        "numba.__version__ = sys.argv[1]\n"
        "from vitac.envs.fem.contact import barrier\n"
        "print(barrier.barrier(3e-5, 1e-4), 'vitac.envs.compilation.numba_internals' in sys.modules)\n"
    )
    ours, plain = (
        subprocess.run([sys.executable, "-c", script, version], check=True, capture_output=True, text=True)
        for version in (numba.__version__, "9.99.0")
    )
    assert ours.stdout.endswith(" True\n")
    assert plain.stdout == ours.stdout.replace(" True", " False")
    assert plain.stderr.count("Numba 9.99.0 is not one of") == 1
