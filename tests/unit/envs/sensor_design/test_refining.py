import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from vitac.envs.sensor_design.tetrahedra import Tetrahedra, refined, refined_tips, tip_sizes

CUBE = Tetrahedra(
    nodes_mm=np.array([[x, y, z] for z in (0.0, 1.0) for y in (0.0, 2.0) for x in (0.0, 3.0)]),
    corners=np.array([(0, 1, 3, 7), (0, 3, 2, 7), (0, 2, 6, 7), (0, 6, 4, 7), (0, 4, 5, 7), (0, 5, 1, 7)]),
)


@given(nodes=st.integers(9, 90))
@settings(max_examples=15)
def test_refined_mesh_fills_the_same_body_and_meets_at_whole_faces(nodes: int) -> None:
    fine = refined(CUBE, nodes)
    assert len(fine.nodes_mm) == nodes
    assert fine.volumes_mm3.min() > 0.0
    assert fine.volume_mm3 == pytest.approx(CUBE.volume_mm3)
    assert fine.n_shared_faces == 0
    surface = fine.surface
    assert (len(surface.open_edges), len(surface.mixed_edges), len(surface.branching_edges)) == (0, 0, 0)
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


TIPS = refined(CUBE, 9)
"""Its ninth node is in the middle; above 0.9 lie the four upper corners, above 0.4 that one, too."""


@given(depth_mm=st.floats(0.05, 0.95), fewest=st.integers(1, 40), room=st.integers(0, 60))
@settings(max_examples=25)
def test_tips_are_filled_up_within_the_nodes_allowed(depth_mm: float, fewest: int, room: int) -> None:
    fine = refined_tips(TIPS, depth_mm=depth_mm, fewest=fewest, max_nodes=9 + room)
    assert len(fine.nodes_mm) <= 9 + room
    assert tip_sizes(fine, depth_mm=depth_mm)[0] >= fewest or len(fine.nodes_mm) == 9 + room
    assert fine.volume_mm3 == pytest.approx(CUBE.volume_mm3)
    assert fine.n_shared_faces == 0
    assert fine.volumes_mm3.min() > 0.0
    surface = fine.surface
    assert (len(surface.open_edges), len(surface.mixed_edges), len(surface.branching_edges)) == (0, 0, 0)


def test_only_what_reaches_into_a_tip_is_halved() -> None:
    mesh = refined(CUBE, 200)
    fine = refined_tips(mesh, depth_mm=0.2, fewest=150, max_nodes=1000)
    (size,) = tip_sizes(fine, depth_mm=0.2)
    assert size == 150
    added = fine.nodes_mm[len(mesh.nodes_mm) :]
    np.testing.assert_array_equal(fine.nodes_mm[: len(mesh.nodes_mm)], mesh.nodes_mm)
    assert added[:, 2].min() > 0.3
    assert (added[:, 2] >= 0.8).sum() + (mesh.nodes_mm[:, 2] >= 0.8).sum() == 150


def test_tips_with_nodes_enough_stay_as_they_are() -> None:
    assert refined_tips(CUBE, depth_mm=0.5, fewest=4, max_nodes=100).as_bytes() == CUBE.as_bytes()


def test_parts_that_hang_together_below_the_plane_only_are_two() -> None:
    """Two tetrahedra side by side share an edge of their base."""
    nodes_mm = np.array([[0, 0, 0], [0, 2, 0], [2, 1, 0], [-2, 1, 0], [1, 1, 1], [-1, 1, 1]], dtype=float)
    two = Tetrahedra(nodes_mm=nodes_mm, corners=np.array([(0, 2, 1, 4), (0, 1, 3, 5)]))
    assert two.volumes_mm3.min() > 0.0
    assert tip_sizes(two, depth_mm=0.3) == [1, 1]
    assert tip_sizes(two, depth_mm=1.0) == [6]
    assert tip_sizes(refined_tips(two, depth_mm=0.3, fewest=6, max_nodes=100), depth_mm=0.3) == [6, 6]


def test_numbers_of_the_nodes_do_not_matter_to_tips() -> None:
    order = np.random.default_rng(2).permutation(8)
    other = Tetrahedra(nodes_mm=CUBE.nodes_mm[order], corners=np.argsort(order)[CUBE.corners])
    first, second = (
        np.array(sorted(refined_tips(mesh, depth_mm=0.3, fewest=30, max_nodes=200).nodes_mm.tolist()))
        for mesh in (CUBE, other)
    )
    np.testing.assert_array_equal(first, second)
