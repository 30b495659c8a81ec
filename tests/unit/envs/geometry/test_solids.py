"""Generated pegs, plates, keys and locks: counts, volumes, and agreement with the challenge's own STL files."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from vitac.envs.fem.model.mesh import SurfaceMesh, unique_edges
from vitac.envs.geometry.keys_and_locks import (
    LOCKS,
    KeyShape,
    key_control_points,
    key_surface,
    lock_surface,
)
from vitac.envs.geometry.pegs import (
    BOTTOM_CORNERS_MM,
    PegShape,
    bottom_vertices,
    hole_surface,
    peg_surface,
)
from vitac.envs.geometry.stl import read_stl

CUBIC_MILLIMETRE_M3 = 1e-9
# The STL files hold float32 millimetres of up to 91.
STL_TOLERANCE_M = 1e-8

PAIRS: list[tuple[str, Callable[[], SurfaceMesh]]] = [
    *((f"peg_in_hole/{shape}_peg.STL", partial(peg_surface, shape)) for shape in PegShape),
    *((f"peg_in_hole/{shape}_hole_1.5mm.STL", partial(hole_surface, shape)) for shape in PegShape),
    *((f"key_lock/{shape}.STL", partial(key_surface, shape)) for shape in KeyShape),
    *((f"key_lock/lock_core_sim{i}.STL", partial(lock_surface, shape)) for i, shape in enumerate(KeyShape, 1)),
]


def contains_all(points: np.ndarray, among: np.ndarray) -> bool:
    apart = np.abs(points[:, None, :] - among[None, :, :]).max(axis=2)
    return bool((apart.min(axis=1) < STL_TOLERANCE_M).all())


@pytest.mark.parametrize(("path", "generate"), PAIRS, ids=[path for path, _ in PAIRS])
def test_generated_solid_is_the_challenges(path: str, generate: Callable[[], SurfaceMesh], reference_dir: Path) -> None:
    ours, theirs = generate(), read_stl(reference_dir / "assets" / "track1" / path)
    assert (len(ours.vertices_m), len(ours.triangles)) == (len(theirs.vertices_m), len(theirs.triangles))
    assert contains_all(ours.vertices_m, theirs.vertices_m)
    assert contains_all(theirs.vertices_m, ours.vertices_m)
    assert ours.volume_m3 == pytest.approx(theirs.volume_m3, rel=1e-6)
    assert ours.vertices_m.min(axis=0) == pytest.approx(theirs.vertices_m.min(axis=0), abs=STL_TOLERANCE_M)
    assert ours.vertices_m.max(axis=0) == pytest.approx(theirs.vertices_m.max(axis=0), abs=STL_TOLERANCE_M)


@pytest.mark.parametrize(
    ("shape", "vertices", "triangles", "volume_mm3"),
    [(PegShape.CUBOID, 8, 12, 60000), (PegShape.TRAPEZOID, 8, 12, 45000), (PegShape.CONCAVE1, 16, 28, 40953)],
)
def test_peg_has_the_stated_tessellation_and_volume(
    shape: PegShape, vertices: int, triangles: int, volume_mm3: float
) -> None:
    peg = peg_surface(shape)
    assert (len(peg.vertices_m), len(peg.triangles)) == (vertices, triangles)
    assert peg.volume_m3 / CUBIC_MILLIMETRE_M3 == pytest.approx(volume_mm3, abs=0.5)


@pytest.mark.parametrize(
    ("shape", "vertices", "triangles"),
    [(PegShape.CUBOID, 16, 32), (PegShape.TRAPEZOID, 16, 32), (PegShape.CONCAVE1, 24, 48)],
)
def test_plate_with_hole_has_the_stated_tessellation(shape: PegShape, vertices: int, triangles: int) -> None:
    hole = hole_surface(shape)
    assert (len(hole.vertices_m), len(hole.triangles)) == (vertices, triangles)
    # One through hole: Euler characteristic 2 - 2 * 1.
    assert vertices - len(unique_edges(hole.triangles)) + triangles == 0


@pytest.mark.parametrize("shape", PegShape)
def test_bottom_vertices_follow_the_order_of_the_logs(shape: PegShape) -> None:
    peg = peg_surface(shape)
    corners_mm = peg.vertices_m[bottom_vertices(shape, peg)] * 1e3
    assert corners_mm[:, :2] == pytest.approx(BOTTOM_CORNERS_MM[shape])
    assert (corners_mm[:, 2] == 0).all()
    assert len(set(bottom_vertices(shape, peg).tolist())) == len(BOTTOM_CORNERS_MM[shape])


@pytest.mark.parametrize("shape", KeyShape)
def test_lock_volume_is_the_block_less_channel_and_slots(shape: KeyShape) -> None:
    lock = LOCKS[shape]
    slots = sum(high - low for low, high in lock.slots_mm)
    expected = lock.length_mm * 40 * 40 - (lock.length_mm - 5) * 8 * 20 - slots * 8 * 10
    surface = lock_surface(shape)
    assert surface.volume_m3 / CUBIC_MILLIMETRE_M3 == pytest.approx(expected)
    # Every slot joins the channel to the top face: one handle each.
    euler = len(surface.vertices_m) - len(unique_edges(surface.triangles)) + len(surface.triangles)
    assert euler == 2 - 2 * len(lock.slots_mm)


def test_key4_measures_its_second_and_third_tooth() -> None:
    points = key_control_points(KeyShape.KEY4)
    assert sorted(set((points.front_tooth_m[:, 0] * 1e3).round(6))) == [20.0, 24.0]
    assert sorted(set((points.rear_tooth_m[:, 0] * 1e3).round(6))) == [36.0, 40.0]
