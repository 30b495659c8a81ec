import hashlib
import os
import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import drawn_gels
import numpy as np
import pytest
from vitac.envs.sensor_design.height_field import NotAHeightField
from vitac.envs.sensor_design.mesher import FeatureBelowResolution, MeshGoal, max_distance_mm, mesh_height_field
from vitac.envs.sensor_design.surface import DrawnSurface, placed_on_base
from vitac.envs.sensor_design.tetrahedra import Tetrahedra, make_gel, tip_sizes

GOAL = MeshGoal(
    length_mm=25.25,
    width_mm=20.75,
    min_nodes=250,
    max_nodes=1000,
    max_distance_mm=0.1,
    max_volume_error=0.01,
    min_quality=0.01,
    tip_depth_mm=0.875,
    min_tip_nodes=25,
)
GELS: dict[str, Callable[[], DrawnSurface]] = {
    "thin": lambda: drawn_gels.flat(2.0),
    "thick": lambda: drawn_gels.flat(8.0),
    "sample": drawn_gels.bevelled,
    "reference": lambda: drawn_gels.bevelled(3.0),
    "ridge": drawn_gels.ridge,
    "tall ridge": lambda: drawn_gels.pillars([[(-2, -4), (2, -4), (2, 4), (-2, 4)]], floor_mm=2.0, top_mm=8.0),
    "pyramids": drawn_gels.pyramids,
    "gable": drawn_gels.gable,
    "wedge": drawn_gels.wedge,
    "dome": drawn_gels.dome,
    "round pillar": lambda: drawn_gels.pillars([drawn_gels.round_outline(1, 2, 3, 90)]),
}


@cache
def meshed(name: str) -> Tetrahedra:
    return mesh_height_field(placed_on_base(GELS[name](), length_mm=25.25, width_mm=20.75), GOAL)


@pytest.mark.parametrize("name", GELS)
def test_mesh_is_that_of_the_drawing(name: str) -> None:
    mesh, drawn = meshed(name), placed_on_base(GELS[name](), length_mm=25.25, width_mm=20.75)
    assert 250 <= len(mesh.nodes_mm) <= 1000
    assert max_distance_mm(mesh.surface, drawn) <= 0.1
    assert mesh.volume_mm3 == pytest.approx(drawn.volume_mm3, rel=0.006)
    assert mesh.qualities.min() > (0.01 if name in ("round pillar", "wedge") else 0.03)
    assert mesh.n_shared_faces == 0
    surface = mesh.surface
    assert (len(surface.open_edges), len(surface.mixed_edges), len(surface.branching_edges)) == (0, 0, 0)
    assert surface.volume_mm3 == pytest.approx(mesh.volume_mm3, rel=1e-12)


@pytest.mark.parametrize("name", GELS)
def test_base_is_exact(name: str) -> None:
    base = meshed(name).nodes_mm[meshed(name).nodes_mm[:, 2] == 0.0]
    np.testing.assert_array_equal(base[:, :2].max(axis=0), [12.625, 10.375])
    np.testing.assert_array_equal(base[:, :2].min(axis=0), [-12.625, -10.375])


def test_sample_of_the_challenge_keeps_its_volume() -> None:
    assert meshed("sample").volume_mm3 == pytest.approx(2051.0833, abs=1e-3)


def test_every_tip_gets_nodes_enough_where_the_whole_mesh_may_have_them() -> None:
    drawn = placed_on_base(drawn_gels.pyramids(), length_mm=25.25, width_mm=20.75)
    plain = mesh_height_field(drawn, replace(GOAL, min_tip_nodes=1))
    assert tip_sizes(plain, depth_mm=0.875) == [1, 1, 1, 1]
    assert tip_sizes(meshed("pyramids"), depth_mm=0.875) == [25, 25, 25, 25]
    assert len(plain.nodes_mm) < len(meshed("pyramids").nodes_mm) < 500
    short = mesh_height_field(drawn, replace(GOAL, max_nodes=len(plain.nodes_mm) + 10))
    assert len(short.nodes_mm) == len(plain.nodes_mm) + 10
    quality = float(meshed("pyramids").qualities.min())
    finer = mesh_height_field(drawn, replace(GOAL, min_tip_nodes=400, min_quality=quality))
    assert 25 <= tip_sizes(finer, depth_mm=0.875)[0] < 400, "half of them as often as tetrahedra would be too flat"
    assert finer.qualities.min() >= quality


@pytest.mark.parametrize("name", ["thin", "thick", "sample", "reference", "dome"])
def test_gel_that_touches_in_one_wide_part_is_meshed_as_ever(name: str) -> None:
    drawn = placed_on_base(GELS[name](), length_mm=25.25, width_mm=20.75)
    assert meshed(name).as_bytes() == mesh_height_field(drawn, replace(GOAL, min_tip_nodes=1)).as_bytes()


def test_vertical_walls_keep_their_place() -> None:
    mesh = meshed("ridge")
    surface = mesh.surface
    normals = surface.area_vectors_mm2 / surface.areas_mm2[:, None]
    walls = surface.corners_mm[(normals[:, 0] > 0.999) & (surface.corners_mm[:, :, 2].min(axis=1) >= 2.5)]
    assert len(walls) > 2
    np.testing.assert_array_equal(walls[:, :, 0], 1.0)
    assert np.abs(mesh.nodes_mm[mesh.nodes_mm[:, 2] > 2.6][:, 0]).max() == 1.0


def test_base_within_tolerance_is_stretched_to_the_case() -> None:
    drawn = drawn_gels.moved(drawn_gels.flat(), scale=1.0007, by=(100, 50, -7))
    placed = placed_on_base(drawn, length_mm=25.25, width_mm=20.75)
    assert placed.extent_mm[:2] == pytest.approx([25.25, 20.75], abs=1e-12)
    assert placed.vertices_mm[:, 2].min() == 0.0


def test_overhang_is_no_height_field() -> None:
    mushroom = drawn_gels.turned_inside_out(drawn_gels.moved(drawn_gels.ridge(), scale=-1.0))
    with pytest.raises(NotAHeightField, match=r"bring a tet\.msh"):
        mesh_height_field(placed_on_base(mushroom, length_mm=25.25, width_mm=20.75), GOAL)


def test_features_too_small_for_the_nodes_are_refused() -> None:
    comb = [[(x, -8.0), (x + 0.2, -8.0), (x + 0.2, 8.0), (x, 8.0)] for x in np.arange(-8.0, 8.0, 2.0)]
    drawn = placed_on_base(drawn_gels.pillars(comb), length_mm=25.25, width_mm=20.75)
    with pytest.raises(FeatureBelowResolution, match="at most 1000 nodes"):
        mesh_height_field(drawn, GOAL)


def test_driven_and_sensing_faces_follow_from_the_geometry() -> None:
    gel, sensing = make_gel(meshed("ridge"), name="ridge")
    z_mm = gel.rest_position_m[:, 2] * 1e3
    assert (z_mm[gel.driven] == -2.0).all()
    assert gel.driven.sum() == (z_mm == -2.0).sum()
    np.testing.assert_allclose(np.unique(z_mm[gel.sensing].round(9)), [0.5, 2.0])
    assert set(gel.sensing_nodes) == set(sensing.reshape(-1))


@pytest.mark.slow
def test_bytes_do_not_depend_on_threads_blas_or_cpu() -> None:
    surroundings: list[dict[str, str]] = [
        {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONHASHSEED": "1"},
        {"OPENBLAS_NUM_THREADS": "2", "OPENBLAS_CORETYPE": "Nehalem", "PYTHONHASHSEED": "2"},
        {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""},
    ]
    paths = os.pathsep.join([str(Path(drawn_gels.__file__).parent), str(Path(__file__).parent)])
    program = "import test_mesher; print(test_mesher.digest())"
    found = [
        subprocess.run(
            [sys.executable, "-c", program],
            env=os.environ | variables | {"PYTHONPATH": paths},
            check=True,
            capture_output=True,
            text=True,
        ).stdout.strip()
        for variables in surroundings
    ]
    assert set(found) == {digest()}


def digest() -> str:
    names = ("sample", "wedge", "dome", "pyramids")
    return hashlib.sha256(b"".join(meshed(name).as_bytes() for name in names)).hexdigest()


def test_distance_from_slivers_takes_little_memory() -> None:
    slivers = drawn_gels.smooth(lambda x, _: 4.0 + 0.01 * (int(x * 80.0) % 2), 2000, rows=1)
    tracemalloc.start()
    try:
        assert max_distance_mm(drawn_gels.flat(), slivers) == pytest.approx(0.01, abs=1e-6)
        assert tracemalloc.get_traced_memory()[1] < 2**27
    finally:
        tracemalloc.stop()
