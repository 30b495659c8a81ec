import socket
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
