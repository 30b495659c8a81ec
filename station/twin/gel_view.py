"""What the camera of a twin's tactile sensor sees, and pictures of a gel whose markers move in a known way."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from vitac.envs.fem.model.mesh import GelMesh
from vitac.envs.scene.gripper import SensorPose
from vitac.envs.tactile.camera import CHALLENGE_CAMERA, CameraMount, camera_frame, project
from vitac.envs.tactile.design import SensorDesign
from vitac.envs.tactile.gel import eye_distance_m
from vitac.envs.tactile.markers import interpolated
from vitac.envs.vision.tactile_picture import TactileCamera

from .hidden import HiddenSensor
from .pictures import SUBPIXELS, GelCamera
from .structure import HiddenStructure, Print

Positions = NDArray[np.float64]

_LIGHT_PX: Final = 60.0
"""Mean movement of the markers at which the light has shifted by the half width of the picture."""
WORN_DARKNESS: Final = 0.35
"""Darkness that is left of a worn marker."""
_GLARE_PICTURES: Final = 3


SMALL_CAMERA: Final = GelCamera(width=448, height=338)
"""Its cut picture has the camera's own pixels, which is the fastest to render."""


def marker_grid(rows: int = 7, columns: int = 9, spacing_px: float = 32.0) -> Positions:
    """Return the centres of printed markers in the cut picture, shape [rows * columns, 2] [pixel]."""
    x = _MIDDLE_PX[0] + spacing_px * (np.arange(columns) - (columns - 1) / 2)
    y = _MIDDLE_PX[1] + spacing_px * (np.arange(rows) - (rows - 1) / 2)
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


@dataclass(frozen=True, kw_only=True)
class Press:
    """What is done to a gel: it grows from nothing and goes back, strongest in the middle of the picture.

    Attributes:
        shear_px: movement along u and v.
        twist_rad: rotation about the middle.
        spread: relative distance from the middle that is added.
        width_px: standard deviation of the bell that all of them have over the picture.
        still: pictures at rest before.
        pictures: pictures in all.
    """

    shear_px: tuple[float, float] = (0.0, 0.0)
    twist_rad: float = 0.0
    spread: float = 0.0
    width_px: float = 120.0
    still: int = 15
    pictures: int = 60

    def markers(self, rest_px: Positions, picture: int) -> Positions:
        """Return where markers are in a picture, shape [n, 2] [pixel]."""
        part = np.sin(np.pi * max(picture - self.still, 0) / (self.pictures - self.still))
        arm = rest_px - _MIDDLE_PX
        bell = np.exp(-0.5 * (arm**2).sum(axis=1, keepdims=True) / self.width_px**2)
        turned = np.stack((-arm[:, 1], arm[:, 0]), axis=1)
        moved: Positions = rest_px + part * bell * (self.shear_px + self.twist_rad * turned + self.spread * arm)
        return moved


class Seen(NamedTuple):
    """A picture of a camera, and where its markers are in the cut picture, shape [n, 2] [pixel]."""

    picture: NDArray[np.uint8]
    markers_px: Positions


@dataclass(frozen=True, kw_only=True)
class PressedGel:
    """A gel that is pressed before its camera.

    Attributes:
        press: what is done to it.
        camera: what it is seen by.
        seed: of the noise, the places of its markers, and which of them are worn or dazzled.
        misprint_px: largest distance of a marker from its grid along u and v.
        worn: number of pale markers.
        dazzled: number of markers that vanish for three pictures in the middle, as under glare.
    """

    press: Press
    camera: GelCamera = field(default_factory=GelCamera)
    seed: int = 0
    misprint_px: float = 1.0
    worn: int = 0
    dazzled: int = 0

    def pictures(self) -> Iterator[Seen]:
        """Yield its pictures."""
        generator = np.random.default_rng(self.seed)
        rest_px = marker_grid()
        rest_px += generator.uniform(-self.misprint_px, self.misprint_px, rest_px.shape)
        chosen = generator.permutation(len(rest_px))
        worn, dazzled = chosen[: self.worn], chosen[self.worn : self.worn + self.dazzled]
        for number in range(self.press.pictures):
            darkness = np.full(len(rest_px), self.camera.darkness)
            darkness[worn] *= WORN_DARKNESS
            if 0 <= number - self.press.pictures // 2 < _GLARE_PICTURES:
                darkness[dazzled] = 0.0
            markers_px = self.press.markers(rest_px, number)
            tilt_x, tilt_y = (markers_px - rest_px).mean(axis=0) / _LIGHT_PX
            picture = self.camera.picture(markers_px, generator, darkness=darkness, tilt=(tilt_x, tilt_y))
            yield Seen(picture, markers_px)


FloatArray = NDArray[np.float64]
Picture = NDArray[np.uint8]

_MIDDLE_PX: Final = np.array((160.0, 120.0))
_WIDTH, _HEIGHT = 448, 338
_NO_BODY: Final = (np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))
_UNMOVED_M: Final = 1e-6
"""A marker moves by less than a fiftieth of a pixel then."""
_PICTURE_ROWS: Final = 240.0
_AGES_PER_H: Final = 100
"""So often the light is another one."""
_SCATTER: Final = 1
"""Sets the scatter of the print apart from all else that is drawn from a sensor's seed."""
_NO_STRUCTURE: Final = HiddenStructure()
_TORN_PX: Final = 70.0
"""Radius of what a tear takes out of the picture."""
_TORN_AT_PX: Final = np.array((190.0, 110.0))


class PrintedMarkers:
    """Markers on the face of a gel.

    Attributes:
        count: how many are on it.

    Args:
        gel: that carries them.
        grid_px: where they are in the picture of a gel at rest, shape [n, 2] [pixel].
    """

    def __init__(self, gel: GelMesh, grid_px: FloatArray) -> None:
        self._eye_m = eye_distance_m(gel)
        top_m = float(gel.rest_position_m[:, 2].max()) + self._eye_m
        in_camera_m = (grid_px - CHALLENGE_CAMERA[2:]) * top_m / np.array(CHALLENGE_CAMERA[:2])
        triangles = gel.surface_triangles
        design = SensorDesign(
            gel=gel,
            sensing_triangles=triangles[gel.sensing[triangles].all(axis=1)],
            camera=CHALLENGE_CAMERA,
            markers_mm=-1e3 * in_camera_m,
        ).attachment
        attached = design.faults == 0
        self._corners, self._weights = triangles[design.triangles[attached]], design.weights[attached]
        self.count = len(self._corners)

    def in_camera_m(self, points_m: FloatArray, pose: SensorPose) -> FloatArray:
        """Return points of the world in the frame of the sensor's camera, shape [n, 3] [m]."""
        return camera_frame(np.ascontiguousarray(points_m), pose.rotation, pose.centre_m, self._eye_m)

    def project_px(self, gel_m: FloatArray) -> FloatArray:
        """Return where an ideal camera sees them, shape [n, 2] [pixel], on a gel with nodes in its frame [m]."""
        return project(interpolated(gel_m, self._corners, self._weights), CHALLENGE_CAMERA)


def see_through_lens(sensor: HiddenSensor, positions_px: FloatArray) -> FloatArray:
    """Return where a camera really sees places of the cut picture, as it is mounted and distorts."""
    return CameraMount(*sensor.shift_px, sensor.turn_deg, sensor.distortion).see(positions_px)


class GelView:
    """A camera behind a gel with printed markers.

    Attributes:
        markers: how many there are.
    """

    def __init__(
        self, gel: GelMesh, sensor: HiddenSensor, structure: HiddenStructure = _NO_STRUCTURE, period_s: float = 0.04
    ) -> None:
        self._gel, self._sensor, self._structure, self._period_s = gel, sensor, structure, period_s
        self._shown_px: FloatArray | None = None
        self._generator = np.random.default_rng(sensor.seed)
        self._camera = GelCamera(width=_WIDTH, height=_HEIGHT, defocus_px=sensor.defocus_px)
        self._noise = self._generator.normal(0.0, sensor.noise, (2 * _HEIGHT, 2 * _WIDTH, 3)).astype(np.float32)
        self._seen_m: FloatArray | None = None
        self._lit_as: tuple[int, bool, int, bool] | None = None
        self._surface_camera = TactileCamera(gel)
        self._attach()
        self.look_at_rest()

    def look_at_rest(self) -> None:
        """See the gel without anything at it."""
        at_rest = SensorPose(rotation=np.eye(3), centre_m=np.zeros(3))
        self.look(self._gel.rest_position_m, at_rest, *_NO_BODY)

    def look(self, nodes_m: FloatArray, pose: SensorPose, body_m: FloatArray, triangles: NDArray[np.int64]) -> None:
        """See the gel as it is now.

        Args:
            nodes_m: positions of its nodes in the world, shape [n, 3].
            pose: of the sensor.
            body_m: vertices of what it touches, in the world, shape [v, 3].
            triangles: of that, shape [t, 3].
        """
        gel_m, held_m = (self._printed.in_camera_m(points_m, pose) for points_m in (nodes_m, body_m))
        if self._seen_m is not None and np.abs(gel_m - self._seen_m).max() < _UNMOVED_M:
            return
        self._seen_m, self._lit_as = gel_m, None
        seen = self._surface_camera.picture(gel_m, held_m, triangles, np.zeros((0, 2)))
        self._cut = self._through_lens(seen)
        self._markers_px = see_through_lens(self._sensor, self._printed.project_px(gel_m))

    def picture(self, *, drift_px: float = 0.0, is_torn: bool = False, age_h: float = 0.0) -> Picture:
        """Take a picture of the camera, blue first.

        Args:
            drift_px: by which the markers have left their places.
            is_torn: whether a part of the gel is gone.
            age_h: since the light was new [h].
        """
        state = round(drift_px * SUBPIXELS), is_torn, round(age_h * _AGES_PER_H), self._is_moving()
        if self._lit_as != state:
            self._lit, self._lit_as = self._light(state[0] / SUBPIXELS, is_torn), state
            if any(self._structure.fading_h):
                self._lit *= np.exp(-age_h * np.array(self._structure.fading_h, np.float32))
        self._shown_px = self._markers_px
        rows, columns = self._generator.integers((_HEIGHT, _WIDTH)).tolist()
        return self._camera.expose(self._lit, self._noise[rows : rows + _HEIGHT, columns : columns + _WIDTH])

    def _is_moving(self) -> bool:
        """Say whether a marker moves by more than its print resolves while the shutter reads a picture."""
        if self._shown_px is None:
            return False
        open_s = self._structure.readout_s + self._structure.exposure_s
        way_px = np.abs(self._markers_px - self._shown_px) * open_s / self._period_s
        return bool(way_px.max() * SUBPIXELS > 1.0)

    def _light(self, drift_px: float, is_torn: bool) -> NDArray[np.float32]:
        markers_px, darkness, cut = self._markers_px + drift_px, self._darkness, self._cut
        smear_px = None
        if self._shown_px is not None and self._is_moving():
            velocity_px_s = (self._markers_px - self._shown_px) / self._period_s
            late_s = self._structure.readout_s * (1.0 - markers_px[:, 1:] / _PICTURE_ROWS)  # the last row is read last
            markers_px = markers_px - late_s * velocity_px_s
            smear_px = self._structure.exposure_s * velocity_px_s
        if is_torn:
            is_whole = np.linalg.norm(markers_px - _TORN_AT_PX, axis=1) > _TORN_PX
            markers_px, darkness = markers_px[is_whole], darkness[is_whole]
            smear_px = smear_px[is_whole] if smear_px is not None else None
            cut = _tear(cut)
        return self._camera.print_markers(self._camera.framed(cut), markers_px, darkness, smear_px)

    @property
    def markers(self) -> int:
        """Number of printed markers."""
        return self._printed.count

    def _attach(self) -> None:
        """Print the markers of the challenge's grid, each a little beside its place, and wear some of them off."""
        grid_px = marker_grid()
        grid_px += self._generator.uniform(-self._sensor.misprint_px, self._sensor.misprint_px, grid_px.shape)
        if self._structure.print is not None:
            grid_px = print_off(self._structure.print, grid_px, np.random.default_rng((self._sensor.seed, _SCATTER)))
        self._printed = PrintedMarkers(self._gel, grid_px)
        self._darkness = np.full(self._printed.count, self._camera.darkness)
        self._darkness[self._generator.permutation(self._printed.count)[: self._sensor.worn]] *= WORN_DARKNESS

    def _through_lens(self, surface: Picture) -> Picture:
        """Return the surface under the sensor's light, moved as its camera is mounted."""
        import cv2

        turn = cv2.getRotationMatrix2D((160.0, 120.0), -self._sensor.turn_deg, 1.0)
        turn[:, 2] += np.array(self._sensor.shift_px)
        moved = cv2.warpAffine(surface, turn, (320, 240), borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(np.clip(moved * self._sensor.light, 0, 255), dtype=np.uint8)


def print_off(off: Print, grid_px: FloatArray, generator: np.random.Generator) -> FloatArray:
    """Return where markers are printed in place of a grid."""
    sine, cosine = np.sin(np.radians(off.turn_deg)), np.cos(np.radians(off.turn_deg))
    arm = (grid_px - _MIDDLE_PX) * (1.0 + off.stretch, 1.0 - off.stretch)
    moved = arm @ np.array([[cosine, sine], [-sine, cosine]]) + _MIDDLE_PX + off.shift_px
    return np.asarray(moved + generator.normal(0.0, off.scatter_px, grid_px.shape))


def _tear(surface: Picture) -> Picture:
    v, u = np.mgrid[: surface.shape[0], : surface.shape[1]]
    is_gone = np.hypot(u - _TORN_AT_PX[0], v - _TORN_AT_PX[1]) < _TORN_PX
    return np.where(is_gone[..., None], np.uint8(25), surface)
