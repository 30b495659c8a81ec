import socket
import subprocess
import sys
from collections.abc import Iterator

import pytest
from vitac.envs.geometry import pegs
from vitac.evaluator.shards.host import SimulationHost

SURFACES = (pegs.peg_surface, pegs.hole_surface)


@pytest.fixture
def host() -> Iterator[SimulationHost]:
    ours, theirs = socket.socketpair()
    with ours, theirs:
        yield SimulationHost(ours)


def test_host_makes_the_parts_of_every_shape_so_that_no_shard_has_to(host: SimulationHost) -> None:
    for surface in SURFACES:
        surface.cache_clear()
    host._load_task("track_1", "peg-insertion")
    assert [surface.cache_info().currsize for surface in SURFACES] == [len(pegs.PegShape)] * len(SURFACES)


def test_numba_is_loaded_without_what_no_kernel_uses() -> None:
    code = """
import sys
from types import ModuleType
sys.modules["cffi"] = loaded_before = ModuleType("cffi")
from vitac.evaluator.shards.host import _load_numba
_load_numba()
print(sys.modules["cffi"] is loaded_before, "cffi.api" in sys.modules, "scipy" in sys.modules)
"""
    ran = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert ran.stdout == "True False False\n"
