"""Gels as exports of others leave them: split, noisy, doubled, turned and degenerate; trimesh reads them, too."""

import time
from collections.abc import Callable
from functools import cache
from pathlib import Path

import drawn_gels
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from vitac.envs.geometry.stl import read_corners
from vitac.evaluator.sensors.check import check_sensor
from vitac.evaluator.sensors.findings import Rule, sensor_limits
from vitac.evaluator.sensors.shape import ShapeCheck

ROOT = Path(__file__).parents[4]
REFERENCE = ROOT.parent / "shared" / "reference" / "assets" / "track3" / "gel_STL_model" / "gelsight_mini.STL"
LONGEST_S = 10.0

Corners = NDArray[np.float64]
Random = np.random.Generator

DRAWN = {
    name: getattr(drawn_gels, name) for name in ("flat", "bevelled", "ridge", "pit", "pyramids", "gable", "wedge")
} | {"dome": lambda: drawn_gels.dome(cells=12)}
FILES = {"example": ROOT / "examples" / "track_3_dome" / "Track_3" / "gel.stl", "reference": REFERENCE}
NAMES = [*DRAWN, *(name for name, path in FILES.items() if path.exists())]


@cache
def corners_of(name: str) -> Corners:
    return read_corners(FILES[name]) if name in FILES else np.asarray(DRAWN[name]().corners_mm)


def fraction(random: Random) -> float:
    """Anywhere on a line, often so near its end that single precision cannot tell."""
    return float(random.random() if random.random() < 0.5 else 10 ** random.uniform(-8, -2))


def split_edge(corners: Corners, random: Random) -> Corners:
    number, side = random.integers(len(corners)), random.integers(3)
    ends = corners[number, side], corners[number, (side + 1) % 3]
    middle = ends[0] + fraction(random) * (ends[1] - ends[0])
    triangles = []
    for triangle in corners:
        a, b, c = triangle
        for p, q, r in ((a, b, c), (b, c, a), (c, a, b)):
            if any((p == start).all() and (q == end).all() for start, end in (ends, ends[::-1])):
                triangles += [[p, middle, r], [middle, q, r]]
                break
        else:
            triangles.append(list(triangle))
    return np.array(triangles)


def split_face(corners: Corners, random: Random) -> Corners:
    number = random.integers(len(corners))
    a, b, c = corners[number]
    middle = random.dirichlet([0.5] * 3) @ corners[number]
    return np.concatenate([np.delete(corners, number, axis=0), [[a, b, middle], [b, c, middle], [c, a, middle]]])


def double(corners: Corners, random: Random) -> Corners:
    return np.concatenate([corners, corners[random.integers(len(corners), size=1)]])


def turn(corners: Corners, random: Random) -> Corners:
    turned, number = corners.copy(), random.integers(len(corners))
    turned[number] = corners[number, ::-1]
    return turned


def add_line(corners: Corners, random: Random) -> Corners:
    a, b, _ = corners[random.integers(len(corners))]
    third = b if random.random() < 0.5 else a + fraction(random) * (b - a)
    return np.concatenate([corners, [[a, b, third]]])


def move_vertices(corners: Corners, random: Random) -> Corners:
    vertices, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    moved = vertices + random.uniform(-1, 1, vertices.shape) * 10 ** random.uniform(-7, -3)
    return np.asarray(moved[index.reshape(-1)].reshape(-1, 3, 3))


def move_corners(corners: Corners, random: Random) -> Corners:
    return np.asarray(corners + random.uniform(-1, 1, corners.shape) * 10 ** random.uniform(-7, -3))


def written(corners: Corners, folder: Path) -> Path:
    """The path of a binary STL file of these triangles."""
    records = np.zeros(len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
    records["corners"] = corners
    path = folder / "gel.stl"
    path.write_bytes(b"\0" * 80 + len(corners).to_bytes(4, "little") + records.tobytes())
    return path


def read_by_trimesh(path: Path) -> trimesh.Trimesh:
    """The surface with equal corners as one vertex, without triangles that name one twice or repeat another."""
    mesh = trimesh.load_mesh(path, process=False)
    mesh.merge_vertices(digits_vertex=9)
    faces = [face for face in mesh.faces.tolist() if len(set(face)) == 3]
    at = [face.index(min(face)) for face in faces]
    unique = dict.fromkeys(tuple(face[k:] + face[:k]) for face, k in zip(faces, at, strict=True))
    return trimesh.Trimesh(mesh.vertices, np.array([*unique]), process=False)


disturbed = given(name=st.sampled_from(NAMES), seed=st.integers(0, 2**32), count=st.integers(1, 25))


@disturbed
@settings(max_examples=60)
def test_splits_and_repetitions_do_not_matter(
    name: str, seed: int, count: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    random, corners = np.random.default_rng(seed), corners_of(name)
    kinds: list[Callable[[Corners, Random], Corners]] = [split_edge, split_face]
    for _ in range(count):
        corners = kinds[random.integers(2)](corners, random)
    path = written(double(corners, random), tmp_path_factory.mktemp("gel"))
    other, check = read_by_trimesh(path), ShapeCheck(path, sensor_limits())
    if other.is_watertight and other.is_winding_consistent:
        assert check.surface is not None, [finding for finding in check.findings if not finding.ok]
        assert check.surface.volume_mm3 == pytest.approx(other.volume, rel=1e-4)


@disturbed
@settings(max_examples=60)
def test_corners_that_are_a_little_apart_are_one_and_others_are_named(
    name: str, seed: int, count: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    random, corners = np.random.default_rng(seed), corners_of(name)
    noise_mm = 10 ** random.uniform(-7, -2.5)
    moved = corners + random.uniform(-noise_mm, noise_mm, corners.shape)
    check = ShapeCheck(written(moved, tmp_path_factory.mktemp("gel")), sensor_limits())
    plain = read_by_trimesh(written(corners, tmp_path_factory.mktemp("gel")))
    if noise_mm < 4e-4:
        assert check.surface is not None, [finding for finding in check.findings if not finding.ok]
    if check.surface is not None:
        assert check.surface.volume_mm3 == pytest.approx(plain.volume, rel=1e-3)
    else:
        (closed,) = [finding for finding in check.findings if finding.rule is Rule.CLOSED]
        assert "corners within 0.001 mm are taken as one" in closed.problem


@pytest.mark.slow
@disturbed
@settings(max_examples=60)
def test_every_gel_has_an_answer_in_seconds(
    name: str, seed: int, count: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    random, corners = np.random.default_rng(seed), corners_of(name)
    kinds = [split_edge, split_edge, split_face, split_face, double, turn, add_line, move_vertices, move_corners]
    for _ in range(count):
        corners = kinds[random.integers(len(kinds))](corners, random)
    path = written(corners, tmp_path_factory.mktemp("gel"))
    start = time.process_time()
    check = check_sensor(path)
    assert time.process_time() - start < LONGEST_S
    if check.meshed is None:
        assert all(finding.problem for finding in check.findings if not finding.ok)
    else:
        plain = read_by_trimesh(written(corners_of(name), path.parent))
        assert check.meshed.mesh.volume_mm3 == pytest.approx(plain.volume, rel=0.011)


def test_two_corners_that_are_almost_one_are_one(tmp_path: Path) -> None:
    """As exports of CAD booleans in single precision have them."""
    corners = drawn_gels.bevelled().corners_mm
    a, b = corners[4, 0], corners[4, 1]
    beside = a + 5e-6 / np.linalg.norm(b - a) * (b - a)
    triangles = [list(triangle) for triangle in corners]
    for triangle in corners:
        for p, q, r in (triangle, triangle[[1, 2, 0]], triangle[[2, 0, 1]]):
            if ((p == a).all() and (q == b).all()) or ((p == b).all() and (q == a).all()):
                triangles = [each for each in triangles if not np.array_equal(each, triangle)]
                triangles += [[p, beside, r], [beside, q, r]]
    check = ShapeCheck(written(np.array(triangles), tmp_path), sensor_limits())
    assert check.surface is not None
    assert len(check.surface.triangles) == len(corners)
