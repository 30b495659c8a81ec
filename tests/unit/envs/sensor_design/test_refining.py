import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from vitac.envs.sensor_design.refining import refined
from vitac.envs.sensor_design.tetrahedra import Tetrahedra

CUBE = Tetrahedra(
    nodes_mm=np.array([[x, y, z] for z in (0.0, 1.0) for y in (0.0, 2.0) for x in (0.0, 3.0)]),
    corners=np.array([(0, 1, 3, 7), (0, 3, 2, 7), (0, 2, 6, 7), (0, 6, 4, 7), (0, 4, 5, 7), (0, 5, 1, 7)]),
)


@given(nodes=st.integers(9, 90))
@settings(deadline=None, max_examples=15)
def test_refined_mesh_fills_the_same_body_and_meets_at_whole_faces(nodes: int) -> None:
    fine = refined(CUBE, nodes)
    assert len(fine.nodes_mm) == nodes
    assert fine.volumes_mm3.min() > 0.0
    assert fine.volume_mm3 == pytest.approx(CUBE.volume_mm3)
    assert fine.n_shared_faces == 0
    surface = fine.surface
    assert (surface.n_open_edges, surface.n_mixed_edges, surface.n_branching_edges) == (0, 0, 0)
    assert surface.areas_mm2.sum() == pytest.approx(CUBE.surface.areas_mm2.sum())
    assert fine.qualities.min() > 0.2 * CUBE.qualities.min()


def test_longest_edges_are_halved_first() -> None:
    assert refined(CUBE, 9).nodes_mm[-1].tolist() == [1.5, 1.0, 0.5]


def test_mesh_with_enough_nodes_stays_as_it_is() -> None:
    assert refined(CUBE, 8).as_bytes() == CUBE.as_bytes()


def test_numbers_of_the_nodes_do_not_matter() -> None:
    order = np.random.default_rng(1).permutation(8)
    other = Tetrahedra(nodes_mm=CUBE.nodes_mm[order], corners=np.argsort(order)[CUBE.corners])
    first, second = (np.array(sorted(refined(mesh, 60).nodes_mm.tolist())) for mesh in (CUBE, other))
    np.testing.assert_array_equal(first, second)
