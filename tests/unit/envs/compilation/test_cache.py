"""Machine code is found by every copy of the same sources, and made anew only where these changed."""

import json
import os
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
import vitac.envs

FOLDER = Path(vitac.envs.__file__).parent
# Prints where the sources are and which kernels were compiled.
SMALL_KERNELS = """
from vitac.envs.fem.algebra import mat3, vec3
v = (1.0, 2.0, 3.0)
vec3.cross(v, v)
mat3.scale_matrix(2.0, (v, v, v))
"""
BOTH_TASKS = """
import gymnasium
from vitac.envs import ENVIRONMENTS
for task in ENVIRONMENTS:
    env = gymnasium.make(task)
    env.reset(seed=1)
    env.step(env.action_space.sample() * 0)
"""
ALL_SMALL = ["entry vec3.cross", "part vec3.scale", "entry mat3.scale_matrix"]
REPORT = """
import json, sys
from numba.core import event
compiled = []
class Listener(event.Listener):
    def on_start(self, started): pass
    def on_end(self, ended):
        function = ended.data["dispatcher"].py_func
        if function.__module__.startswith("vitac."):
            purpose = "entry" if "return_type" in ended.data else "part"
            compiled.append(f"{purpose} {function.__module__}.{function.__qualname__}")
event.register("numba:compile", Listener())
exec(sys.argv[1])
import vitac.envs
print(json.dumps([vitac.envs.__file__, compiled]))
"""


def clone(folder: Path) -> Path:
    """Copy our sources, all with another time; returns the folder to import from."""
    envs = folder / "vitac" / "envs"
    shutil.copytree(FOLDER, envs, ignore=shutil.ignore_patterns("__pycache__"), copy_function=shutil.copyfile)
    for path in envs.rglob("*.py"):
        os.utime(path, (1e9, 1e9))
    return folder


def compiled_by(sources: Path, play: str, **environment: str) -> list[str]:
    """Names of the kernels that a process compiles which plays something with these sources."""
    done = subprocess.run(
        [sys.executable, "-c", REPORT, play],
        env=os.environ | {"PYTHONPATH": str(sources)} | environment,
        check=True,
        capture_output=True,
        text=True,
    )
    imported, compiled = json.loads(done.stdout)
    assert Path(imported).is_relative_to(sources)
    return list(compiled)


def small_compiled_by(sources: Path, cache: str, **environment: str) -> list[str]:
    """What a process compiles that plays the small kernels."""
    compiled = compiled_by(sources, SMALL_KERNELS, VITAC_CACHE_DIR=cache, **environment)
    return [name.replace("vitac.envs.fem.algebra.", "") for name in compiled]


def test_every_kernel_is_compiled_once_and_a_second_clone_compiles_nothing(tmp_path: Path) -> None:
    """Both tasks; a kernel for one set of argument types, once if Python calls it and once if kernels do."""
    cache = str(tmp_path / "cache")
    compiled = compiled_by(clone(tmp_path / "first"), BOTH_TASKS, VITAC_CACHE_DIR=cache)
    assert [name for name, count in Counter(compiled).items() if count > 1] == []
    assert len(compiled) > 100
    assert compiled_by(clone(tmp_path / "second"), BOTH_TASKS, VITAC_CACHE_DIR=cache) == []


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ("fem/algebra/mat3.py", ["part vec3.scale", "entry mat3.scale_matrix"]),
        ("fem/algebra/vec3.py", ALL_SMALL),
        ("fem/algebra/rows.py", []),
        ("compilation/kernels.py", ALL_SMALL),
    ],
)
def test_a_changed_module_is_compiled_with_what_depends_on_it(
    tmp_path: Path, changed: str, expected: list[str]
) -> None:
    cache = str(tmp_path / "cache")
    sources = clone(tmp_path / "clone")
    assert small_compiled_by(sources, cache) == ALL_SMALL
    path = sources / "vitac" / "envs" / changed
    path.write_text(path.read_text() + "# changed\n")
    assert small_compiled_by(sources, cache) == expected


def test_sources_that_change_while_a_process_runs_do_not_name_what_it_compiles(tmp_path: Path) -> None:
    cache = str(tmp_path / "cache")
    sources = clone(tmp_path / "clone")
    imports, calls = SMALL_KERNELS.split("v =")
    change = f"""
from pathlib import Path
path = Path({str(sources)!r}) / "vitac/envs/fem/algebra/mat3.py"
path.write_text(path.read_text() + "# changed")
v ="""
    compiled_by(sources, imports + change + calls, VITAC_CACHE_DIR=cache)
    assert small_compiled_by(sources, cache) == ["part vec3.scale", "entry mat3.scale_matrix"]


def test_files_that_were_cut_off_are_compiled_anew(tmp_path: Path) -> None:
    cache = str(tmp_path / "cache")
    sources = clone(tmp_path / "clone")
    small_compiled_by(sources, cache)
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
        [sys.executable, "-c", full + SMALL_KERNELS + "print(vec3.cross((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)))"],
        env=os.environ | {"PYTHONPATH": str(sources), "PYTHONDONTWRITEBYTECODE": "1", "VITAC_CACHE_DIR": cache},
        check=False,
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stdout) == (0, "(0.0, 0.0, 1.0)\n"), done.stderr
    assert "cannot be kept" in done.stderr
    assert small_compiled_by(sources, cache) == ALL_SMALL
