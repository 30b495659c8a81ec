"""Meshes and scenes that cannot be simulated are refused by name, element and value."""

from dataclasses import replace

import numpy as np
import pytest
from block_meshes import box_gel, box_surface
from numpy.typing import NDArray
from small_scenes import IDENTITY
from vitac.envs.fem.model.bodies import GelBody, RigidBody
from vitac.envs.fem.model.mesh import GelMesh, MeshError
from vitac.envs.fem.scene.checks import SceneError
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
