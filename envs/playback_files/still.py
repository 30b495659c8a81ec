"""The end of an episode as a picture: the scene of the player as its camera first sees it, on a transparent ground.

Pages show it until the scene itself is drawn, and in its place. View, sizes and colours are those of `view`, `stage`,
`studio` and `gripper` in `viewer`; the table is translucent, so that one picture suits light and dark pages.
"""

from itertools import product
from math import cos, radians, sin, tan
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..drawing.playback import EpisodePlayback
from ..vision.look import unit_normals
from ..vision.optics import Intrinsics
from ..vision.pinhole import CameraPose
from ..vision.rasterizer import RenderedView, rasterize
from .scene import DEFAULT_VIEW, look_up_perspective
from .stage import LOOK, Part, linear, list_framed_points, list_parts

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]
Size = tuple[int, int]

WIDTH_PX: Final = 1680
HEIGHT_PX: Final = 560
"""A player is at most three times as wide as it is high, and shows all of the height."""
_HALF_FIELD, _FILLED, _NARROWEST, _NEAR_M = radians(14.0), 0.9, 1.5, 0.01
_PLACES_IN_PIXEL = ((-0.25, -0.25), (-0.25, 0.25), (0.25, -0.25), (0.25, 0.25))
_SHARP = cos(radians(20.0))
_TO_LIGHT = np.array([-0.9, -0.7, 2.2]) / np.linalg.norm([-0.9, -0.7, 2.2])
_SHADOW_PX, _SHADOW_SLACK_M, _SHADOW_OPACITY = 1024, 5e-4, 0.16
_GRID_M, _FADES_FROM, _TABLE_OPACITY, _INK_OPACITY = 0.01, 0.35, 0.34, 0.55

_TABLE, _GRID = "#7d868e", "#555f68"


class _Camera(NamedTuple):
    """A camera that looks at a point from a direction; its picture has this many rows and columns."""

    pose: CameraPose
    focal_px: float
    size: Size

    @classmethod
    def looking_at(
        cls, middle_m: FloatArray, towards: FloatArray, distance_m: float, half_field: float, size: Size
    ) -> "_Camera":
        """Return one at a distance from what is in the middle of its picture; `towards` leads from there to it."""
        right, up = _across(towards)
        rotation = np.column_stack([right, -up, -towards])
        pose = CameraPose(world_from_camera=rotation, position_m=middle_m + distance_m * towards)
        return cls(pose, 0.5 * size[0] / tan(half_field), size)

    @classmethod
    def framing(cls, points_m: FloatArray, towards: FloatArray) -> "_Camera":
        """Return the player's, which has all points in its picture."""
        axes = np.array([*_across(towards), towards])
        along_m = points_m @ axes.T
        middle = 0.5 * (along_m.min(axis=0) + along_m.max(axis=0))
        right, up, depth = (along_m - middle).T
        reach = np.maximum(np.abs(up), np.abs(right) / _NARROWEST)
        distance_m = (depth + reach / (_FILLED * tan(_HALF_FIELD))).max()
        return cls.looking_at(middle @ axes, towards, float(distance_m), _HALF_FIELD, (HEIGHT_PX, WIDTH_PX))

    def see(
        self, vertices_m: FloatArray, triangles: IndexArray, shift: tuple[float, float] = (0.0, 0.0)
    ) -> RenderedView:
        """Return which triangle is in each pixel, looked at in a place of it [pixel]."""
        height, width = self.size
        centre = (0.5 * width - shift[0], 0.5 * height - shift[1])
        return rasterize(
            self.pose.transform_to_camera(vertices_m),
            triangles,
            Intrinsics(self.focal_px, self.focal_px, *centre),
            height_px=height,
            width_px=width,
            near_m=_NEAR_M,
        )

    def rays(self, shift: tuple[float, float]) -> FloatArray:
        """Return for each pixel the way in the world along which depth grows by one, shape [height, width, 3]."""
        height, width = self.size
        x = (np.arange(width) + 0.5 + shift[0] - 0.5 * width) / self.focal_px
        y = (np.arange(height) + 0.5 + shift[1] - 0.5 * height) / self.focal_px
        right, down, along = self.pose.world_from_camera.T
        return np.asarray(x[None, :, None] * right + y[:, None, None] * down + along)


def draw_still(playback: EpisodePlayback) -> NDArray[np.uint8]:
    """Return red, green, blue and opacity of the last moment, shape [HEIGHT_PX, WIDTH_PX, 4]."""
    return _Scene(playback).picture()


class _Scene:
    """Everything that is seen, where from, and how each triangle is lit."""

    def __init__(self, playback: EpisodePlayback) -> None:
        perspective = look_up_perspective(playback.env_id)
        self._fixed_shift_m = playback.moments[-1].fixed_shift_m
        self._floor_m = float(playback.fixed_m[:, 2].min()) - 5e-5
        view = DEFAULT_VIEW if perspective is None else (perspective.azimuth_deg, perspective.elevation_deg)
        azimuth, elevation = np.radians(view)
        towards = np.array([cos(azimuth) * cos(elevation), sin(azimuth) * cos(elevation), sin(elevation)])
        framed_m = list_framed_points(playback)
        self._camera = _Camera.framing(framed_m, towards)
        low, high = framed_m.min(axis=0), framed_m.max(axis=0)
        self._middle_m, self._radius_m = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))
        parts = list_parts(playback)
        starts = np.cumsum([0, *(len(part.vertices_m) for part in parts)])
        self._vertices_m = np.concatenate([part.vertices_m for part in parts])
        self._triangles = np.concatenate([p.triangles + start for p, start in zip(parts, starts, strict=False)])
        self._normals = unit_normals(self._vertices_m, self._triangles)
        sizes = [len(part.triangles) for part in parts]
        self._part = np.repeat(np.arange(len(parts)), sizes)
        self._is_inked = np.repeat([part.is_inked for part in parts], sizes)
        self._in_shade, self._by_light = self._lit(parts)
        reach_m, half_field = 1.2 * self._radius_m, 0.03  # narrow: nearly parallel, as its rays are
        self._light = _Camera.looking_at(
            self._middle_m, _TO_LIGHT, reach_m / sin(half_field), half_field, (_SHADOW_PX, _SHADOW_PX)
        )
        self._nearest_to_light_m = self._light.see(self._vertices_m, self._triangles).depth_m

    def picture(self) -> NDArray[np.uint8]:
        """Return the mean of looks into several places of each pixel."""
        looks = np.zeros((HEIGHT_PX, WIDTH_PX, 4))
        for shift in _PLACES_IN_PIXEL:
            looks += self._look(shift) / len(_PLACES_IN_PIXEL)
        opacity = looks[..., 3:]
        rgb = _to_screen(looks[..., :3] / np.maximum(opacity, 1e-6))
        return np.asarray((255.0 * np.concatenate([rgb, opacity], axis=2) + 0.5).astype(np.uint8))

    def _lit(self, parts: list[Part]) -> tuple[FloatArray, FloatArray]:
        """Return the light from each triangle: from all around, and from the lamp where nothing shades it."""
        rgb = np.concatenate([np.broadcast_to(part.rgb, (len(part.triangles), 3)) for part in parts])
        up, to_lamp = self._normals[:, 2], self._normals @ _TO_LIGHT
        around, lamp = rgb * (0.42 + 0.22 * up)[:, None], rgb * (0.62 * to_lamp.clip(0.0))[:, None]
        corners = self._vertices_m[self._triangles[:, 0]]
        is_inside = np.einsum("tk,tk->t", self._normals, self._camera.pose.position_m - corners) < 0.0
        for number, part in enumerate(parts):
            if part.section is not None:
                cut = is_inside & (self._part == number)
                around[cut], lamp[cut] = part.section, 0.0
        return around, lamp

    def _look(self, shift: tuple[float, float]) -> FloatArray:
        """Return linear colours, each multiplied by its opacity, and that, shape [height, width, 4]."""
        view, rays = self._camera.see(self._vertices_m, self._triangles, shift), self._camera.rays(shift)
        seen = view.triangle >= 0
        eye_m = self._camera.pose.position_m
        with np.errstate(divide="ignore"):
            to_floor = (self._floor_m - eye_m[2]) / rays[..., 2]
        depth_m = np.where(seen, view.depth_m, np.where(to_floor > 0.0, to_floor, 0.0))
        points_m = eye_m + depth_m[..., None] * rays
        is_lit = self._is_lit(points_m)
        rgba = self._table(points_m, is_lit, ~seen & (to_floor > 0.0))
        number = view.triangle[seen]
        rgb = self._in_shade[number] + self._by_light[number] * is_lit[seen, None]
        ink = _INK_OPACITY * self._has_edge(view)[seen, None]
        rgba[seen, :3] = (1.0 - ink) * rgb + ink * linear(LOOK["ink"])
        rgba[seen, 3] = 1.0
        return rgba

    def _table(self, points_m: FloatArray, is_lit: FloatArray, is_table: NDArray[np.bool_]) -> FloatArray:
        place_m = points_m[is_table, :2]
        away = np.linalg.norm(place_m - self._middle_m[:2], axis=1) / (3.0 * self._radius_m)
        part = ((away - _FADES_FROM) / (1.0 - _FADES_FROM)).clip(0.0, 1.0)
        fade = 1.0 - part * part * (3.0 - 2.0 * part)
        on_grid = (place_m + self._fixed_shift_m[:2]) / _GRID_M
        from_line_m = np.abs(on_grid - np.round(on_grid)).min(axis=1) * _GRID_M
        width_m = 2.5 * self._radius_m / HEIGHT_PX
        is_line = (1.0 - from_line_m / width_m).clip(0.0, 1.0)[:, None]
        shade = _SHADOW_OPACITY * (1.0 - is_lit[is_table]) * fade
        table = (_TABLE_OPACITY * fade)[:, None]
        rgba = np.zeros((*is_table.shape, 4))
        rgb = linear(_TABLE) + 0.6 * is_line * (linear(_GRID) - linear(_TABLE))
        rgba[is_table, :3] = rgb * table * (1.0 - shade[:, None])
        rgba[is_table, 3] = 1.0 - (1.0 - table[:, 0]) * (1.0 - shade)
        return rgba

    def _is_lit(self, points_m: FloatArray) -> FloatArray:
        """Return how much of the lamp each point sees, 0 to 1, from four places of its picture around the point."""
        seen_m = (points_m - self._light.pose.position_m) @ self._light.pose.world_from_camera
        u, v = self._light.focal_px * (seen_m[..., :2] / seen_m[..., 2:]).transpose(2, 0, 1) + 0.5 * _SHADOW_PX
        lit = np.zeros(u.shape)
        for du, dv in product((-3.0, 3.0), repeat=2):
            columns, rows = ((at + d).astype(int).clip(0, _SHADOW_PX - 1) for at, d in ((u, du), (v, dv)))
            nearest_m = self._nearest_to_light_m[rows, columns]
            lit += (nearest_m == 0.0) | (seen_m[..., 2] < nearest_m + _SHADOW_SLACK_M)
        return lit / 4.0

    def _has_edge(self, view: RenderedView) -> NDArray[np.bool_]:
        """Return the pixels whose neighbour to the right or below is beyond an edge of a part with ink."""
        is_inked, part, normals = (
            np.append(values, values[:1], axis=0)[view.triangle]
            for values in (self._is_inked, self._part, self._normals)
        )
        inked = is_inked.astype(bool) & (view.triangle >= 0)
        is_edge = np.zeros(view.triangle.shape, dtype=bool)
        for here, there in ((np.s_[:-1], np.s_[1:]), (np.s_[:, :-1], np.s_[:, 1:])):
            folds = np.einsum("...k,...k", normals[here], normals[there]) < _SHARP
            is_edge[here] |= (inked[here] | inked[there]) & (folds | (part[here] != part[there]))
        return is_edge


def _across(towards: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the directions to the right and upwards in a picture of a camera that is in a direction."""
    right = np.cross([0.0, 0.0, 1.0], towards)
    right /= np.linalg.norm(right)
    return right, np.cross(towards, right)


def _to_screen(light: FloatArray) -> FloatArray:
    light = light.clip(0.0, 1.0)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1.0 / 2.4) - 0.055)
