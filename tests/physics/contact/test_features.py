"""Every place of a surface counts once: sums over features against inclusion and exclusion over all simplices."""

import numpy as np
import pytest
from block_meshes import box_surface
from numpy.typing import NDArray
from small_scenes import Grip, arena_contact
from vitac.envs.fem.contact.broad_phase import NO_TRIANGLE
from vitac.envs.fem.contact.contact import Quad
from vitac.envs.fem.contact.distance import EDGE_EDGE, POINT_TRIANGLE, closest_points
from vitac.envs.fem.contact.features import new_terms, separation, write_terms
from vitac.envs.fem.model.mesh import SurfaceMesh, unique_edges

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]
REACH = 1.0


def barrier(d: float) -> float:
    return float(-((d - REACH) ** 2) * np.log(d / REACH)) if d < REACH else 0.0


def distance(point: FloatArray, *corners: FloatArray) -> float:
    """From a point to another one, an edge or a triangle."""
    if len(corners) == 1:
        return float(np.linalg.norm(point - corners[0]))
    if len(corners) == 2:
        a, b = corners
        t = np.clip((point - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        return float(np.linalg.norm(point - a - t * (b - a)))
    a, b, c = corners
    weights = np.linalg.lstsq(np.stack([b - a, c - a], axis=1), point - a, rcond=None)[0]
    if (weights > 0).all() and weights.sum() < 1:
        return float(np.linalg.norm(point - a - weights[0] * (b - a) - weights[1] * (c - a)))
    return min(distance(point, *pair) for pair in ((a, b), (b, c), (c, a)))


def vectors(x: FloatArray) -> Quad:
    """Four points as kernels take them."""
    p, q, r, s = ((float(row[0]), float(row[1]), float(row[2])) for row in x)
    return p, q, r, s


class Bumps:
    """A box whose vertices are moved at random, with hollows and bumps about as wide as the barrier reaches."""

    def __init__(self, bumpiness: float, seed: int = 0) -> None:
        box = box_surface((0.1, 0.1, 0.1), (0.0, 0.0, 0.0))
        vertices, triangles = 10.0 * box.vertices_m, box.triangles
        while len(triangles) < 48:
            vertices, triangles = _halved(vertices, triangles)
        self.vertices = 4.0 * (vertices + bumpiness * np.random.default_rng(seed).normal(size=vertices.shape))
        self.triangles, self._terms = triangles, new_terms()
        mesh = SurfaceMesh(vertices_m=1e-3 * self.vertices, triangles=triangles, name="bumps")
        self._surfaces = Grip(contact=arena_contact(0.5)).scene._model.surfaces._replace(
            triangles=triangles,
            neighbours=mesh.neighbours,
            around=np.argsort(triangles.ravel(), kind="stable") // 3,
            around_start=np.searchsorted(np.sort(triangles.ravel()), np.arange(len(vertices) + 2)),
        )

    def energy(self, point: FloatArray) -> float:
        """Sum of the barriers of all terms, times their factors."""
        points, total = np.concatenate([self.vertices, [point]]), 0.0
        for triangle, corners in enumerate(self.triangles):
            x = vectors(np.array([point, *self.vertices[corners]]))
            c = closest_points(POINT_TRIANGLE, *x)[0]
            for term in range(write_terms(self._surfaces, triangle, points, x, c, self._terms)):
                total += self._terms.factor[term] * barrier(float(np.linalg.norm(separation(self._terms, term, x)[2])))
        return total

    def above(self, triangle: int, weights: FloatArray, height: float) -> FloatArray:
        """A point over a triangle."""
        corners = self.vertices[self.triangles[triangle]]
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        return np.asarray(weights @ corners + height * normal / np.linalg.norm(normal))


def _halved(vertices: FloatArray, triangles: IndexArray) -> tuple[FloatArray, IndexArray]:
    """A surface with every edge halved."""
    middle = {tuple(edge): len(vertices) + k for k, edge in enumerate(unique_edges(triangles).tolist())}
    finer = []
    for a, b, c in triangles.tolist():
        p, q, r = (middle[min(pair), max(pair)] for pair in ((a, b), (b, c), (c, a)))
        finer += [[a, p, r], [p, b, q], [r, q, c], [p, q, r]]
    places = [0.5 * (vertices[a] + vertices[b]) for a, b in middle]
    return np.concatenate([vertices, places]), np.array(finer, dtype=np.int64)


@pytest.mark.parametrize(("bumpiness", "seed"), [(0.0, 0), (0.03, 1), (0.06, 2)])
def test_a_point_counts_triangles_less_edges_plus_vertices(bumpiness: float, seed: int) -> None:
    """That sum changes continuously, with its slope, as each distance does."""
    bumps, rng, near = Bumps(bumpiness, seed), np.random.default_rng(7), 0
    vertices, edges = bumps.vertices, unique_edges(bumps.triangles)
    for _ in range(25):
        point = bumps.above(int(rng.integers(len(bumps.triangles))), rng.dirichlet(np.ones(3)), rng.uniform(0.05, 0.7))
        expected = sum(barrier(distance(point, *vertices[simplex])) for simplex in bumps.triangles)
        expected -= sum(barrier(distance(point, *vertices[simplex])) for simplex in edges)
        expected += sum(barrier(distance(point, vertex)) for vertex in vertices)
        assert bumps.energy(point) == pytest.approx(expected, abs=1e-9)
        near += expected > 0
    assert near > 15


def test_an_edge_pair_counts_inside_of_both_less_the_ends_that_count_already() -> None:
    rng, terms, near = np.random.default_rng(3), new_terms(), 0
    surfaces = Grip(contact=arena_contact(0.5)).scene._model.surfaces
    for _ in range(400):
        x = rng.normal(size=(4, 3))
        corners, measured = vectors(x), 0.0
        c = closest_points(EDGE_EDGE, *corners)[0]
        for term in range(write_terms(surfaces, NO_TRIANGLE, x, corners, c, terms)):
            measured += terms.factor[term] * barrier(float(np.linalg.norm(separation(terms, term, corners)[2])))
        pair = barrier(float(np.linalg.norm(np.array(c) @ x)))
        ends = sum(barrier(distance(x[i], x[2], x[3])) + barrier(distance(x[2 + i], x[0], x[1])) for i in range(2))
        points = sum(barrier(distance(x[i], x[2 + j])) for i in range(2) for j in range(2))
        assert measured == pytest.approx(pair - ends + points, abs=1e-9)
        near += measured != 0
    assert near > 30


def test_only_convex_edges_of_rigid_parts_touch() -> None:
    box = box_surface((0.01, 0.02, 0.03), (0.0, 0.0, 0.0))
    assert (len(box.edges), len(box.convex_edges)) == (18, 12)
    top = [t for t in box.triangles.tolist() if all(box.vertices_m[k][2] == 0.03 for k in t)]
    directed = [(t[i], t[(i + 1) % 3]) for t in top for i in range(3)]
    rim = [[a, b, 8] for a, b in directed if (b, a) not in directed]
    pushed_in = np.concatenate([box.vertices_m, [[0.005, 0.01, 0.02]]])
    triangles = np.array([t for t in box.triangles.tolist() if t not in top] + rim, dtype=np.int64)
    hollow = SurfaceMesh(vertices_m=pushed_in, triangles=triangles, name="hollow")
    assert len(hollow.edges) == 21
    assert hollow.convex_edges.tolist() == box.convex_edges.tolist()
