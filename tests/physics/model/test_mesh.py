"""Meshes and scenes that cannot be simulated are refused by name, element and value."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from block_meshes import box_gel, box_surface
from numpy.typing import NDArray
from small_scenes import IDENTITY
from vitac.envs.fem.model.mesh import (
    GelBody,
    GelMesh,
    MeshError,
    RigidBody,
    SurfaceMesh,
    signed_volumes_m3,
    unique_edges,
)
from vitac.envs.fem.scene.layout import SceneError
from vitac.envs.fem.scene.scene import Scene

BLOCK = box_gel((0.006, 0.005, 0.004), (2, 2, 2), name="block.msh")
BOX = box_surface((0.01, 0.01, 0.01), name="box.stl")


def with_position(node: int, position_m: list[float]) -> NDArray[np.float64]:
    positions = BLOCK.rest_position_m.copy()
    positions[node] = position_m
    return positions


def test_an_inverted_tetrahedron_is_named() -> None:
    tetrahedra = BLOCK.tetrahedra.copy()
    tetrahedra[7] = tetrahedra[7][[1, 0, 2, 3]]
    with pytest.raises(MeshError, match=r"block\.msh: tetrahedron 7 .* is inverted: volume -"):
        replace(BLOCK, tetrahedra=tetrahedra)


def test_a_flat_tetrahedron_is_named() -> None:
    a, b, c, d = BLOCK.tetrahedra[0]
    middle = BLOCK.rest_position_m[[b, c, d]].mean(axis=0)
    with pytest.raises(MeshError, match=r"block\.msh: tetrahedron \d+ .* is (degenerate|inverted)"):
        replace(BLOCK, rest_position_m=with_position(int(a), middle.tolist()))


def test_a_node_in_no_tetrahedron_is_named() -> None:
    def longer(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
        return np.append(mask, False)

    positions = np.concatenate([BLOCK.rest_position_m, [[0.001, 0.001, 0.001]]])
    with pytest.raises(MeshError, match=r"block\.msh: node 27 at .* belongs to no tetrahedron"):
        GelMesh(
            rest_position_m=positions,
            tetrahedra=BLOCK.tetrahedra,
            driven=longer(BLOCK.driven),
            sensing=longer(BLOCK.sensing),
            name=BLOCK.name,
        )


@pytest.mark.parametrize(("mask", "message"), [("driven", "no node is driven"), ("sensing", "no node is sensing")])
def test_a_mesh_without_driven_or_sensing_nodes_is_refused(mask: str, message: str) -> None:
    with pytest.raises(MeshError, match=message):
        replace(BLOCK, **{mask: np.zeros(len(BLOCK.driven), dtype=bool)})  # type: ignore[arg-type]


def test_a_mesh_without_free_nodes_is_refused() -> None:
    with pytest.raises(MeshError, match="all 27 nodes are driven"):
        replace(BLOCK, driven=np.ones(len(BLOCK.driven), dtype=bool))


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_position_that_is_not_finite_is_named(value: float) -> None:
    with pytest.raises(MeshError, match=r"block\.msh: node 5 has the non-finite position"):
        replace(BLOCK, rest_position_m=with_position(5, [0.0, value, 0.0]))


def test_millimetres_are_recognised() -> None:
    with pytest.raises(MeshError, match=r"block\.msh: the mesh is 6 m large, .* millimetres"):
        replace(BLOCK, rest_position_m=BLOCK.rest_position_m * 1e3)
    with pytest.raises(MeshError, match=r"box\.stl: the mesh is 10 m large"):
        replace(BOX, vertices_m=BOX.vertices_m * 1e3)


def test_an_index_out_of_range_is_named() -> None:
    tetrahedra = BLOCK.tetrahedra.copy()
    tetrahedra[3, 2] = 99
    with pytest.raises(MeshError, match=r"block\.msh: tetrahedron 3 names the nodes .*99"):
        replace(BLOCK, tetrahedra=tetrahedra)


def test_an_open_or_inside_out_surface_is_refused() -> None:
    with pytest.raises(MeshError, match=r"box\.stl: the surface is open at the edge"):
        replace(BOX, triangles=BOX.triangles[1:])
    with pytest.raises(MeshError, match="counter-clockwise"):
        replace(BOX, triangles=BOX.triangles[:, ::-1].copy())


def overlapping(offset_m: float, *, size_m: float = 0.01) -> Scene:
    gel = GelBody(mesh=BLOCK, rotation=IDENTITY, translation_m=np.zeros(3))
    mesh = box_surface((size_m, size_m, size_m), name="box.stl")
    place = np.array([0.0031, 0.0022, offset_m])
    return Scene(gels=[gel], bodies=[RigidBody(mesh=mesh, rotation=IDENTITY, translation_m=place)], time_step_s=0.1)


def test_bodies_that_cross_at_the_start_are_refused_by_name() -> None:
    overlapping(0.0041)
    with pytest.raises(SceneError, match=r"block\.msh \(body 0\) and box\.stl \(body 1\) overlap at the start"):
        overlapping(0.0039)


def test_a_body_inside_another_is_refused() -> None:
    with pytest.raises(SceneError, match="one lies inside the other"):
        overlapping(0.0017, size_m=0.0006)


@pytest.mark.parametrize("cells", [(1, 1, 1), (2, 2, 2), (3, 1, 2)])
def test_volumes_and_gradients_are_those_of_the_box(cells: tuple[int, int, int]) -> None:
    gel = box_gel((0.006, 0.005, 0.004), cells, jitter=0.2)
    assert gel.volumes_m3.sum() == pytest.approx(0.006 * 0.005 * 0.004)
    assert (gel.volumes_m3 > 0.0).all()
    gradients, corners = gel.rest_gradients_1_m, gel.rest_position_m[gel.tetrahedra]
    assert gradients.sum(axis=1) == pytest.approx(0.0, abs=1e-6)
    # A linear field x -> A x is read back exactly from its values at the corners.
    field = np.random.default_rng(1).uniform(-1.0, 1.0, (3, 3))
    read = np.einsum("tai,taj->tij", corners @ field.T, gradients)
    assert read == pytest.approx(np.broadcast_to(field, read.shape))


@pytest.mark.parametrize(("cells", "faces"), [((1, 1, 1), 12), ((2, 2, 2), 48), ((3, 2, 1), 44)])
def test_the_surface_of_a_gel_is_closed_and_looks_outwards(cells: tuple[int, int, int], faces: int) -> None:
    gel = box_gel((0.006, 0.005, 0.004), cells)
    positions, triangles = gel.surface
    assert len(triangles) == faces
    closed = SurfaceMesh(vertices_m=positions, triangles=triangles, name="surface")
    assert closed.volume_m3 == pytest.approx(0.006 * 0.005 * 0.004)
    assert len(gel.surface_edges) == 3 * faces // 2
    assert len(positions) == 2 + faces // 2
    assert gel.rest_position_m[gel.surface_triangles].tolist() == positions[triangles].tolist()


def test_driven_and_sensing_nodes_are_listed_in_order() -> None:
    assert BLOCK.driven_nodes.tolist() == np.flatnonzero(BLOCK.rest_position_m[:, 2] == 0.0).tolist()
    assert BLOCK.rest_position_m[BLOCK.sensing_nodes, 2] == pytest.approx(0.004)


def test_moments_of_a_box_are_exact_wherever_it_stands() -> None:
    size, low = np.array([0.01, 0.02, 0.03]), np.array([0.1, -0.05, 0.02])
    volume, first, second = box_surface(size, low).moments
    centre = low + size / 2.0
    assert volume == pytest.approx(size.prod())
    assert first == pytest.approx(volume * centre)
    assert second == pytest.approx(volume * (np.outer(centre, centre) + np.diag(size**2) / 12.0))


def test_edges_are_listed_once_in_order() -> None:
    triangles = np.array([[2, 1, 0], [1, 2, 3]])
    assert unique_edges(triangles).tolist() == [[0, 1], [0, 2], [1, 2], [1, 3], [2, 3]]
    assert len(BOX.edges) == 18


def test_a_tetrahedron_has_a_sixth_of_the_volume_of_its_edges() -> None:
    corners = np.array([[[0.0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 4]]])
    assert signed_volumes_m3(corners).tolist() == [4.0]
    assert signed_volumes_m3(corners[:, [1, 0, 2, 3]]).tolist() == [-4.0]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rest_position_m": BLOCK.rest_position_m[:, :2]}, r"positions have shape \(27, 2\) and type float64"),
        ({"rest_position_m": BLOCK.rest_position_m.astype(np.float32)}, "type float32, expected float64"),
        ({"rest_position_m": BLOCK.rest_position_m[:3]}, r"positions have shape \(3, 3\)"),
        ({"rest_position_m": BLOCK.rest_position_m * 1e-3}, "are its coordinates in kilometres or another unit"),
        ({"tetrahedra": BLOCK.tetrahedra[:0]}, r"the tetrahedron array has shape \(0, 4\)"),
        ({"tetrahedra": BLOCK.tetrahedra[:, :3]}, r"the tetrahedron array has shape \(48, 3\)"),
        ({"tetrahedra": BLOCK.tetrahedra.astype(np.int32)}, "type int32, expected int64"),
        ({"tetrahedra": BLOCK.tetrahedra - 1}, r"tetrahedron \d+ names the nodes .*-1"),
        ({"tetrahedra": BLOCK.tetrahedra[:, [0, 1, 2, 2]]}, "tetrahedron 0 names a node twice"),
        ({"driven": BLOCK.driven[:5]}, r"the driven mask has shape \(5,\) and type bool, expected one boolean"),
        ({"sensing": BLOCK.sensing.astype(int)}, r"the sensing mask has shape \(27,\) and type int64"),
    ],
)
def test_an_array_of_another_form_is_told(changes: dict[str, NDArray[Any]], message: str) -> None:
    with pytest.raises(MeshError, match=rf"^block\.msh: .*{message}"):
        replace(BLOCK, **changes)  # type: ignore[arg-type]


def test_a_triangle_without_an_area_is_named() -> None:
    vertices = BOX.vertices_m.copy()
    vertices[1] = vertices[0] + 1e-12
    with pytest.raises(MeshError, match=r"box\.stl: triangle \d+ .* is degenerate: area .*; remove it or merge"):
        replace(BOX, vertices_m=vertices)
