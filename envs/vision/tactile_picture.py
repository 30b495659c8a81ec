"""The picture that a sensor's inner camera takes of its gel: shaded by three coloured lights, with the markers as dots.

Shading as in the challenge (Phong's model, challenge-facts 4.4), but of the gel's own deformed surface where that lies
nearer to the camera than the body that it touches, against the undeformed gel, and with the dots where `marker_flow`
sees the markers. Channels are blue, green, red, as in the challenge's `rgb_images`.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..fem.model.mesh import GelMesh
from ..scene.grasped_scene import GraspedScene
from ..tactile.camera import CHALLENGE_CAMERA, CameraIntrinsics, camera_frame
from ..tactile.thickness import eye_distance_m, highest_mm
from .optics import TACTILE_HEIGHT_PX as HEIGHT_PX
from .optics import TACTILE_WIDTH_PX as WIDTH_PX
from .optics import Intrinsics
from .rasterizer import rasterize

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]
TactilePicture = NDArray[np.uint8]

_NEAR_M = 1e-4
# Depth that one pixel is wide, for slopes.
_PIXEL_M = 6e-5

# Direction to each light (not normalised), its colour (blue, green, red), and what Phong's model makes of it.
_LIGHTS = (
    ((1.0, 0.0, 0.344), (0.0, 155.0, 0.0)),
    ((0.0, -1.0, 0.344), (0.0, 0.0, 155.0)),
    ((0.0, 1.0, 0.344), (155.0, 0.0, 0.0)),
)
_DIFFUSE = 0.6
_SPECULAR = 0.1
# exp(-k^2 / 8) for k = 0, 1, ...: a Gaussian of 2 px. Written out, since exponentials differ between machines.
_GAUSSIAN = (
    *(1.0, 0.8824969025845955, 0.6065306597126334, 0.32465246735834974, 0.1353352832366127),
    *(0.04393693362340742, 0.011108996538242306, 0.0021874911181828851, 0.00033546262790251185),
)
_DEPTH_RADIUS_PX = 8
_COLOUR_RADIUS_PX = 2

# Dots are black discs of radius 3 px whose edge is 1.7 px wide.
_DOT_RADIUS_PX = 3.0
_DOT_EDGE_PX = 1.7
_DOT_REACH_PX = 5

# An untouched gel under the three lights: red, green and blue at these rows and columns, in between interpolated.
_BACKGROUND_ROWS = (10.0, 60.0, 120.0, 180.0, 230.0)
_BACKGROUND_COLUMNS = (10.0, 80.0, 160.0, 240.0, 310.0)
_BACKGROUND_RGB = (
    ((39, 74, 65), (64, 98, 84), (77, 112, 93), (61, 104, 83), (36, 92, 67)),
    ((48, 80, 85), (85, 112, 108), (109, 129, 122), (82, 118, 109), (44, 104, 87)),
    ((48, 84, 115), (91, 120, 157), (117, 137, 176), (90, 125, 158), (45, 111, 115)),
    ((28, 85, 107), (51, 117, 141), (66, 134, 158), (52, 122, 140), (30, 107, 104)),
    ((18, 76, 92), (24, 103, 120), (46, 119, 134), (43, 109, 117), (24, 96, 88)),
)


class TactileCamera:
    """Takes pictures of a gel from inside; knows how the undeformed gel looks."""

    def __init__(self, mesh: GelMesh, camera: CameraIntrinsics = CHALLENGE_CAMERA) -> None:
        self._intrinsics = Intrinsics(*camera)
        # The back face stands between the camera and the sensing face.
        is_back = mesh.driven[mesh.surface_triangles].all(axis=1)
        self._triangles: IndexArray = np.ascontiguousarray(mesh.surface_triangles[~is_back])
        # Where a gel does not reach the picture's edge: its undeformed sensing face.
        self._beyond_gel_m = eye_distance_m(mesh) + highest_mm(mesh) * 1e-3
        at_rest_m = camera_frame(mesh.rest_position_m, np.eye(3), np.zeros(3), eye_distance_m(mesh))
        self._at_rest = _shaded(self._depth_m(at_rest_m, np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)))
        self._background = _background()

    def picture(
        self, gel_m: FloatArray, body_m: FloatArray, body_triangles: IndexArray, markers_px: FloatArray
    ) -> TactilePicture:
        """Take a picture, shape [240, 320, 3], blue, green, red.

        Args:
            gel_m: positions of all gel nodes in the camera frame [m], shape [n, 3].
            body_m: vertices of the body that the gel touches, in the camera frame [m], shape [v, 3].
            body_triangles: its triangles, shape [t, 3].
            markers_px: where the camera sees the markers (u, v), shape [m, 2]: the current ones of `marker_flow`.
        """
        change = _shaded(self._depth_m(gel_m, body_m, body_triangles)) - self._at_rest
        shaded = self._background + _blurred(change, _COLOUR_RADIUS_PX)
        dotted = shaded * _dim_dots(markers_px)[:, :, None]
        return np.clip(dotted, 0.0, 255.0).astype(np.uint8)

    def _depth_m(self, gel_m: FloatArray, body_m: FloatArray, body_triangles: IndexArray) -> FloatArray:
        """Return the depth of whatever is nearer to the camera, gel or body [m], shape [240, 320]."""
        vertices_m = np.concatenate([gel_m, body_m])
        triangles = np.concatenate([self._triangles, body_triangles + len(gel_m)])
        view = rasterize(
            vertices_m, triangles, self._intrinsics, height_px=HEIGHT_PX, width_px=WIDTH_PX, near_m=_NEAR_M
        )
        return np.where(view.depth_m > 0.0, view.depth_m, self._beyond_gel_m)


def draw_tactile_pictures(scene: GraspedScene, random: np.random.Generator) -> TactilePicture:
    """Return the pictures of the left and the right sensor, shape [2, 240, 320, 3], blue, green, red.

    Args:
        scene: what they hold.
        random: the episode's generator; markers are drawn from it where none have been since the last motion.
    """
    camera, distance_m = _camera(scene.gel, scene.camera), eye_distance_m(scene.gel)
    flow = scene.last_marker_flow(random)
    held, pictures = scene.held.mesh, []
    held_m = scene.held_vertices_m(np.arange(len(held.vertices_m)))
    for index in range(len(flow)):
        pose = scene.sensor_pose(index)
        gel_m, body_m = (
            camera_frame(points_m, pose.rotation, pose.centre_m, distance_m)
            for points_m in (scene.gel_nodes_m(index), held_m)
        )
        pictures.append(camera.picture(gel_m, body_m, held.triangles, flow[index, 1].astype(np.float64)))
    return np.stack(pictures)


@lru_cache(maxsize=4)
def _camera(mesh: GelMesh, camera: CameraIntrinsics) -> TactileCamera:
    return TactileCamera(mesh, camera)


def _shaded(depth_m: FloatArray) -> FloatArray:
    """Return the colour of a surface by Phong's model, 0 to 255, shape [240, 320, 3]."""
    depth_px = _blurred(depth_m[:, :, None], _DEPTH_RADIUS_PX)[:, :, 0] / _PIXEL_M
    framed = np.pad(depth_px, 1, mode="edge")
    # The normal towards the camera: the surface rises where the depth falls.
    slope_u = (framed[1:-1, 2:] - framed[1:-1, :-2]) / 2.0
    slope_v = (framed[2:, 1:-1] - framed[:-2, 1:-1]) / 2.0
    length = np.sqrt(slope_u * slope_u + slope_v * slope_v + 1.0)
    normal_u, normal_v, normal_z = slope_u / length, slope_v / length, 1.0 / length
    total = np.zeros((*depth_m.shape, 3))
    for (light_u, light_v, light_z), colour in _LIGHTS:
        cosine = normal_u * light_u + normal_v * light_v + normal_z * light_z
        mirrored_z = np.maximum(2.0 * cosine * normal_z - light_z, 0.0)
        squared = mirrored_z * mirrored_z
        brightness = _DIFFUSE * np.maximum(cosine, 0.0) + _SPECULAR * squared * squared * mirrored_z
        total += brightness[:, :, None] * np.array(colour)
    return np.clip(total, 0.0, 255.0)


def _blurred(picture: FloatArray, radius_px: int) -> FloatArray:
    """Return a picture of shape [height, width, c] under a Gaussian of 2 px, cut off; edges are continued."""
    weights = np.array([_GAUSSIAN[abs(k)] for k in range(-radius_px, radius_px + 1)])
    weights = weights / weights.sum()
    height, width, _ = picture.shape
    framed = np.pad(picture, ((radius_px, radius_px), (0, 0), (0, 0)), mode="edge")
    down = sum((weight * framed[k : k + height] for k, weight in enumerate(weights)), np.zeros(picture.shape))
    framed = np.pad(down, ((0, 0), (radius_px, radius_px), (0, 0)), mode="edge")
    return sum((weight * framed[:, k : k + width] for k, weight in enumerate(weights)), np.zeros(picture.shape))


def _dim_dots(markers_px: FloatArray) -> FloatArray:
    """Share of the light that the dots let through, shape [240, 320]; the darker of two that overlap."""
    share = np.ones((HEIGHT_PX, WIDTH_PX))
    steps = np.arange(-_DOT_REACH_PX, _DOT_REACH_PX + 1)
    first = np.floor(markers_px).astype(np.int64)
    columns = first[:, 0, None, None] + steps[None, None, :] + np.zeros_like(steps)[None, :, None]
    rows = first[:, 1, None, None] + steps[None, :, None] + np.zeros_like(steps)[None, None, :]
    away_u = columns + 0.5 - markers_px[:, 0, None, None]
    away_v = rows + 0.5 - markers_px[:, 1, None, None]
    distance_px = np.sqrt(away_u * away_u + away_v * away_v)
    let_through = np.clip((distance_px - _DOT_RADIUS_PX) / _DOT_EDGE_PX + 0.5, 0.0, 1.0)
    inside = (columns >= 0) & (columns < WIDTH_PX) & (rows >= 0) & (rows < HEIGHT_PX)
    np.minimum.at(share, (rows[inside], columns[inside]), let_through[inside])
    return share


def _background() -> FloatArray:
    """Return the picture of an untouched gel between its known places, shape [240, 320, 3], blue, green, red."""
    known = np.array(_BACKGROUND_RGB, dtype=np.float64)[:, :, ::-1]
    across = _interpolated(known.transpose(1, 0, 2), np.array(_BACKGROUND_COLUMNS), WIDTH_PX)
    return _interpolated(across.transpose(1, 0, 2), np.array(_BACKGROUND_ROWS), HEIGHT_PX)


def _interpolated(known: FloatArray, places: FloatArray, count: int) -> FloatArray:
    """Return the values at 0, 1, ... along the first axis, linear between known places and constant beyond them."""
    at = np.clip(np.arange(count), places[0], places[-1])
    after = np.clip(np.searchsorted(places, at, side="right"), 1, len(places) - 1)
    share = ((at - places[after - 1]) / (places[after] - places[after - 1]))[:, None, None]
    return np.asarray((1.0 - share) * known[after - 1] + share * known[after])
