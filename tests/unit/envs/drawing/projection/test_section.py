import numpy as np
import pytest
from polygon_area import signed_area
from vitac.envs.drawing.projection.section import section_loops_m
from vitac.envs.geometry.keys import KeyShape
from vitac.envs.geometry.locks import lock_surface
from vitac.envs.geometry.pegs import PegShape, hole_surface, peg_surface
from vitac.envs.scene.perspective import Plane

HALF_WAY_UP = Plane(normal=(0.0, 0.0, 1.0), offset_m=10e-3)


def areas_mm2(loops: list[np.ndarray], *axes: int) -> list[float]:
    return sorted(1e6 * signed_area(loop[:, axes]) for loop in loops)


def test_section_of_a_peg_is_its_profile() -> None:
    peg = peg_surface(PegShape.TRAPEZOID)
    (loop,) = section_loops_m(peg.vertices_m, peg.triangles, HALF_WAY_UP)
    assert areas_mm2([loop], 0, 1) == pytest.approx([900.0])
    assert loop[:, 2] == pytest.approx(10e-3)


@pytest.mark.parametrize("shape", list(PegShape))
def test_a_hole_turns_the_other_way_than_its_plate(shape: PegShape) -> None:
    plate = hole_surface(shape)
    hole, outline = areas_mm2(section_loops_m(plate.vertices_m, plate.triangles, HALF_WAY_UP), 0, 1)
    assert outline == pytest.approx(70 * 50)
    assert hole < 0
    assert outline + hole == pytest.approx(plate.volume_m3 * 1e9 / 20)


def test_upright_section_of_a_lock_shows_block_and_bridges() -> None:
    lock = lock_surface(KeyShape.KEY1)
    along = Plane(normal=(0.0, -1.0, 0.0), offset_m=0.0)
    found = areas_mm2(section_loops_m(lock.vertices_m, lock.triangles, along), 0, 2)
    # C-shaped block with the first piece of the ceiling, and the two pieces between and behind the slots.
    assert found == pytest.approx([7 * 10, 8 * 10, 5 * 40 + 41 * 10 + 10 * 10])


def test_plane_beside_a_solid_cuts_nothing() -> None:
    peg = peg_surface(PegShape.CUBOID)
    assert section_loops_m(peg.vertices_m, peg.triangles, Plane(normal=(0.0, 0.0, 1.0), offset_m=0.06)) == []


def test_plane_through_vertices_still_gives_closed_outlines() -> None:
    peg = peg_surface(PegShape.CUBOID)
    diagonal = Plane(normal=(0.6, -0.8, 0.0), offset_m=0.0)
    corner_on_it = Plane(normal=(0.6, -0.8, 0.0), offset_m=0.6 * 20e-3 - 0.8 * 15e-3)
    for plane in (diagonal, corner_on_it):
        (loop,) = section_loops_m(peg.vertices_m, peg.triangles, plane)
        assert plane.heights_m(loop) == pytest.approx(0.0, abs=1e-15)
