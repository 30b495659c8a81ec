"""Base with two holes and two garages: measures, clearance, and agreement with the challenge's own files."""

from pathlib import Path

import numpy as np
import pytest
from polygon_area import signed_area
from vitac.envs.fem.model.mesh import SurfaceMesh, unique_edges
from vitac.envs.geometry.bases import (
    ClearanceOutOfRange,
    base_surface,
    hexagon_bottom_vertices,
    hexagon_peg_surface,
    hole_outlines_mm,
    regular_hexagon_mm,
)
from vitac.envs.geometry.stl import read_stl

# The files hold rounded millimetres, the ASCII one with fewer digits.
STL_TOLERANCE_M = 1e-7


def is_vertex(surface: SurfaceMesh, x_mm: float, y_mm: float, z_mm: float) -> bool:
    apart = np.abs(surface.vertices_m * 1e3 - [x_mm, y_mm, z_mm]).max(axis=1)
    return bool(apart.min() < 1e-4)


# The file with 1 mm clearance has its origin in the lower corner of the plate; 0.5 and 1.5 mm are not closed.
@pytest.mark.parametrize(("clearance_mm", "origin_mm"), [(2.0, (0.0, 0.0, 0.0)), (1.0, (92.5, 22.5, 2.5))])
def test_base_is_the_challenges(
    clearance_mm: float, origin_mm: tuple[float, float, float], reference_dir: Path
) -> None:
    ours = base_surface(clearance_mm)
    path = reference_dir / "assets" / "track2" / "peg_in_hole" / f"sim_hole_base_{clearance_mm:.1f}mm.STL"
    theirs = read_stl(path)
    shifted_m = theirs.vertices_m - np.array(origin_mm) * 1e-3
    assert (len(ours.vertices_m), len(ours.triangles)) == (len(theirs.vertices_m), len(theirs.triangles))
    apart_m = np.abs(ours.vertices_m[:, None] - shifted_m[None]).max(axis=2)
    assert apart_m.min(axis=0).max() < STL_TOLERANCE_M
    assert apart_m.min(axis=1).max() < STL_TOLERANCE_M
    assert ours.volume_m3 == pytest.approx(theirs.volume_m3, rel=1e-6)


def test_base_has_the_stated_tessellation_and_volume() -> None:
    base = base_surface()
    assert (len(base.vertices_m), len(base.triangles)) == (76, 148)
    assert base.volume_m3 * 1e9 == pytest.approx(90309.6, abs=0.3)
    # Blind holes and pockets make no handle.
    assert len(base.vertices_m) - len(unique_edges(base.triangles)) + len(base.triangles) == 2


@pytest.mark.parametrize("clearance_mm", [0.5, 1.0, 1.5, 2.0, 7.4])
def test_clearance_only_changes_the_holes(clearance_mm: float) -> None:
    rectangular, hexagonal = hole_outlines_mm(clearance_mm)
    removed_mm3 = 13.0 * (signed_area(rectangular) + signed_area(hexagonal))
    reference = sum(signed_area(outline) for outline in hole_outlines_mm(2.0)) * 13.0
    gained_mm3 = (base_surface(clearance_mm).volume_m3 - base_surface(2.0).volume_m3) * 1e9
    assert gained_mm3 == pytest.approx(reference - removed_mm3, abs=1e-6)


def test_official_holes_are_44_by_34_and_17_to_the_flats() -> None:
    base = base_surface()
    for x_mm, y_mm in ((22.0, 17.0), (-22.0, -17.0), (19.6299, 45.25), (9.81495, 62.25)):
        assert is_vertex(base, x_mm, y_mm, 17.4)
        assert is_vertex(base, x_mm, y_mm, 4.4)


def test_garages_taper_from_the_pegs_to_the_blocks_rims() -> None:
    base = base_surface()
    for x_mm, y_mm, z_mm in ((-75.0, -15.0, 0.0), (-82.5, -22.5, 17.0), (-37.6795, 45.25, 0.0), (-29.308, 45.25, 17.0)):
        assert is_vertex(base, x_mm, y_mm, z_mm)


@pytest.mark.parametrize("clearance_mm", [0.0, -1.0, 7.5, float("nan")])
def test_refuses_a_clearance_that_leaves_no_gap_or_no_wall(clearance_mm: float) -> None:
    with pytest.raises(ClearanceOutOfRange, match=r"expected more than 0 and less than 7\.5 mm"):
        base_surface(clearance_mm)


def test_flats_lie_at_the_apothem_and_corners_on_the_axis() -> None:
    hexagon = regular_hexagon_mm((3.0, -2.0), 15.0)
    following = np.roll(hexagon, -1, axis=0)
    middles = (hexagon + following) / 2.0 - [3.0, -2.0]
    assert np.hypot(*middles.T) == pytest.approx(np.full(6, 15.0))
    assert hexagon[0] == pytest.approx([3.0 + 17.320508, -2.0])
    assert signed_area(hexagon) == pytest.approx(2.0 * np.sqrt(3.0) * 15.0**2)


def test_peg_reaches_to_17_mm_and_is_30_mm_wide() -> None:
    low, high = hexagon_peg_surface().vertices_m.min(axis=0), hexagon_peg_surface().vertices_m.max(axis=0)
    assert low * 1e3 == pytest.approx([-17.641016, -15.0, 0.0])
    assert high * 1e3 == pytest.approx([17.0, 15.0, 50.0])
    assert hexagon_peg_surface().volume_m3 * 1e9 == pytest.approx(38971.14, abs=0.01)


def test_bottom_vertices_follow_the_order_of_the_logs() -> None:
    peg = hexagon_peg_surface()
    corners_mm = peg.vertices_m[hexagon_bottom_vertices(peg)] * 1e3
    order = [(-8.9808, -15), (-17.641, 0), (8.3397, -15), (17, 0), (8.3397, 15), (-8.9808, 15)]
    assert corners_mm[:, :2] == pytest.approx(np.array(order), abs=1e-4)
    assert (corners_mm[:, 2] == 0).all()


def test_peg_is_the_challenges(reference_dir: Path) -> None:
    ours = hexagon_peg_surface()
    theirs = read_stl(reference_dir / "assets" / "track2" / "peg_in_hole" / "hexagon_peg.STL")
    assert (len(ours.vertices_m), len(ours.triangles)) == (len(theirs.vertices_m), len(theirs.triangles))
    apart_m = np.abs(ours.vertices_m[:, None] - theirs.vertices_m[None]).max(axis=2)
    assert apart_m.min(axis=0).max() < 1e-8
    assert apart_m.min(axis=1).max() < 1e-8
    order = theirs.vertices_m[hexagon_bottom_vertices(theirs)]
    assert order == pytest.approx(ours.vertices_m[hexagon_bottom_vertices(ours)], abs=1e-8)
