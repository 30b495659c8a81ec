"""The scene as a picture: gels in colours, the held part like glass, the fixed part cut open. Used by `picture`."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..scene.perspective import Perspective
from .playback import Moment, Playback
from .projection.camera import ParallelCamera
from .projection.edges import sharp_edges, unique_edges, unit_normals, visible_lines
from .projection.section import section_loops_m
from .projection.shading import CUT_COLOUR, FIXED_COLOUR, HELD_COLOUR, ColourMap, averaged, lit, seen_through
from .projection.visibility import NOTHING, Visible

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

    def __init__(self, playback: Playback, perspective: Perspective, *, width_px: int, height_px: int) -> None:
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
