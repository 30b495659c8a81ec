"""A scene as it is drawn: its parts in colours, the contact's stress on the gels among them."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..scene.perspective import Perspective
from .playback import EpisodePlayback, Moment
from .projection import ParallelCamera, section_loops_m
from .visibility import (
    CUT_COLOUR,
    FIXED_COLOUR,
    HELD_COLOUR,
    NOTHING,
    ColourMap,
    Visible,
    averaged,
    lit,
    seen_through,
    sharp_edges,
    unique_edges,
    unit_normals,
    visible_lines,
)

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

# Pixels computed along each side of one that is shown.
SUPERSAMPLING = 2
# Free space around the scene, in parts of the picture: on both sides, above (for the gels' labels) and below.
_SIDE_MARGIN, _TOP_MARGIN, _BOTTOM_MARGIN = 0.02, 0.075, 0.065


@dataclass(frozen=True, kw_only=True, eq=False)
class SceneImage:
    """A picture of the scene, and what is written and drawn over it; places in pixels from the upper left corner.

    Attributes:
        rgb: colours in 0 to 1, shape [height, width, 3].
        lines: edges that nothing hides, polylines.
        faint_lines: edges that are seen through the held part, or that are the held part's own behind it.
        element_lines: edges of the gels' elements.
        cut_lines: outlines of the cut.
        gel_boxes: least and largest coordinates of the left and the right gel, shape [2, 2, 2].
        held_middle: middle of the held part, shape [2].
        fixed_bottom: lowest place of the fixed part, shape [2].
    """

    rgb: FloatArray
    lines: list[FloatArray]
    faint_lines: list[FloatArray]
    element_lines: list[FloatArray]
    cut_lines: list[FloatArray]
    gel_boxes: FloatArray
    held_middle: FloatArray
    fixed_bottom: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class _Part:
    """A surface at a moment; `values` at its vertices are shown as colours, or its own colour where there are none."""

    vertices_m: FloatArray
    triangles: IndexArray
    edges: IndexArray
    colour: tuple[float, float, float] = FIXED_COLOUR
    values: FloatArray | None = None
    kept_m: FloatArray | None = None


class SceneView:
    """Draws the moments of a playback from one place; what does not move is looked at once."""

    def __init__(self, playback: EpisodePlayback, perspective: Perspective, *, width_px: int, height_px: int) -> None:
        self._playback = playback
        self._cut = perspective.cut
        self._fixed = _Part(
            vertices_m=playback.fixed_m,
            triangles=playback.fixed.triangles,
            edges=sharp_edges(playback.fixed_m, playback.fixed.triangles),
            kept_m=-self._cut.heights_m(playback.fixed_m),
        )
        self._held_edges = sharp_edges(playback.held.vertices_m, playback.held.triangles)
        self._gel_edges = sharp_edges(playback.gel.rest_position_m, playback.gel.surface_triangles)
        self._element_edges = unique_edges(playback.gel.surface_triangles)
        self._camera = self._framing(
            ParallelCamera(
                azimuth_deg=perspective.azimuth_deg,
                elevation_deg=perspective.elevation_deg,
                centre_m=(0.0, 0.0, 0.0),
                height_m=1.0,
                width_px=width_px * SUPERSAMPLING,
                height_px=height_px * SUPERSAMPLING,
            )
        )
        self._background = self._look_at_fixed()

    def image(self, moment: Moment, values: tuple[FloatArray, FloatArray], colours: ColourMap) -> SceneImage:
        """Return the scene at a moment, the gels coloured by values at their nodes, each of shape [n]."""
        gels, held = self._gels(moment, values), self._held(moment)
        behind = self._background.copy()
        self._add([self._fixed], gels, behind)
        front = behind.copy()
        self._add([self._fixed, *gels], [held], front)
        rgb = self._shaded([self._fixed, *gels], behind, colours)
        rgb = seen_through(
            self._shaded([self._fixed, *gels, held], front, colours), rgb, front.triangle != behind.triangle
        )
        parts = (self._fixed, *gels, held)
        return SceneImage(
            rgb=averaged(rgb, SUPERSAMPLING),
            lines=[line for part in parts for line in self._lines(part, part.edges, front)],
            faint_lines=[line for part in parts for line in self._lines(part, part.edges, behind)],
            element_lines=[line for gel in gels for line in self._lines(gel, self._element_edges, front)],
            cut_lines=self._cut_lines(front),
            gel_boxes=np.stack([self._box(gel) for gel in gels]),
            held_middle=self._box(held).mean(axis=0),
            fixed_bottom=self._bottom_of_fixed(),
        )

    def _gels(self, moment: Moment, values: tuple[FloatArray, FloatArray]) -> list[_Part]:
        triangles = self._playback.gel.surface_triangles
        pairs = zip(moment.gel_nodes_m, values, strict=True)
        return [_Part(vertices_m=m, triangles=triangles, edges=self._gel_edges, values=v) for m, v in pairs]

    def _held(self, moment: Moment) -> _Part:
        triangles = self._playback.held.triangles
        return _Part(vertices_m=moment.held_m, triangles=triangles, edges=self._held_edges, colour=HELD_COLOUR)

    def _framing(self, camera: ParallelCamera) -> ParallelCamera:
        """Return the same camera, moved and scaled so that all moments fit."""
        kept = self._fixed.vertices_m[self._cut.heights_m(self._fixed.vertices_m) <= 0.0]
        moving = [part for moment in self._playback.moments for part in (*moment.gel_nodes_m, moment.held_m)]
        points_m = np.concatenate(
            [kept, *section_loops_m(self._fixed.vertices_m, self._fixed.triangles, self._cut), *moving]
        )
        right, up = (points_m @ camera.axes[axis] for axis in (0, 1))
        aspect = camera.width_px / camera.height_px
        height_m = max(
            np.ptp(up) / (1.0 - _TOP_MARGIN - _BOTTOM_MARGIN), np.ptp(right) / aspect / (1.0 - 2.0 * _SIDE_MARGIN)
        )
        middle = (
            np.array([right.max() + right.min(), up.max() + up.min() + height_m * (_TOP_MARGIN - _BOTTOM_MARGIN)]) / 2
        )
        x, y, z = (middle @ camera.axes[:2]).tolist()
        return replace(camera, centre_m=(x, y, z), height_m=float(height_m))

    def _look_at_fixed(self) -> Visible:
        visible = Visible.nothing(self._camera)
        self._add([], [self._fixed], visible)
        visible.close_cut(self._cut, self._camera, self._is_cut(visible))
        return visible

    def _add(self, earlier: list[_Part], parts: list[_Part], visible: Visible) -> None:
        """Add parts, numbering their triangles after those of the earlier ones."""
        first = sum(len(part.triangles) for part in earlier)
        for part in parts:
            kept_m = None if part.kept_m is None else part.kept_m[part.triangles]
            visible.add(self._camera.project(part.vertices_m)[part.triangles], first=first, kept_m=kept_m)
            first += len(part.triangles)

    def _is_cut(self, visible: Visible) -> NDArray[np.bool_]:
        """Return the pixels in which the fixed part is seen from inside, which is where its cut is."""
        from_inside = unit_normals(self._fixed.vertices_m, self._fixed.triangles) @ self._camera.axes[2] > 0.0
        is_fixed = (visible.triangle != NOTHING) & (visible.triangle < len(from_inside))
        return np.asarray(is_fixed & from_inside[np.where(is_fixed, visible.triangle, 0)])

    def _shaded(self, parts: list[_Part], visible: Visible, colours: ColourMap) -> FloatArray:
        rgb = np.ones((*visible.triangle.shape, 3))
        start = 0
        for part in parts:
            here = (visible.triangle >= start) & (visible.triangle < start + len(part.triangles))
            number = visible.triangle[here] - start
            normals = unit_normals(part.vertices_m, part.triangles) @ self._camera.axes.T
            if part.values is None:
                rgb[here] = lit(np.array(part.colour), normals[number])
            else:
                value = visible.interpolated(part.values[part.triangles], number, here)
                rgb[here] = lit(colours(value)[:, :3], normals[number], matt=False)
            start += len(part.triangles)
        rgb[self._is_cut(visible)] = CUT_COLOUR
        return rgb

    def _lines(self, part: _Part, edges: IndexArray, visible: Visible) -> list[FloatArray]:
        kept_m = None if part.kept_m is None else part.kept_m[edges]
        lines = visible_lines(part.vertices_m[edges], self._camera, visible, kept_m=kept_m)
        return [line / SUPERSAMPLING for line in lines]

    def _cut_lines(self, visible: Visible) -> list[FloatArray]:
        loops = section_loops_m(self._fixed.vertices_m, self._fixed.triangles, self._cut)
        ends_m = [np.stack([loop, np.roll(loop, -1, axis=0)], axis=1) for loop in loops]
        lines = visible_lines(np.concatenate(ends_m), self._camera, visible) if ends_m else []
        return [line / SUPERSAMPLING for line in lines]

    def _box(self, part: _Part) -> FloatArray:
        pixels = self._camera.project(part.vertices_m)[:, :2] / SUPERSAMPLING
        return np.stack([pixels.min(axis=0), pixels.max(axis=0)])

    def _bottom_of_fixed(self) -> FloatArray:
        rows, columns = np.nonzero(self._background.triangle != NOTHING)
        lowest = rows.argmax()
        return np.array([columns[lowest], rows[lowest]]) / SUPERSAMPLING


def deformation_gradients(rest_m: FloatArray, positions_m: FloatArray, tetrahedra: IndexArray) -> FloatArray:
    """Return F = D_s D_m^-1 of linear tetrahedra, shape [t, 3, 3]; the columns of D are the edges from corner 0.

    Sifakis & Barbic, FEM Simulation of 3D Deformable Solids (2012), section 4.1.

    Args:
        rest_m: undeformed node positions [m], shape [n, 3].
        positions_m: present node positions [m], shape [n, 3], in any rotated and moved frame.
        tetrahedra: node indices, shape [t, 4].
    """
    return np.asarray(_edges(positions_m, tetrahedra) @ np.linalg.inv(_edges(rest_m, tetrahedra)))


def cauchy_stress_pa(F: FloatArray, *, youngs_modulus_pa: float, poisson_ratio: float) -> FloatArray:
    """Return the true stress of the gels' compressible neo-Hookean material [Pa], shape [t, 3, 3].

        sigma = (mu (B - I) + lambda ln J I) / J,   B = F F^T,   J = det F

    This is P F^T / J of the energy in `envs.fem.elastic.neo_hookean`; Bonet & Wood, Nonlinear Continuum Mechanics for
    Finite Element Analysis (2008), equation 6.29.

    Args:
        F: deformation gradients with positive determinant, shape [t, 3, 3].
        youngs_modulus_pa: [Pa].
        poisson_ratio: [-].
    """
    mu = youngs_modulus_pa / (2.0 * (1.0 + poisson_ratio))
    lam = youngs_modulus_pa * poisson_ratio / ((1.0 + poisson_ratio) * (1.0 - 2.0 * poisson_ratio))
    J = np.linalg.det(F)[:, None, None]
    B = F @ np.swapaxes(F, 1, 2)
    return np.asarray((mu * (B - np.eye(3)) + lam * np.log(J) * np.eye(3)) / J)


def von_mises_pa(stress_pa: FloatArray) -> FloatArray:
    """Return the equivalent stress sqrt(3/2 s : s) with the deviator s [Pa], shape [t, 3, 3] to [t]."""
    pressure = np.trace(stress_pa, axis1=1, axis2=2) / 3.0
    deviator = stress_pa - pressure[:, None, None] * np.eye(3)
    return np.asarray(np.sqrt(1.5 * (deviator * deviator).sum(axis=(1, 2))))


def nodal_means(values: FloatArray, rest_m: FloatArray, tetrahedra: IndexArray) -> FloatArray:
    """Return each node's mean of its tetrahedra's values, weighted by their rest volumes, [t, ...] to [n, ...]."""
    weights = np.repeat(np.abs(np.linalg.det(_edges(rest_m, tetrahedra))), 4)
    nodes, columns = tetrahedra.ravel(), np.repeat(values.reshape(len(values), -1), 4, axis=0).T
    totals = [np.bincount(nodes, weights * column, minlength=len(rest_m)) for column in columns]
    means = np.stack(totals, axis=1) / np.bincount(nodes, weights, minlength=len(rest_m))[:, None]
    return np.asarray(means.reshape(len(rest_m), *values.shape[1:]))


def contact_pressure_pa(stress_pa: FloatArray, positions_m: FloatArray, triangles: IndexArray) -> FloatArray:
    """Return how hard a surface is pressed at its nodes: -n . sigma n, and 0 where it is pulled [Pa], shape [n].

    Args:
        stress_pa: true stress at the nodes [Pa], shape [n, 3, 3].
        positions_m: of the nodes [m], shape [n, 3].
        triangles: of the surface, indices of the nodes, shape [t, 3], all turning the same way.
    """
    corners = positions_m[triangles]
    area_vectors = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(positions_m)
    np.add.at(normals, triangles, area_vectors[:, None, :])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
    return np.asarray(np.maximum(0.0, -np.einsum("ni,nij,nj->n", normals, stress_pa, normals)))


def displacement_m(
    rest_m: FloatArray, positions_m: FloatArray, rotation: FloatArray, translation_m: FloatArray
) -> FloatArray:
    """Return the distance of every node from where it would be in the undeformed gel at this pose [m], shape [n].

    Args:
        rest_m: undeformed node positions in the gel's frame [m], shape [n, 3].
        positions_m: world positions [m], shape [n, 3].
        rotation: world from gel, shape [3, 3].
        translation_m: of the gel's origin in the world [m], shape [3].
    """
    moved = positions_m - (rest_m @ rotation.T + translation_m)
    return np.asarray(np.sqrt((moved * moved).sum(axis=1)))


def _edges(positions_m: FloatArray, tetrahedra: IndexArray) -> FloatArray:
    """Return the edge vectors from corner 0 to corners 1, 2, 3 as columns, shape [t, 3, 3]."""
    corners = positions_m[tetrahedra]
    return np.asarray(np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2))
