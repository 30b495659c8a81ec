"""An array of taxels: where forces on a gel are felt, and which way they count."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from vitac.envs.fem.model.mesh import GelMesh
from vitac.envs.scene.gripper import UPRIGHT_MOUNTS
from vitac.envs.tactile.camera import CHALLENGE_CAMERA, camera_frame, project
from vitac.envs.tactile.gel import (
    arena_gel_mesh,
    coarse_arena_gel_mesh,
    coarse_gelsight_mini_mesh,
    eye_distance_m,
    gelsight_mini_mesh,
)
from vitac.envs.tactile.taxels import NotAnArray, TaxelArray

GELS = [gelsight_mini_mesh, coarse_gelsight_mini_mesh, arena_gel_mesh, coarse_arena_gel_mesh]
FloatArray = NDArray[np.float64]


def at_node(gel: GelMesh, node: int, force_n: tuple[float, float, float]) -> FloatArray:
    on_nodes_n = np.zeros_like(gel.rest_position_m)
    on_nodes_n[node] = force_n
    return on_nodes_n


@pytest.mark.parametrize("make_gel", GELS)
@pytest.mark.parametrize("array", [TaxelArray(), TaxelArray(rows=4, columns=6)])
def test_forces_on_the_sensing_face_are_all_felt(make_gel: Callable[[], GelMesh], array: TaxelArray) -> None:
    gel = make_gel()
    random = np.random.default_rng(0)
    on_nodes_n = random.normal(size=gel.rest_position_m.shape) * gel.sensing[:, None]
    felt_n = array.forces_n(on_nodes_n, gel, np.eye(3))
    assert felt_n.shape == (array.rows, array.columns, 3)
    np.testing.assert_allclose(felt_n.sum(axis=(0, 1)), -on_nodes_n.sum(axis=0), atol=1e-12)


def test_forces_beside_the_sensing_face_are_not_felt() -> None:
    gel = arena_gel_mesh()
    on_nodes_n = np.ones_like(gel.rest_position_m) * ~gel.sensing[:, None]
    assert not TaxelArray().forces_n(on_nodes_n, gel, np.eye(3)).any()


@pytest.mark.parametrize("make_gel", GELS)
def test_an_even_pressure_is_the_same_on_all_taxels(make_gel: Callable[[], GelMesh]) -> None:
    """Of a pressure each node has the part that belongs to its shape function, a third of the triangles around it."""
    gel = make_gel()
    faces = gel.surface_triangles[gel.sensing[gel.surface_triangles].all(axis=1)]
    first, second, third = gel.rest_position_m[faces].transpose(1, 0, 2)
    areas_m2 = 0.5 * np.linalg.norm(np.cross(second - first, third - first), axis=1)
    on_nodes_n = np.zeros_like(gel.rest_position_m)
    np.add.at(on_nodes_n[:, 2], faces, -areas_m2[:, None] / 3.0 / areas_m2.sum())
    pressure_n = TaxelArray().forces_n(on_nodes_n, gel, np.eye(3))[:, :, 2]
    assert pressure_n.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(pressure_n, 1.0 / 12.0, rtol=0.03)
    np.testing.assert_allclose(pressure_n, pressure_n[::-1, ::-1], rtol=1e-9)


def test_a_force_is_felt_where_the_camera_of_the_sensor_sees_it() -> None:
    """So rows and columns, and both directions of shear, are those of the picture."""
    gel, array = arena_gel_mesh(), TaxelArray()
    mount = UPRIGHT_MOUNTS[0].rotation
    nodes_m = gel.rest_position_m @ mount.T
    shifted_m = nodes_m + 1e-4 * np.array([0.3, -0.2, 1.0])
    views = [
        project(camera_frame(at_m, mount, np.zeros(3), eye_distance_m(gel)), CHALLENGE_CAMERA)
        for at_m in (nodes_m, shifted_m)
    ]
    sensing_px = views[0][gel.sensing_nodes]
    low_px, high_px = sensing_px.min(axis=0), sensing_px.max(axis=0)
    for node in gel.sensing_nodes[[0, 11, 37, 60, 80]]:
        felt_n = array.forces_n(at_node(gel, node, (0.3, -0.2, 1.0)), gel, mount)
        row, column = np.unravel_index(np.abs(felt_n).sum(axis=2).argmax(), (3, 4))
        across, down = (views[0][node] - low_px) / (high_px - low_px) * (4, 3)
        assert column - 0.01 <= across <= column + 1.01
        assert row - 0.01 <= down <= row + 1.01
        moved_px = views[1][node] - views[0][node]
        np.testing.assert_array_equal(np.sign(felt_n[row, column, :2]), np.sign(moved_px))


def test_what_presses_on_the_gel_is_positive() -> None:
    gel = arena_gel_mesh()
    felt_n = TaxelArray().forces_n(at_node(gel, gel.sensing_nodes[40], (0.0, 0.0, -1.0)), gel, np.eye(3))
    assert felt_n[:, :, 2].sum() == pytest.approx(1.0)
    # The middle node is on the border of two columns, which share it.
    np.testing.assert_allclose(felt_n[1, 1:3, 2], [0.5, 0.5], atol=1e-9)


@pytest.mark.parametrize(
    ("values", "message"),
    [({"rows": 0}, "got 0 and 4"), ({"noise_n": -0.1}, "got -0.1"), ({"noise_n": float("nan")}, "got nan")],
)
def test_an_impossible_array_is_refused(values: dict[str, float], message: str) -> None:
    with pytest.raises(NotAnArray, match=message):
        TaxelArray(**values)  # type: ignore[arg-type]
