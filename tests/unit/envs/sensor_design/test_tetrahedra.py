import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from vitac.envs.sensor_design.tetrahedra import Tetrahedra

FloatArray = NDArray[np.float64]

CORNER = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
REGULAR = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
# A cube cut into six around its diagonal; bits of a node's number are its coordinates.
CUBE = np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)], dtype=np.float64)
CUBE_CORNERS = np.array([(0, 1, 3, 7), (0, 3, 2, 7), (0, 2, 6, 7), (0, 6, 4, 7), (0, 4, 5, 7), (0, 5, 1, 7)])


def single(nodes_mm: FloatArray) -> Tetrahedra:
    return Tetrahedra(nodes_mm=nodes_mm, corners=np.array([[0, 1, 2, 3]]))


def cube() -> Tetrahedra:
    return Tetrahedra(nodes_mm=CUBE, corners=CUBE_CORNERS)


def test_volume_is_a_sixth_of_the_box_and_negative_when_inverted() -> None:
    assert single(CORNER).volumes_mm3 == pytest.approx([1.0 / 6.0])
    assert single(CORNER[[1, 0, 2, 3]]).volumes_mm3 == pytest.approx([-1.0 / 6.0])
    assert cube().volume_mm3 == pytest.approx(1.0)


def test_quality_is_one_for_a_regular_tetrahedron_and_zero_for_a_flat_one() -> None:
    assert abs(single(REGULAR).qualities[0]) == pytest.approx(1.0)
    assert single(CORNER * [1.0, 1.0, 0.0]).qualities[0] == 0.0
    assert single(CORNER).qualities[0] == pytest.approx(np.sqrt(2.0) / 2.0**1.5)


@given(st.integers(0, 10**6), st.floats(0.01, 100.0))
def test_quality_is_at_most_one_and_does_not_depend_on_size_or_place(seed: int, size: float) -> None:
    random = np.random.default_rng(seed)
    nodes = random.normal(size=(4, 3))
    quality = float(single(nodes).qualities[0])
    assert abs(quality) <= 1.0 + 1e-12
    assert single(size * nodes + random.normal(size=3)).qualities[0] == pytest.approx(quality, abs=1e-9)


@pytest.mark.parametrize("order", [(1, 2, 0, 3), (2, 0, 1, 3), (1, 0, 3, 2), (3, 2, 1, 0)])
def test_even_reordering_of_corners_changes_neither_volume_nor_quality(order: tuple[int, ...]) -> None:
    nodes = np.random.default_rng(3).normal(size=(4, 3))
    again = single(nodes[list(order)])
    assert again.volumes_mm3 == pytest.approx(single(nodes).volumes_mm3)
    assert again.qualities == pytest.approx(single(nodes).qualities)


def test_surface_of_a_cube_is_its_twelve_outward_triangles() -> None:
    surface = cube().surface
    assert len(surface.triangles) == 12
    assert surface.volume_mm3 == pytest.approx(1.0)
    assert surface.areas_mm2.sum() == pytest.approx(6.0)
    assert surface.area_vectors_mm2.sum(axis=0) == pytest.approx([0.0, 0.0, 0.0])
    outward = surface.corners_mm.mean(axis=1) - 0.5
    assert ((outward * surface.area_vectors_mm2).sum(axis=1) > 0.0).all()


def test_faces_of_a_single_tetrahedron_look_outward() -> None:
    surface = single(CORNER).surface
    assert len(surface.triangles) == 4
    assert surface.volume_mm3 == pytest.approx(1.0 / 6.0)


def test_faces_of_the_base_lie_in_its_plane_and_look_down() -> None:
    faces = cube().surface.triangles[cube().base_faces]
    assert sorted(sorted(face) for face in faces.tolist()) == [[0, 1, 3], [0, 2, 3]]
    raised = CUBE.copy()
    raised[3, 2] = 0.002
    assert not Tetrahedra(nodes_mm=raised, corners=CUBE_CORNERS).base_faces.any()


def test_a_face_of_three_tetrahedra_is_counted() -> None:
    assert cube().n_shared_faces == 0
    nodes = np.concatenate([CORNER, [[0.0, 0.0, -1.0], [0.0, 0.0, 2.0]]])
    fan = Tetrahedra(nodes_mm=nodes, corners=np.array([[0, 1, 2, 3], [0, 2, 1, 4], [0, 1, 2, 5]]))
    assert fan.n_shared_faces == 1


def test_bytes_tell_meshes_apart_and_do_not_depend_on_the_memory_layout() -> None:
    mesh = cube()
    moved = CUBE.copy()
    moved[5, 2] = np.nextafter(moved[5, 2], 2.0)
    assert mesh.as_bytes() != Tetrahedra(nodes_mm=moved, corners=CUBE_CORNERS).as_bytes()
    assert mesh.as_bytes() != Tetrahedra(nodes_mm=CUBE, corners=CUBE_CORNERS[::-1]).as_bytes()
    same = Tetrahedra(nodes_mm=np.asfortranarray(CUBE.astype(">f8")), corners=CUBE_CORNERS.astype(np.int32))
    assert mesh.as_bytes() == same.as_bytes()
    assert len(mesh.as_bytes()) == 8 * (8 * 3 + 6 * 4)
