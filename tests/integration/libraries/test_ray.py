"""Episodes that a Ray cluster of three nodes plays, one of which is lost, have the bytes of those played here."""

import os
import sys
import warnings
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from time import sleep
from types import ModuleType
from typing import Any

import pytest
from vitac.envs.tasks.settings import Fidelity
from vitac.training.collection import ActorKind, CollectedBatch, collect
from vitac.training.demonstrations.collecting import collect as collect_demonstrations
from vitac.training.pool import map_in_order
from vitac.training.streams import Use


@pytest.fixture
def ray() -> ModuleType:
    """Ray, or a skip that says how to install it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found: ModuleType = pytest.importorskip("ray", reason="needs Ray: pip install 'ray>=2.50'")
        return found


@pytest.fixture
def cluster(ray: ModuleType) -> Iterator[Any]:
    """Three nodes on this machine, of one process each; the nodes find what this Python finds."""
    from ray.cluster_utils import Cluster

    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("PYTHONPATH", os.pathsep.join(path for path in sys.path if path))
        patched.setenv("RAY_USAGE_STATS_ENABLED", "0")
        made = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
        made.others = [made.add_node(num_cpus=1) for _ in range(2)]
        yield made
        ray.shutdown()
        made.shutdown()


def slow_square(number: int) -> int:
    sleep(0.2)
    return number * number


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_cluster_of_three_nodes_that_loses_one_gives_the_same_bytes(cluster: Any, tmp_path: Path) -> None:
    results = map_in_order(slow_square, range(30), ray=cluster.address)
    found = list(islice(results, 3))
    cluster.remove_node(cluster.others[0], allow_graceful=False)
    assert [*found, *results] == [number * number for number in range(30)]
    batch = CollectedBatch(
        kind=ActorKind.RANDOM, seed=2, use=Use.COLLECT, first=0, count=120, fidelity=Fidelity.TRAINING
    )
    collect(batch, tmp_path / "here", processes=2)
    collect(batch, tmp_path / "ray", ray=cluster.address)
    assert read_files(tmp_path / "ray") == read_files(tmp_path / "here")
    for name, ray in (("here", None), ("ray", cluster.address)):
        collect_demonstrations("peg-insertion", tmp_path / f"data-{name}", successes=4, seed=2, ray=ray)
    assert read_files(tmp_path / "data-ray") == read_files(tmp_path / "data-here")


def read_files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
