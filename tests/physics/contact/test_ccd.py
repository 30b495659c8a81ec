"""How far a move may go: never too far, and not needlessly short."""

import numpy as np
import pytest
from block_meshes import box_gel
from numpy.typing import NDArray
from small_scenes import IDENTITY
from vitac.envs.fem.algebra import dot, load
from vitac.envs.fem.contact.broad_phase import Candidates
from vitac.envs.fem.contact.ccd import (
    PointMove,
    _advance,
    _keeps_gap,
    contact_free_fraction,
    inversion_free_fraction,
)
from vitac.envs.fem.contact.distance import EDGE_EDGE, POINT_TRIANGLE, closest_points
from vitac.envs.fem.model.mesh import GelBody
from vitac.envs.fem.model.model import Elastic, Model
from vitac.envs.fem.scene.scene import Scene

FloatArray = NDArray[np.float64]
GAP_FRACTION = 0.7
pair_types = pytest.mark.parametrize("pair_type", [POINT_TRIANGLE, EDGE_EDGE])


def listed(pair_types: list[int], points: list[list[int]], x: FloatArray) -> Candidates:
    """Candidates of one pair of bodies, listed at points x [m]."""
    distances = [distance(pair_type, x[corners]) for pair_type, corners in zip(pair_types, points, strict=True)]
    pairs = len(pair_types)
    return Candidates(
        np.array(pair_types),
        np.array(points),
        np.zeros(pairs, dtype=np.int64),
        np.ones(pairs),
        np.zeros(pairs),
        np.array(distances),
        np.zeros(pairs, dtype=np.int64),
        np.full((pairs, 6), np.nan),
    )


def fraction(pair_type: int, x: FloatArray, move: FloatArray, gap_fraction: float = GAP_FRACTION) -> float:
    candidates = listed([pair_type], [[0, 1, 2, 3]], x)
    far = np.full(1, np.inf)
    return contact_free_fraction(candidates, PointMove(x, move, far, far), gap_fraction, 1.0)


def distance(pair_type: int, x: FloatArray) -> float:
    _, _, r = closest_points(pair_type, load(x, 0), load(x, 1), load(x, 2), load(x, 3))
    return float(np.linalg.norm(r))


def random_pair(random: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    return random.normal(size=(4, 3)), random.normal(size=(4, 3)) * random.choice([0.3, 1.0, 3.0])


@pair_types
def test_a_pair_is_passed_over_only_where_its_first_advance_reaches_the_end(pair_type: int) -> None:
    random = np.random.default_rng(pair_type)
    passed = limited = 0
    for _ in range(1000):
        x, move = random_pair(random)
        x = x * random.choice([1.0, 1e-3]) + random.normal()
        points, moves = ((load(each, 0), load(each, 1), load(each, 2), load(each, 3)) for each in (x, move * np.ptp(x)))
        _, _, r = closest_points(pair_type, *points)
        advance = _advance(points, moves, r, (1 - GAP_FRACTION) * np.sqrt(dot(r, r)), pair_type)
        if _keeps_gap(points, moves, r, GAP_FRACTION, 0.5, pair_type):
            assert advance >= 0.5
            passed += 1
        limited += advance < 0.5
    assert passed > 100
    assert limited > 100


@pair_types
def test_a_move_leaves_its_part_of_the_gap_all_along(pair_type: int) -> None:
    random = np.random.default_rng(pair_type)
    limited = 0
    for _ in range(300):
        x, move = random_pair(random)
        part = fraction(pair_type, x, move)
        floor = (1 - GAP_FRACTION) * distance(pair_type, x)
        gaps = [distance(pair_type, x + t * part * move) for t in np.linspace(0, 1, 60)]
        assert min(gaps) >= floor * (1 - 1e-9)
        limited += part < 1
    assert limited > 15


@pair_types
def test_a_limited_move_ends_near_its_limit(pair_type: int) -> None:
    """Conservative, not timid: where the move is cut, most of the allowed gap has been used."""
    random = np.random.default_rng(20 + pair_type)
    used = []
    for _ in range(300):
        x, move = random_pair(random)
        part = fraction(pair_type, x, move)
        if part < 1:
            ahead = [distance(pair_type, x + min(1.0, part + 0.02 * k) * move) for k in range(1, 4)]
            used.append(min(ahead) <= (1 - GAP_FRACTION) * distance(pair_type, x) + 0.05 or part > 0.97)
    assert np.mean(used) > 0.9


@pair_types
def test_the_fraction_never_exceeds_the_exact_time_of_impact(pair_type: int) -> None:
    ipctk = pytest.importorskip("ipctk", reason="the IPC Toolkit has no wheel for this machine")
    random = np.random.default_rng(40 + pair_type)
    oracle = ipctk.TightInclusionCCD(tolerance=1e-9, conservative_rescaling=1.0)
    find = oracle.point_triangle_ccd if pair_type == POINT_TRIANGLE else oracle.edge_edge_ccd
    hits = 0
    for _ in range(300):
        x, move = random_pair(random)
        if pair_type == POINT_TRIANGLE and random.random() < 0.7:  # aim at the triangle
            move = np.zeros((4, 3))
            move[0] = 1.5 * (random.dirichlet([1, 1, 1]) @ x[1:] - x[0])
        hit, time = find(*x, *(x + move))
        if hit:
            hits += 1
            assert fraction(pair_type, x, move) < time
            assert fraction(pair_type, x, move, 0.999) <= time * (1 + 1e-6)
    assert hits > 20


def test_parting_primitives_may_go_all_the_way() -> None:
    x = np.array([[0.2, 0.2, 0.1], [0, 0, 0], [1, 0, 0], [0, 1, 0.0]])
    move = np.array([[0, 0, 5.0], [0, 0, 0], [0, 0, 0], [0, 0, 0]])
    assert fraction(POINT_TRIANGLE, x, move) == 1.0


def test_a_straight_approach_is_cut_exactly() -> None:
    x = np.array([[0.2, 0.2, 0.1], [0, 0, 0], [1, 0, 0], [0, 1, 0.0]])
    move = np.array([[0, 0, -0.2], [0, 0, 0], [0, 0, 0], [0, 0, 0]])
    assert fraction(POINT_TRIANGLE, x, move) == pytest.approx(0.35, rel=1e-3)


def test_the_most_restrictive_pair_decides() -> None:
    x = np.array([[0.2, 0.2, 0.1], [0, 0, 0], [1, 0, 0], [0, 1, 0.0], [0.3, 0.3, 0.05]])
    move = np.zeros((5, 3))
    move[[0, 4], 2] = -0.2
    both = listed([POINT_TRIANGLE, POINT_TRIANGLE], [[0, 1, 2, 3], [4, 1, 2, 3]], x)
    far = np.full(1, np.inf)
    assert contact_free_fraction(both, PointMove(x, move, far, far), GAP_FRACTION, 1.0) == pytest.approx(
        0.175, rel=1e-3
    )


def test_a_pair_is_passed_over_only_when_its_bodies_cannot_have_closed_that_part_of_its_gap() -> None:
    """Listed at 0.1, moved 0.02 since: at least 0.08 and at most 0.12 apart now, of which 0.036 must be left."""
    x = np.array([[0.2, 0.2, 0.1], [0, 0, 0], [1, 0, 0], [0, 1, 0.0]])
    candidates = listed([POINT_TRIANGLE], [[0, 1, 2, 3]], x)
    closing = np.zeros((4, 3))
    closing[0, 2] = -0.2
    now = np.array([0.02])
    moves = [PointMove(x, closing, now, np.array([ahead])) for ahead in (0.063, 0.065)]
    allowed = [contact_free_fraction(candidates, move, 0.7, 1.0) for move in moves]
    assert allowed == [1.0, pytest.approx(0.35, rel=1e-3)]


@pytest.fixture(scope="module")
def block() -> tuple[Model, FloatArray]:
    mesh = box_gel((0.004, 0.004, 0.004), (2, 2, 2))
    scene = Scene(gels=[GelBody(mesh=mesh, rotation=IDENTITY, translation_m=np.zeros(3))], bodies=[], time_step_s=0.1)
    return scene._model, mesh.rest_position_m


def smallest_volume_ratio(elastic: Elastic, x: FloatArray, move: FloatArray, part: float) -> float:
    def volumes(positions: FloatArray) -> FloatArray:
        a, b, c = (positions[elastic.nodes[:, i]] - positions[elastic.nodes[:, 0]] for i in (1, 2, 3))
        return np.asarray((np.cross(a, b) * c).sum(axis=1))

    return float(min((volumes(x + t * part * move) / volumes(x)).min() for t in np.linspace(0, 1, 40)))


@pytest.mark.parametrize("size", [1e-4, 1e-3, 5e-3])
@pytest.mark.parametrize("seed", range(5))
def test_no_tetrahedron_loses_more_than_nine_tenths_of_its_volume(
    block: tuple[Model, FloatArray], seed: int, size: float
) -> None:
    model, x = block
    elastic = model.elastic
    move = size * np.random.default_rng(seed).normal(size=x.shape)
    part = inversion_free_fraction(elastic, model.hexahedra, x, move, 1.0)
    assert 0 < part <= 1
    assert smallest_volume_ratio(elastic, x, move, part) >= 0.1 - 1e-9
    if size < 5e-4:
        assert part == 1.0
    if part < 1:
        assert smallest_volume_ratio(elastic, x, move, min(1.0, 4 * part)) < 0.6


def test_a_rigid_translation_is_not_cut(block: tuple[Model, FloatArray]) -> None:
    model, x = block
    assert inversion_free_fraction(model.elastic, model.hexahedra, x, np.ones_like(x), 1.0) == 1.0
