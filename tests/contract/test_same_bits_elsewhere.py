"""A trajectory has the same bits in another process, however that differs from this one.

That it repeats in four at once is in `test_environments`, and that it stays what it was in `test_golden_states`.
"""

import json
import os
import platform
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trajectories
from cloned_sources import Run, clone, run_with
from vitac.envs.compilation import kernel

# The oldest of OpenBLAS's x86 kernels that its wheels hold; every present CPU gets another one by default.
OLD_BLAS_KERNEL = "Nehalem"
ANY_CPU = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
ALL_TASKS = """
import gymnasium
from vitac.envs import ENVIRONMENTS
for task in ENVIRONMENTS:
    env = gymnasium.make(task)
    env.reset(seed=1)
    env.step(env.action_space.sample() * 0)
"""


@pytest.fixture(scope="module")
def digests() -> dict[str, str]:
    return trajectories.digests()


def played_elsewhere(folder: Path, **environment: str) -> tuple[dict[str, str], dict[str, Any], str]:
    """Digests, surroundings and standard error of a process in another folder with other variables."""
    finished = subprocess.run(
        [sys.executable, trajectories.__file__],
        cwd=folder,
        env=os.environ | environment,
        check=True,
        capture_output=True,
        text=True,
    )
    played = json.loads(finished.stdout)
    return played["digests"], played["surroundings"], finished.stderr


@pytest.mark.slow
def test_another_folder_hash_seed_blas_kernel_and_vector_unit_change_no_bit(
    tmp_path: Path, digests: dict[str, str]
) -> None:
    found, surroundings, messages = played_elsewhere(
        tmp_path,
        PYTHONHASHSEED="4711",
        OPENBLAS_CORETYPE=OLD_BLAS_KERNEL,
        OPENBLAS_VERBOSE="2",
        NPY_DISABLE_CPU_FEATURES=" ".join(trajectories.numpy_simd()),
    )
    assert surroundings["folder"] == str(tmp_path.resolve())
    assert surroundings["hash_of_a_word"] != hash("word")
    assert surroundings["numpy_simd"] == []
    blas = np.show_config(mode="dicts")["Build Dependencies"]["blas"]["name"]
    if "openblas" in blas and platform.machine() == "x86_64":
        assert f"Core: {OLD_BLAS_KERNEL}" in messages
    assert found == digests


@pytest.fixture(scope="module")
def cold_cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cold") / "cache"


@pytest.fixture(scope="module")
def cold(cold_cache: Path) -> Run:
    """Compiles all kernels anew, without the instructions that only this CPU has; takes half a minute."""
    play = "import trajectories\nresult = trajectories.played()"
    return run_with(clone(cold_cache.parent / "first"), play, VITAC_CACHE_DIR=str(cold_cache), **ANY_CPU)


@pytest.mark.slow
def test_a_cold_cache_and_a_build_for_any_cpu_change_no_bit(cold: Run, digests: dict[str, str]) -> None:
    assert cold.result["surroundings"]["compiled_for"] == "generic"
    assert cold.result["digests"] == digests


@pytest.mark.slow
def test_every_kernel_is_compiled_once_and_a_second_clone_compiles_nothing(cold: Run, cold_cache: Path) -> None:
    """All tasks; a kernel for one set of argument types, once if Python calls it and once if kernels do."""
    assert [name for name, count in Counter(cold.compiled).items() if count > 1] == []
    assert len(cold.compiled) > 100
    second = clone(cold_cache.parent / "second")
    assert run_with(second, ALL_TASKS, VITAC_CACHE_DIR=str(cold_cache), **ANY_CPU).compiled == []


def test_kernels_round_every_product_before_they_add() -> None:
    """A fused multiply-add keeps the product's last bits, so its results would depend on the CPU."""
    x, square = 1 + 2.0**-30, 1 + 2.0**-29
    assert x * x == square  # by rounding: the exact product has 2^-60 more
    rest = np.ones(64)
    _squares_less(np.full(64, x), np.full(64, square), rest)
    np.testing.assert_array_equal(rest, 0.0)


@kernel
def _squares_less(x: np.ndarray[Any, Any], y: np.ndarray[Any, Any], out: np.ndarray[Any, Any]) -> None:
    for i in range(len(x)):
        out[i] = x[i] * x[i] - y[i]
