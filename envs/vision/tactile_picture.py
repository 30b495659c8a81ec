"""The picture that a sensor's inner camera takes of its gel: shaded by three coloured lights, with the markers as dots.

Shading as in the challenge (Phong's model), but of the gel's own deformed surface where that lies
nearer to the camera than the body that it touches, against the undeformed gel, with the dots where `marker_flow` sees
the markers, and with noise in every pixel that follows from the episode's seed. Only exactly rounded operations in a
fixed order, so the bits are the same on every machine. Channels are blue, green, red, as in the challenge.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..compilation import kernel, large_kernel
from ..fem.algebra import Vec3
from ..fem.model.mesh import GelMesh
from ..observable import noise_digest
from ..scene.grasped_scene import GraspedScene
from ..tactile.camera import CHALLENGE_CAMERA, CameraIntrinsics, camera_frame
from ..tactile.gel import eye_distance_m, highest_mm
from .look import draw_noise
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

# Direction to the light of each channel, blue, green and red (not normalised), and what Phong's model makes of it.
_LIGHTS = ((0.0, 1.0, 0.344), (1.0, 0.0, 0.344), (0.0, -1.0, 0.344))
_BRIGHTNESS = 155.0
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

_CHANNELS = 3
# Noise of every pixel and channel, in levels of 255, and which child of the episode's seed it follows from.
_NOISE_SD = 1.0
_NOISE_STREAM = 0x7AC71E

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
        self._at_rest = self._shaded(at_rest_m, np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))
        self._background = _background()

    def picture(
        self,
        gel_m: FloatArray,
        body_m: FloatArray,
        body_triangles: IndexArray,
        markers_px: FloatArray,
        noise_key: int | None = None,
    ) -> TactilePicture:
        """Take a picture, shape [240, 320, 3], blue, green, red.

        Args:
            gel_m: positions of all gel nodes in the camera frame [m], shape [n, 3].
            body_m: vertices of the body that the gel touches, in the camera frame [m], shape [v, 3].
            body_triangles: its triangles, shape [t, 3].
            markers_px: where the camera sees the markers (u, v), shape [m, 2]: the current ones of `marker_flow`.
            noise_key: number that the noise of all pixels is made of; None for a picture without noise.
        """
        change = self._shaded(gel_m, body_m, body_triangles)
        change -= self._at_rest
        share, picture = np.ones((HEIGHT_PX, WIDTH_PX)), np.empty((HEIGHT_PX, WIDTH_PX, _CHANNELS), dtype=np.uint8)
        _dim_dots(markers_px, share)
        noise_sd, key = (0.0, np.uint64(0)) if noise_key is None else (_NOISE_SD, np.uint64(noise_key))
        _expose(self._background, _blurred(change, _COLOUR_RADIUS_PX), share, noise_sd, key, picture)
        return picture

    def _shaded(self, gel_m: FloatArray, body_m: FloatArray, body_triangles: IndexArray) -> FloatArray:
        """Return the colours of whatever is nearer to the camera, gel or body, 0 to 255, shape [3, 240, 320]."""
        vertices_m = np.concatenate([gel_m, body_m])
        triangles = np.concatenate([self._triangles, body_triangles + len(gel_m)])
        view = rasterize(
            vertices_m, triangles, self._intrinsics, height_px=HEIGHT_PX, width_px=WIDTH_PX, near_m=_NEAR_M
        )
        depth_m = np.where(view.depth_m > 0.0, view.depth_m, self._beyond_gel_m)
        shaded = np.empty((_CHANNELS, HEIGHT_PX, WIDTH_PX))
        depth_px = _blurred(depth_m[None], _DEPTH_RADIUS_PX)[0] / _PIXEL_M
        _shade(np.pad(depth_px, 1, mode="edge"), shaded)
        return shaded


def draw_tactile_pictures(scene: GraspedScene, random: np.random.Generator) -> TactilePicture:
    """Return the pictures of the left and the right sensor, shape [2, 240, 320, 3], blue, green, red.

    Args:
        scene: what they hold.
        random: the episode's generator; markers are drawn from it where none have been since the last motion.
    """
    camera, distance_m = _camera(scene.gel, scene.camera), eye_distance_m(scene.gel)
    flow = scene.last_marker_flow(random)
    held, pictures = scene.held_surface, []
    held_m = scene.held_vertices_m(np.arange(len(held.vertices_m)))
    for index, noise_key in enumerate(_noise_keys(random, flow)):
        pose = scene.sensor_pose(index)
        gel_m, body_m = (
            camera_frame(points_m, pose.rotation, pose.centre_m, distance_m)
            for points_m in (scene.gel_nodes_m(index), held_m)
        )
        markers_px = flow[index, 1].astype(np.float64)
        pictures.append(camera.picture(gel_m, body_m, held.triangles, markers_px, noise_key))
    return np.stack(pictures)


def _noise_keys(random: np.random.Generator, flow: NDArray[np.float32]) -> list[int]:
    """Return a number for the noise of each picture, from the episode's seed and its markers; nothing is drawn."""
    digest = noise_digest(random, _NOISE_STREAM, flow.astype("<f4").tobytes())
    keys: list[int] = np.frombuffer(digest, "<u8")[: len(flow)].tolist()
    return keys


@lru_cache(maxsize=4)
def _camera(mesh: GelMesh, camera: CameraIntrinsics) -> TactileCamera:
    return TactileCamera(mesh, camera)


@large_kernel
def _shade(depth_px: FloatArray, shaded: FloatArray) -> None:
    """Write the colours of a surface by Phong's model, 0 to 255; its depth [px] has a frame of one pixel."""
    _, height, width = shaded.shape
    for j in range(height):
        above, here, below = depth_px[j], depth_px[j + 1], depth_px[j + 2]
        for i in range(width):
            # The normal towards the camera: the surface rises where the depth falls.
            slope_u, slope_v = (here[i + 2] - here[i]) / 2.0, (below[i + 1] - above[i + 1]) / 2.0
            length = np.sqrt(slope_u * slope_u + slope_v * slope_v + 1.0)
            normal = (slope_u / length, slope_v / length, 1.0 / length)
            shaded[0, j, i] = _lit(normal, _LIGHTS[0])
            shaded[1, j, i] = _lit(normal, _LIGHTS[1])
            shaded[2, j, i] = _lit(normal, _LIGHTS[2])


@kernel
def _lit(normal: Vec3, light: Vec3) -> float:
    """Return how bright a surface is under a light."""
    cosine = normal[0] * light[0] + normal[1] * light[1] + normal[2] * light[2]
    mirrored_z = max(2.0 * cosine * normal[2] - light[2], 0.0)
    squared = mirrored_z * mirrored_z
    brightness = _DIFFUSE * max(cosine, 0.0) + _SPECULAR * squared * squared * mirrored_z
    return min(max(brightness * _BRIGHTNESS, 0.0), 255.0)


def _blurred(planes: FloatArray, radius_px: int) -> FloatArray:
    """Return pictures of shape [c, height, width] under a Gaussian of 2 px, cut off; edges are continued."""
    weights = np.array([_GAUSSIAN[abs(k)] for k in range(-radius_px, radius_px + 1)])
    blurred, row = np.zeros_like(planes), np.empty(planes.shape[2] + 2 * radius_px)
    _blur(planes, weights / weights.sum(), row, blurred)
    return blurred


@large_kernel
def _blur(planes: FloatArray, weights: FloatArray, row: FloatArray, blurred: FloatArray) -> None:
    """Add what is blurred downwards, then across; `row` has room for a row and the radius on both sides."""
    count, height, width = planes.shape
    radius = len(weights) // 2
    middle = row[radius : radius + width]
    for c in range(count):
        for j in range(height):
            middle[:] = 0.0
            for k in range(len(weights)):
                _add_multiple(weights[k], planes[c, min(max(j + k - radius, 0), height - 1)], middle)
            row[:radius] = middle[0]
            row[radius + width :] = middle[width - 1]
            for k in range(len(weights)):
                _add_multiple(weights[k], row[k : k + width], blurred[c, j])


@kernel
def _add_multiple(factor: float, source: FloatArray, target: FloatArray) -> None:
    for i in range(len(target)):
        target[i] += factor * source[i]


@large_kernel
def _dim_dots(markers_px: FloatArray, share: FloatArray) -> None:
    """Write the share of the light that the dots let through, where it is less; the darker of two that overlap."""
    height, width = share.shape
    for m in range(len(markers_px)):
        u, v = markers_px[m, 0], markers_px[m, 1]
        column, row = int(np.floor(u)), int(np.floor(v))
        for j in range(max(row - _DOT_REACH_PX, 0), min(row + _DOT_REACH_PX + 1, height)):
            away_v = j + 0.5 - v
            for i in range(max(column - _DOT_REACH_PX, 0), min(column + _DOT_REACH_PX + 1, width)):
                away_u = i + 0.5 - u
                distance_px = np.sqrt(away_u * away_u + away_v * away_v)
                let_through = min(max((distance_px - _DOT_RADIUS_PX) / _DOT_EDGE_PX + 0.5, 0.0), 1.0)
                share[j, i] = min(share[j, i], let_through)


@large_kernel
def _expose(
    background: FloatArray,
    change: FloatArray,
    share: FloatArray,
    noise_sd: float,
    noise_key: np.uint64,
    picture: TactilePicture,
) -> None:
    """Write the picture of an untouched gel with the change of its colours, behind dots, and with noise."""
    height, width, channels = picture.shape
    for j in range(height):
        for i in range(width):
            for c in range(channels):
                light = (background[j, i, c] + change[c, j, i]) * share[j, i]
                if noise_sd > 0.0:
                    light += noise_sd * draw_noise(noise_key, np.uint64((j * width + i) * channels + c))
                picture[j, i, c] = np.uint8(min(max(light, 0.0), 255.0))


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
