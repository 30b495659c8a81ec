"""Copies of the environments' sources, and processes that play something with them and tell what they compiled."""

import json
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import vitac.envs

FOLDER = Path(vitac.envs.__file__).parent
# Prints where the sources are, which kernels were compiled, and what the play left under `result`.
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
result = None
exec(sys.argv[1])
import vitac.envs
print(json.dumps([vitac.envs.__file__, compiled, result]))
"""


@dataclass(frozen=True, kw_only=True)
class Run:
    """What a process compiled, entries and parts of entries, and the `result` of what it played."""

    compiled: list[str]
    result: Any


def clone(folder: Path) -> Path:
    """Copy our sources, all with another time; returns the folder to import from."""
    envs = folder / "vitac" / "envs"
    shutil.copytree(FOLDER, envs, ignore=shutil.ignore_patterns("__pycache__"), copy_function=shutil.copyfile)
    for path in envs.rglob("*.py"):
        os.utime(path, (1e9, 1e9))
    return folder


def run_with(sources: Path, play: str, **environment: str) -> Run:
    """Run a process that plays something with these sources; it can import the modules beside this one."""
    path = os.pathsep.join([str(sources), str(Path(__file__).parent)])
    done = subprocess.run(
        [sys.executable, "-c", REPORT, play],
        env=os.environ | {"PYTHONPATH": path} | environment,
        check=True,
        capture_output=True,
        text=True,
    )
    imported, compiled, result = json.loads(done.stdout)
    assert Path(imported).is_relative_to(sources)
    return Run(compiled=compiled, result=result)
