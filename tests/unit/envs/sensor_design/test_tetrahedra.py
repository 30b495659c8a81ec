import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from vitac.envs.fem.model.mesh import MeshError
from vitac.envs.sensor_design.tetrahedra import Tetrahedra, make_gel

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


# A block of 4 x 3 x 2 mm in six tetrahedra around its diagonal; bits of a node's number are its coordinates.
NODES_MM = np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)], dtype=np.float64) * [4.0, 3.0, 2.0]
CORNERS = np.array([(0, 1, 3, 7), (0, 3, 2, 7), (0, 2, 6, 7), (0, 6, 4, 7), (0, 4, 5, 7), (0, 5, 1, 7)])


def block(nodes_mm: np.ndarray = NODES_MM) -> Tetrahedra:
    return Tetrahedra(nodes_mm=nodes_mm, corners=CORNERS)


def leaning(shift_mm: float) -> Tetrahedra:
    """The block with the right half of its top lifted."""
    nodes = NODES_MM.copy()
    nodes[[5, 7], 2] += shift_mm
    return block(nodes)


def test_base_is_driven_and_top_senses() -> None:
    gel, sensing = make_gel(block(), name="block")
    assert gel.driven.tolist() == [True] * 4 + [False] * 4
    assert gel.sensing.tolist() == [False] * 4 + [True] * 4
    assert sensing.shape == (2, 3)
    assert gel.name == "block"


def test_gel_is_in_metres_with_the_middle_of_its_thickness_at_zero() -> None:
    gel, _ = make_gel(block(), name="block")
    assert gel.rest_position_m.min(axis=0) == pytest.approx([0.0, 0.0, -0.001])
    assert gel.rest_position_m.max(axis=0) == pytest.approx([0.004, 0.003, 0.001])


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 59.0])
def test_faces_that_lean_up_to_sixty_degrees_sense(angle_deg: float) -> None:
    _, sensing = make_gel(leaning(4.0 * np.tan(np.radians(angle_deg))), name="leaning")
    assert len(sensing) == 2


def test_a_gel_whose_top_leans_more_has_no_sensing_face() -> None:
    with pytest.raises(MeshError, match="leaning: no node is sensing"):
        make_gel(leaning(4.0 * np.tan(np.radians(61.0))), name="leaning")


def test_a_base_off_its_plane_is_not_driven() -> None:
    lifted = NODES_MM + np.array([0.0, 0.0, 0.002])
    with pytest.raises(MeshError, match="lifted: no node is driven"):
        make_gel(block(lifted), name="lifted")


def with_a_hollow() -> Tetrahedra:
    """3 x 3 x 3 cells of 1 mm without the middle one."""
    strides = np.array([1, 4, 16])
    grid = np.array([[x, y, z] for z in range(4) for y in range(4) for x in range(4)], dtype=np.float64)
    cell = np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)]) @ strides
    starts = [
        np.array([x, y, z]) @ strides for x in range(3) for y in range(3) for z in range(3) if (x, y, z) != (1, 1, 1)
    ]
    return Tetrahedra(nodes_mm=grid, corners=np.concatenate([cell[CORNERS] + start for start in starts]))


def test_the_floor_of_a_closed_hollow_does_not_sense() -> None:
    """It looks up as the sensing face does, but belongs to the inner shell."""
    mesh = with_a_hollow()
    assert mesh.surface.shells.max() == 1
    _, sensing = make_gel(mesh, name="hollow")
    assert (mesh.nodes_mm[sensing][:, :, 2] == 3.0).all()
    assert len(sensing) == 2 * 9


def test_tetrahedra_that_are_all_there_twice_have_no_outer_surface() -> None:
    once = block()
    twice = Tetrahedra(nodes_mm=once.nodes_mm, corners=np.concatenate([once.corners, once.corners]))
    with pytest.raises(MeshError, match="twice has no outer surface"):
        make_gel(twice, name="twice")
