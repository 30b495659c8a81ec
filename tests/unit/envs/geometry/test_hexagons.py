"""Hexagon of the fusion task: measures, corner order, and agreement with the challenge's own peg."""

from pathlib import Path

import numpy as np
import pytest
from polygon_area import signed_area
from vitac.envs.geometry.hexagons import hexagon_bottom_vertices, hexagon_peg_surface, regular_hexagon_mm
from vitac.envs.geometry.stl import read_stl


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
