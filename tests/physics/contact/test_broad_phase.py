"""The candidate list holds every pair within reach, and stays complete for as long as it claims to."""

from collections.abc import Iterator

import numpy as np
import pytest
from engine_probe import Probe
from numpy.typing import NDArray
from small_scenes import Grip
from vitac.envs.fem.algebra import load
from vitac.envs.fem.contact.broad_phase import Candidates, relative_motion
from vitac.envs.fem.contact.distance import EDGE_EDGE, POINT_TRIANGLE, closest_points

FloatArray = NDArray[np.float64]
Pair = tuple[int, tuple[int, ...]]


@pytest.fixture(scope="module")
def probe() -> Probe:
    grip = Grip(cells=(3, 3, 1))
    grip.squeeze(0.15e-3)
    return Probe(grip.scene)


def all_pairs(probe: Probe) -> Iterator[Pair]:
    """Every point-triangle and edge-edge pair of two different bodies."""
    s = probe.model.surfaces
    for a, b in s.pairs.tolist():
        for p_body, t_body in ((a, b), (b, a)):
            for p in range(s.point_start[p_body], s.point_start[p_body + 1]):
                for t in s.triangles[s.triangle_start[t_body] : s.triangle_start[t_body + 1]].tolist():
                    yield POINT_TRIANGLE, (p, *t)
        for e in s.edges[s.edge_start[a] : s.edge_start[a + 1]].tolist():
            for f in s.edges[s.edge_start[b] : s.edge_start[b + 1]].tolist():
                yield EDGE_EDGE, (*e, *f)


def distance(y: FloatArray, pair: Pair) -> float:
    pair_type, p = pair
    _, _, r = closest_points(pair_type, load(y, p[0]), load(y, p[1]), load(y, p[2]), load(y, p[3]))
    return float(np.linalg.norm(r))


def listed(candidates: Candidates) -> set[Pair]:
    rows = zip(candidates.pair_type.tolist(), candidates.points.tolist(), strict=True)
    return {(pair_type, tuple(points)) for pair_type, points in rows}


@pytest.mark.parametrize("reach", [1e-4, 5e-4])
def test_every_pair_within_reach_is_listed_once(probe: Probe, reach: float) -> None:
    candidates = probe.candidates(probe.x_m, reach)
    y = probe.points_m(probe.x_m)
    near = {pair for pair in all_pairs(probe) if distance(y, pair) <= reach}
    found = listed(candidates)
    assert len(found) == len(candidates.pair_type)
    assert len(near) > 40
    assert near <= found


def test_listed_pairs_carry_their_friction_and_mollifier_threshold(probe: Probe) -> None:
    candidates = probe.candidates(probe.x_m, 2e-4)
    s = probe.model.surfaces
    make_body = np.searchsorted(s.point_start, np.arange(s.point_start[-1]), side="right") - 1
    friction = {tuple(pair): value for pair, value in zip(s.pairs.tolist(), s.pair_friction, strict=True)}
    rest = {tuple(edge): length for edge, length in zip(s.edges.tolist(), s.edge_squared_length_m2, strict=True)}
    for k in range(len(candidates.pair_type)):
        p = candidates.points[k]
        bodies = tuple(sorted((int(make_body[p[0]]), int(make_body[p[3]]))))
        assert candidates.friction[k] == friction[bodies]
        if candidates.pair_type[k] == EDGE_EDGE:
            expected = 1e-3 * rest[(int(p[0]), int(p[1]))] * rest[(int(p[2]), int(p[3]))]
            assert candidates.mollifier_eps_m4[k] == pytest.approx(expected)


def test_the_list_grows_past_its_first_capacity(probe: Probe) -> None:
    everything = probe.candidates(probe.x_m, 1.0)
    assert len(everything.pair_type) == sum(1 for _ in all_pairs(probe)) > 4096


@pytest.mark.parametrize("seed", range(4))
def test_relative_motion_bounds_the_change_of_every_distance(probe: Probe, seed: int) -> None:
    random = np.random.default_rng(seed)
    s = probe.model.surfaces
    y = probe.points_m(probe.x_m)
    move = 1e-4 * random.normal(size=y.shape)
    for body in range(len(s.point_start) - 1):
        move[s.point_start[body] : s.point_start[body + 1]] += 1e-3 * random.normal(size=3)
    bound = relative_motion(s, move, np.empty((3, 4)), np.empty(3))
    pairs = [pair for k, pair in enumerate(all_pairs(probe)) if k % 37 == seed]
    changes = [abs(distance(y + move, pair) - distance(y, pair)) for pair in pairs]
    assert 0.2 * bound < max(changes) <= bound


def test_a_common_translation_is_no_relative_motion(probe: Probe) -> None:
    move = np.tile([3e-3, -1e-3, 2e-3], (probe.model.surfaces.point_start[-1], 1))
    assert relative_motion(probe.model.surfaces, move, np.empty((3, 4)), np.empty(3)) < 1e-15


@pytest.mark.parametrize("seed", range(3))
def test_a_list_with_margin_stays_complete_under_motions_within_it(probe: Probe, seed: int) -> None:
    random = np.random.default_rng(seed)
    d_hat, margin = 1e-4, 3e-4
    candidates = listed(probe.candidates(probe.x_m, d_hat + margin))
    y = probe.points_m(probe.x_m)
    move = random.normal(size=y.shape)
    move *= margin / relative_motion(probe.model.surfaces, move, np.empty((3, 4)), np.empty(3))
    move += [1e-2, 0, 0]
    near = {pair for pair in all_pairs(probe) if distance(y + move, pair) < d_hat}
    assert near <= candidates
