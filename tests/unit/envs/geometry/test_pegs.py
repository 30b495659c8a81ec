"""Profiles, solids and measured corners of the pegs and of the plates with their holes."""

from collections.abc import Callable
from math import sqrt

import numpy as np
import pytest
from polygon_area import signed_area
from vitac.envs.geometry.pegs import (
    BOTTOM_CORNERS_MM,
    CLEARANCE_MM,
    GRIPPED_WIDTH_MM,
    PEG_HEIGHT_MM,
    PLATE_THICKNESS_MM,
    PROFILES_MM,
    PegForm,
    PegShape,
    bottom_vertices,
    hole_outline_mm,
    hole_surface,
    peg_surface,
    profile_mm,
)
from vitac.envs.geometry.solid import contains

# Smallest and largest width, taper, bulge, slant and clearance of `peg-insertion-robust`.
RANGES = ([0.85, -0.2, -0.2, -2.0, 0.5], [1.1, 0.2, 0.2, 2.0, 2.0])
EACH = pytest.mark.parametrize("shape", PegShape)
# Twice the half width at y [mm], from the drawings.
WIDTHS_MM: dict[PegShape, Callable[[float], float]] = {
    PegShape.CUBOID: lambda _: 40.0,
    PegShape.TRAPEZOID: lambda y: 20.0 + 20.0 * (y + 15.0) / 30.0,
    PegShape.CONCAVE1: lambda y: 2.0 * (17.5 - (10.0 - max(abs(y) - 5.0, 0.0)) / sqrt(3.0)),
}


@EACH
def test_a_profile_is_counter_clockwise_and_fills_the_gap_between_the_gels(shape: PegShape) -> None:
    profile = PROFILES_MM[shape]
    assert signed_area(profile) > 0.0
    assert np.ptp(profile[:, 1]) == GRIPPED_WIDTH_MM
    assert profile[:, 1].min() == -profile[:, 1].max()


@EACH
@pytest.mark.parametrize("y_mm", [-14.5, -7.0, -4.5, 0.0, 2.5, 9.0, 14.5])
def test_a_profile_is_as_wide_as_drawn(shape: PegShape, y_mm: float) -> None:
    half = WIDTHS_MM[shape](y_mm) / 2.0
    profile = PROFILES_MM[shape]
    for side in (-1.0, 1.0):
        assert contains(profile, np.array([side * (half - 1e-6), y_mm]))
        assert not contains(profile, np.array([side * (half + 1e-6), y_mm]))


@EACH
def test_measured_corners_are_the_profiles_in_the_logs_order(shape: PegShape) -> None:
    corners = sorted(map(tuple, BOTTOM_CORNERS_MM[shape].tolist()))
    assert corners == sorted(map(tuple, PROFILES_MM[shape].tolist()))
    assert len(set(corners)) == len(corners)


@EACH
def test_a_hole_leaves_the_clearance_on_every_side(shape: PegShape) -> None:
    profile, hole = PROFILES_MM[shape], hole_outline_mm(shape)
    assert len(hole) == len(profile)
    for k in range(len(profile)):
        along = profile[(k + 1) % len(profile)] - profile[k]
        outwards = np.array([along[1], -along[0]]) / np.hypot(*along)
        assert (hole[k] - profile[k]) @ outwards == pytest.approx(CLEARANCE_MM)
        assert (hole[(k + 1) % len(hole)] - profile[k]) @ outwards == pytest.approx(CLEARANCE_MM)


@EACH
def test_solids_stand_between_their_heights(shape: PegShape) -> None:
    peg, plate = peg_surface(shape).vertices_m * 1e3, hole_surface(shape).vertices_m * 1e3
    assert sorted(set(peg[:, 2].round(9).tolist())) == [0.0, PEG_HEIGHT_MM]
    assert sorted(set(plate[:, 2].round(9).tolist())) == [0.0, PLATE_THICKNESS_MM]
    assert np.abs(plate[:, :2]).max(axis=0).tolist() == [35.0, 25.0]


@EACH
def test_volumes_are_those_of_their_profiles(shape: PegShape) -> None:
    area, hole_area = signed_area(PROFILES_MM[shape]), signed_area(hole_outline_mm(shape))
    assert peg_surface(shape).volume_m3 * 1e9 == pytest.approx(area * PEG_HEIGHT_MM)
    assert hole_surface(shape).volume_m3 * 1e9 == pytest.approx((70.0 * 50.0 - hole_area) * PLATE_THICKNESS_MM)


@EACH
def test_a_solid_is_made_once(shape: PegShape) -> None:
    assert peg_surface(shape) is peg_surface(shape)
    assert hole_surface(shape) is hole_surface(shape)
    assert peg_surface(shape).name == f"{shape} peg"
    assert hole_surface(shape).name == f"{shape} hole"


@EACH
def test_a_form_scales_across_the_gels_alone_and_leaves_its_clearance(shape: PegShape) -> None:
    form = PegForm(width=0.9, taper=0.2, clearance_mm=0.5)
    profile, wider = profile_mm(shape, form), PROFILES_MM[shape]
    assert np.array_equal(profile[:, 1], wider[:, 1])
    for (x, y), before in zip(profile.tolist(), wider[:, 0].tolist(), strict=True):
        assert x == pytest.approx(before * (0.9 + 0.2 * y / 15.0))
    hole = hole_outline_mm(shape, form)
    assert hole[:, 1].max() == pytest.approx(15.5)
    peg = peg_surface(shape, form)
    corners_mm = peg.vertices_m[bottom_vertices(shape, peg, form)] * 1e3
    assert np.array_equal(np.round(corners_mm[:, :2], 9), np.round(form.scaled(BOTTOM_CORNERS_MM[shape]), 9))


@EACH
def test_a_bulge_and_a_slant_make_outlines_that_the_challenge_does_not_have(shape: PegShape) -> None:
    form = PegForm(bulge=0.2, slant_mm=1.5, clearance_mm=0.5)
    profile = profile_mm(shape, form)
    assert sorted(profile[:, 1].tolist()) == [y for y in (-15.0, -5.0, 5.0, 15.0) for _ in range(2)]
    half = WIDTHS_MM[shape]
    for x, y in profile.tolist():
        side = 1.0 if x > 0 else -1.0
        assert x == pytest.approx(side * half(y) / 2.0 * (1.2 if abs(y) < 10.0 else 1.0) + 1.5 * y / 15.0)
    peg = peg_surface(shape, form)
    corners_mm = peg.vertices_m[bottom_vertices(shape, peg, form)] * 1e3
    assert sorted(map(tuple, corners_mm[:, :2].round(9))) == sorted(map(tuple, profile.round(9)))
    assert np.abs(hole_surface(shape, form).vertices_m[:, :2] * 1e3).max(axis=0).tolist() == [35.0, 25.0]


@EACH
@pytest.mark.parametrize("seed", range(3))
def test_forms_within_the_ranges_of_the_variant_are_outlines_with_eight_corners(shape: PegShape, seed: int) -> None:
    random = np.random.default_rng(seed)
    for _ in range(20):
        width, taper, bulge, slant, clearance = random.uniform(*RANGES).tolist()
        form = PegForm(width=width, taper=taper, bulge=bulge, slant_mm=slant, clearance_mm=clearance)
        profile, hole = profile_mm(shape, form), hole_outline_mm(shape, form)
        assert (len(profile), len(hole)) == (8, 8)
        assert 0.0 < signed_area(profile) < signed_area(hole)
        assert all(contains(hole, corner) for corner in profile)


@EACH
def test_the_challenges_form_changes_no_bit(shape: PegShape) -> None:
    assert np.array_equal(profile_mm(shape), PROFILES_MM[shape])
