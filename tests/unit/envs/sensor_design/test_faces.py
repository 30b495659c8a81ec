import numpy as np
import pytest
from vitac.envs.fem.model.mesh import MeshError
from vitac.envs.sensor_design.faces import make_gel
from vitac.envs.sensor_design.tetrahedra import Tetrahedra

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
