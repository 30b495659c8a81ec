"""Machine code is made anew only where sources changed.

That a second clone finds all of it is in `tests/contract/test_same_bits_elsewhere`, which compiles everything once.
"""

import os
import pickle
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from cloned_sources import clone, run_with
from llvmlite import binding  # type: ignore[import-untyped]
from numba.np import arrayobj
from vitac.envs.compilation.numba_internals import indices_as_written

pytestmark = pytest.mark.slow

SMALL_KERNELS = """
from vitac.envs.fem import algebra
from vitac.envs.fem.contact import barrier
v = (1.0, 2.0, 3.0)
algebra.cross(v, v)
barrier.squared_cross_norm(v, v)
"""
BARRIER = ["part algebra.cross", "part algebra.dot", "entry contact.barrier.squared_cross_norm"]
ALL_SMALL = ["entry algebra.cross", *BARRIER]


def small_compiled_by(sources: Path, cache: str, **environment: str) -> list[str]:
    """What a process compiles that plays the small kernels."""
    ran = run_with(sources, SMALL_KERNELS, VITAC_CACHE_DIR=cache, **environment)
    return [name.replace("vitac.envs.fem.", "") for name in ran.compiled]


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache with the small kernels, for tests to copy."""
    folder = tmp_path_factory.mktemp("filled")
    assert small_compiled_by(clone(folder / "clone"), str(folder / "cache")) == ALL_SMALL
    return folder / "cache"


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ("fem/contact/barrier.py", BARRIER),
        ("fem/algebra.py", ALL_SMALL),
        ("fem/contact/distance.py", []),
        ("compilation/numba_internals.py", ALL_SMALL),
    ],
)
def test_a_changed_module_is_compiled_with_what_depends_on_it(
    tmp_path: Path, filled: Path, changed: str, expected: list[str]
) -> None:
    cache = str(shutil.copytree(filled, tmp_path / "cache"))
    sources = clone(tmp_path / "clone")
    path = sources / "vitac" / "envs" / changed
    path.write_text(path.read_text() + "# changed\n")
    assert small_compiled_by(sources, cache) == expected


def test_sources_that_change_while_a_process_runs_do_not_name_what_it_compiles(tmp_path: Path) -> None:
    cache = str(tmp_path / "cache")
    sources = clone(tmp_path / "clone")
    imports, calls = SMALL_KERNELS.split("v =")
    change = f"""
from pathlib import Path
path = Path({str(sources)!r}) / "vitac/envs/fem/contact/barrier.py"
path.write_text(path.read_text() + "# changed")
v ="""
    run_with(sources, imports + change + calls, VITAC_CACHE_DIR=cache)
    assert small_compiled_by(sources, cache) == BARRIER


def test_machine_code_is_stored_with_the_names_of_its_functions_and_not_their_ir(filled: Path) -> None:
    for file in filled.rglob("*.nbc"):
        (_, _, (machine_code, bitcode)), *_ = pickle.loads(file.read_bytes())  # noqa: S301 - our own
        functions = list(binding.parse_bitcode(bitcode).functions)
        assert any(function.name.encode() in machine_code for function in functions)
        assert {len(list(block.instructions)) for function in functions for block in function.blocks} == {1}


def test_files_that_were_cut_off_are_compiled_anew(tmp_path: Path, filled: Path) -> None:
    cache = str(shutil.copytree(filled, tmp_path / "cache"))
    sources = clone(tmp_path / "clone")
    for path in tmp_path.rglob("*.nbc"):
        path.write_bytes(path.read_bytes()[:100])
    for path in tmp_path.rglob("cross*.nbi"):
        path.write_bytes(b"")
    assert small_compiled_by(sources, cache) == ALL_SMALL
    assert small_compiled_by(sources, cache) == []


def test_a_folder_that_cannot_be_written_is_not_needed(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    sources = clone(tmp_path / "clone")
    assert small_compiled_by(sources, str(tmp_path / "file" / "cache"), TMPDIR=str(tmp_path)) == ALL_SMALL
    assert list(tmp_path.glob("vitac-*/kernels/*/*.nbc"))


def test_a_full_disk_does_not_fail_the_physics(tmp_path: Path) -> None:
    """Machine code larger than any file may be; the numbers are there, and the reason is logged."""
    cache = str(tmp_path / "cache")
    sources = clone(tmp_path / "clone")
    full = "import resource\nresource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))\n"
    done = subprocess.run(
        [sys.executable, "-c", full + SMALL_KERNELS + "print(algebra.cross((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)))"],
        env=os.environ | {"PYTHONPATH": str(sources), "PYTHONDONTWRITEBYTECODE": "1", "VITAC_CACHE_DIR": cache},
        check=False,
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stdout) == (0, "(0.0, 0.0, 1.0)\n"), done.stderr
    assert done.stderr.count("Compiling the physics into") == 1
    assert done.stderr.count("cannot be stored") == 1
    assert small_compiled_by(sources, cache) == ALL_SMALL


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
