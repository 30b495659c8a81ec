"""Seven pegs and their holes beside corners and volumes as they were measured in the files of 2024."""

import numpy as np
import pytest
import trimesh
from polygon_area import signed_area
from vitac.envs.fem.model.mesh import SurfaceMesh
from vitac.envs.geometry import pegs
from vitac.envs.geometry.pegs_2024 import (
    CLEARANCES_MM,
    PegShape2024,
    bottom_vertices_2024,
    hole_outline_mm,
    hole_surface,
    peg_surface,
    plate_outline_mm,
    profile_mm,
)

S = PegShape2024
VOLUMES_MM3 = {
    S.CONCAVE1: 40953.0, S.CONCAVE2: 48250.0, S.CONVEX: 53000.0, S.CUBOID: 60000.0, S.HEXAGON: 38971.1,
    S.OCTAGON: 37279.2, S.TRAPEZOID: 45000.0,
}  # fmt: skip
CONCAVE2_RIGHT = [(16.20156, -17.5), (26.08027, -5.15162), (11.35672, 17.5), (-10.90513, 17.5), (-25.90513, 5.0)]
HOLES_MM = {
    (S.CONCAVE2, 0.5): [*CONCAVE2_RIGHT, (-16.80902, -17.5), (-11.54317, -6.9683)],
    (S.CONCAVE2, 1.0): [*CONCAVE2_RIGHT, (-17.368, -17.5), (-11.9378, -6.6395)],
    (S.CONCAVE2, 1.5): [*CONCAVE2_RIGHT, (-17.927, -17.5), (-12.3324, -6.3106)],
    (S.CONCAVE2, 2.5): [*CONCAVE2_RIGHT, (-19.04508, -17.5), (-13.12157, -5.65296)],
    (S.CONVEX, 0.5): [
        (-10.20711, 15.5), (-22.53222, -5.11158), (-20.4606, 5.24651), (10.15139, 15.5), (25.64461, 5.17119),
        (15.30902, -15.5), (-15.26033, -15.5),
    ],
    (S.CONVEX, 1.5): [
        (-23.5967, -5.3347), (-21.3818, 5.7395), (-10.6213, 16.5), (10.4542, 16.5), (26.9338, 5.5136),
        (15.9271, -16.5), (-15.781, -16.5),
    ],
    (S.CONVEX, 2.5): [
        (-22.303, 6.23253), (-24.66109, -5.55792), (-11.03553, 17.5), (10.75694, 17.5), (28.22305, 5.85593),
        (16.54509, -17.5), (-16.30164, -17.5),
    ],
    (S.HEXAGON, 0.5): [
        (17.89786, 0.0), (8.94893, -15.5), (-8.94893, -15.5), (-17.89786, 0.0), (-8.94893, 15.5), (8.94893, 15.5),
    ],
    (S.HEXAGON, 1.5): [
        (sx * x, sy * y) for x, y in ((19.0526, 0.0), (9.5263, 16.5)) for sx in (-1, 1) for sy in (-1, 1)
    ],
    (S.OCTAGON, 1.5): [
        (sx * x, sy * y) for x, y in ((16.5, 6.8345), (6.8345, 16.5)) for sx in (-1, 1) for sy in (-1, 1)
    ],
    (S.CUBOID, 2.0): [(-22.0, -17.0), (22.0, -17.0), (22.0, 17.0), (-22.0, 17.0)],
    (S.TRAPEZOID, 2.0): [(-11.4415, -17.0), (11.4415, -17.0), (22.77485, 17.0), (-22.77485, 17.0)],
    (S.CONCAVE1, 2.0): [
        (sx * x, sy * y) for x, y in ((20.9641, 17.0), (13.7265, 4.4641)) for sx in (-1, 1) for sy in (-1, 1)
    ],
}  # fmt: skip


def in_order(corners: object) -> list[tuple[float, float]]:
    return sorted({(round(float(x), 3) + 0.0, round(float(y), 3) + 0.0) for x, y in np.asarray(corners)})


def volume_mm3(surface: SurfaceMesh) -> float:
    solid = trimesh.Trimesh(surface.vertices_m * 1e3, surface.triangles)
    assert solid.is_watertight
    assert solid.is_winding_consistent
    return float(solid.volume)


@pytest.mark.parametrize(("shape", "clearance_mm"), HOLES_MM)
def test_hole_has_the_corners_of_the_file(shape: PegShape2024, clearance_mm: float) -> None:
    ours = in_order(hole_outline_mm(shape, clearance_mm))
    assert np.allclose(ours, in_order(HOLES_MM[shape, clearance_mm]), atol=1.01e-3)


@pytest.mark.parametrize("shape", PegShape2024)
def test_peg_has_the_volume_of_the_file_and_width_and_height_of_all(shape: PegShape2024) -> None:
    surface = peg_surface(shape)
    assert volume_mm3(surface) == pytest.approx(VOLUMES_MM3[shape], abs=0.5)
    assert np.allclose(np.ptp(surface.vertices_m, axis=0)[1:] * 1e3, (30.0, 50.0))
    bottom = bottom_vertices_2024(shape, surface)
    assert len(set(bottom.tolist())) == len(profile_mm(shape))
    assert np.allclose(surface.vertices_m[bottom, 2], 0.0)


@pytest.mark.parametrize("shape", PegShape2024)
@pytest.mark.parametrize("clearance_mm", CLEARANCES_MM)
def test_plate_is_closed_and_lacks_the_hole(shape: PegShape2024, clearance_mm: float) -> None:
    hole, plate = hole_outline_mm(shape, clearance_mm), plate_outline_mm(shape, clearance_mm)
    material_mm2 = signed_area(plate) - signed_area(hole)
    assert volume_mm3(hole_surface(shape, clearance_mm)) == pytest.approx(20.0 * material_mm2)
    wide = (shape, clearance_mm) == (S.CUBOID, 2.0)
    assert np.allclose(np.ptp(plate, axis=0), (85.0, 75.0) if wide else (70.0, 50.0))


@pytest.mark.parametrize("shape", pegs.PegShape)
def test_what_is_of_2025_too_is_the_same(shape: pegs.PegShape) -> None:
    pairs = (peg_surface(S(shape)), pegs.peg_surface(shape)), (hole_surface(S(shape), 1.5), pegs.hole_surface(shape))
    for ours, later in pairs:
        assert np.array_equal(ours.vertices_m, later.vertices_m)
        assert np.array_equal(ours.triangles, later.triangles)
