import numpy as np
import pytest
from polygon_area import signed_area
from vitac.envs.drawing.projection import ParallelCamera, section_loops_m
from vitac.envs.geometry.keys_and_locks import KeyShape, lock_surface
from vitac.envs.geometry.pegs import PegShape, hole_surface, peg_surface
from vitac.envs.scene.perspective import Plane


def camera(azimuth_deg: float = -38.0, elevation_deg: float = 24.0) -> ParallelCamera:
    return ParallelCamera(
        azimuth_deg=azimuth_deg,
        elevation_deg=elevation_deg,
        centre_m=(0.01, -0.02, 0.03),
        height_m=0.1,
        width_px=80,
        height_px=50,
    )


@pytest.mark.parametrize("azimuth_deg", [-90.0, 0.0, 33.0, 170.0])
@pytest.mark.parametrize("elevation_deg", [-20.0, 0.0, 60.0])
def test_axes_are_a_frame_with_the_world_s_z_upwards(azimuth_deg: float, elevation_deg: float) -> None:
    axes = camera(azimuth_deg, elevation_deg).axes
    assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-15)
    right, up, away = axes
    assert np.cross(right, up) == pytest.approx(-away)
    assert right[2] == 0.0
    assert up[2] > 0.0


def test_centre_is_in_the_middle_at_depth_zero() -> None:
    assert camera().project(np.array([0.01, -0.02, 0.03])) == pytest.approx([40.0, 25.0, 0.0])


def test_seen_from_the_front_x_is_right_z_up_and_y_away() -> None:
    from_front = camera(azimuth_deg=-90.0, elevation_deg=0.0)
    start = np.array([0.01, -0.02, 0.03])
    for step, expected in ((np.array([0.01, 0, 0]), (5, 0, 0)), (np.array([0, 0, 0.01]), (0, -5, 0))):
        assert from_front.project(start + step) == pytest.approx([40 + expected[0], 25 + expected[1], 0], abs=1e-12)
    assert from_front.project(start + np.array([0, 0.01, 0])) == pytest.approx([40, 25, 0.01])


def test_depth_of_a_plane_is_that_of_its_points() -> None:
    plane = Plane(normal=(0.6, -0.8, 0.0), offset_m=0.004)
    depths_m = camera().plane_depths_m(plane)
    assert depths_m.shape == (50, 80)
    points = np.random.default_rng(0).uniform(-0.02, 0.02, (200, 3))
    on_plane = points - plane.heights_m(points)[:, None] * np.array(plane.normal)
    seen = camera().project(on_plane)
    inside = ((seen[:, :2] > 1) & (seen[:, :2] < (79, 49))).all(axis=1)
    assert inside.sum() > 50
    column, row = np.floor(seen[inside, :2]).astype(int).T
    slope_per_px = np.abs(np.diff(depths_m, axis=1)).max() + np.abs(np.diff(depths_m, axis=0)).max()
    assert np.abs(depths_m[row, column] - seen[inside, 2]).max() <= 0.5 * slope_per_px


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
