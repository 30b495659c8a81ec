"""What stands on the player's stage at the end of an episode: the parts, the gels in colours, and the gripper.

Sizes and colours are in `stage.json`, which `viewer` reads, too. Called by `still`.
"""

import json
from itertools import product
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..drawing.playback import EpisodePlayback, Moment
from ..drawing.projection import PictureCrop
from ..drawing.scene_view import displacement_m
from ..geometry.solid import prism_faces, rectangle, solid_from_faces
from ..scene.gripper import SensorPose
from ..vision.camera import Sight
from ..vision.still import cut_open
from .scene import Changes, PlaybackTooLarge, look_up_perspective, pack

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

LOOK: Final[dict[str, Any]] = json.loads(Path(__file__).with_name("stage.json").read_text(encoding="utf-8"))
"""Sizes of the gripper's parts [mm], as a share of the housing's depth where the finger stands, and colours."""


class Part(NamedTuple):
    """A closed surface; `rgb` is of all its triangles or of each, `section` that of its inside where it is cut open."""

    vertices_m: FloatArray
    triangles: IndexArray
    rgb: FloatArray
    section: FloatArray | None = None
    is_inked: bool = False


class _Box(NamedTuple):
    """A box along the axes of a pose, in a colour of `LOOK`: its lengths and its middle in that frame [mm]."""

    colour: str
    lengths_mm: FloatArray
    middle_mm: FloatArray
    pose: SensorPose

    def corners_mm(self) -> FloatArray:
        """Return its corners in the frame of its pose, shape [8, 3]."""
        return 0.5 * np.array(tuple(product((-1.0, 1.0), repeat=3))) * self.lengths_mm + self.middle_mm

    def part(self) -> Part:
        """Return its surface in the world."""
        x, y, z = 0.5 * self.lengths_mm
        solid = solid_from_faces(prism_faces(rectangle(-x, x, -y, y), -z, z), "box")
        placed_m = _placed(solid.vertices_m + 1e-3 * self.middle_mm, self.pose)
        return Part(placed_m, solid.triangles, linear(LOOK[self.colour]))


def list_framed_points(playback: EpisodePlayback) -> FloatArray:
    """Return the points that the player's camera has in its picture: the parts and the gripper at both ends [m]."""
    ends = (playback.moments[0], playback.moments[-1])
    return np.concatenate(
        [
            _fixed(playback)[0],
            *(moment.held_m for moment in ends),
            *(_corners_of_gripper(playback, moment) for moment in ends),
        ]
    )


def _fixed(playback: EpisodePlayback) -> tuple[FloatArray, IndexArray]:
    """Return vertices [m] and triangles of the fixed part, cut open where its task says so."""
    perspective, surface = look_up_perspective(playback.env_id), (playback.fixed_m, playback.fixed.triangles)
    return surface if perspective is None else cut_open(*surface, perspective.cut)


def list_parts(playback: EpisodePlayback) -> list[Part]:
    """Return everything that is seen; gels are coloured by displacement, on the scale of the episode."""
    moment, gel = playback.moments[-1], playback.gel
    parts = [
        Part(*_fixed(playback), linear(LOOK["fixed"]), linear(LOOK["fixed_section"]), is_inked=True),
        Part(moment.held_m, playback.held.triangles, linear(LOOK["held"]), is_inked=True),
    ]
    moved_m = [
        [
            displacement_m(gel.rest_position_m, nodes_m, pose.rotation, pose.centre_m)
            for nodes_m, pose in zip(found.gel_nodes_m, found.sensor_poses, strict=True)
        ]
        for found in playback.moments
    ]
    largest_m = max(float(np.max(moved_m)), 1e-9)
    stops = np.array([linear(colour) for colour in LOOK["displacement"]])
    for nodes_m, own_m in zip(moment.gel_nodes_m, moved_m[-1], strict=True):
        level = own_m[gel.surface_triangles].mean(axis=1) / largest_m * (len(stops) - 1)
        rgb = np.column_stack([np.interp(level, np.arange(len(stops)), stops[:, channel]) for channel in range(3)])
        parts.append(Part(nodes_m, gel.surface_triangles, rgb))
    return parts + [box.part() for box in _gripper(playback, moment)]


def _gripper(playback: EpisodePlayback, moment: Moment) -> list[_Box]:
    """Return housing, frame and finger behind each gel, and last the palm, away from the fixed part."""
    left, right = moment.sensor_poses
    first = playback.moments[0].sensor_poses[0]
    fixed_m = 0.5 * (playback.fixed_m.min(axis=0) + playback.fixed_m.max(axis=0))
    along = -1.0 if (fixed_m - first.centre_m) @ first.rotation[:, 0] > 0.0 else 1.0
    back = 1e3 * float(playback.gel.rest_position_m[:, 2].min())
    length, width, depth = LOOK["housing_mm"]
    rim, inset, finger = LOOK["rim_mm"], 2.0 * LOOK["rim_inset_mm"], LOOK["finger_mm"]
    finger_x = along * (0.5 * (length + finger[0]) - LOOK["finger_overlap_mm"])
    boxes = (
        ("shell", (length, width, depth), (0.0, 0.0, back - 0.5 * depth - rim)),
        ("metal", (length - inset, width - inset, rim), (0.0, 0.0, back - 0.5 * rim)),
        ("metal", finger, (finger_x, 0.0, back - rim - LOOK["finger_depth"] * depth)),
    )
    apart = 1e3 * float(np.linalg.norm(left.centre_m - right.centre_m))
    middle = SensorPose(rotation=left.rotation, centre_m=0.5 * (left.centre_m + right.centre_m))
    palm_x = along * (0.5 * length + finger[0] - LOOK["palm_overlap_mm"])
    palm_mm = np.array([*LOOK["palm_mm"], apart + 2.0 * depth])
    fingers = [
        _Box(colour, np.array(size), np.array(place), pose) for pose in (left, right) for colour, size, place in boxes
    ]
    return [*fingers, _Box("shell", palm_mm, np.array([palm_x, 0.0, 0.0]), middle)]


def _corners_of_gripper(playback: EpisodePlayback, moment: Moment) -> FloatArray:
    """Return the corners of a box around each sensor with its finger, and of the palm [m]."""
    *sensors, palm = _gripper(playback, moment)
    corners = []
    for group in (sensors[:3], sensors[3:], [palm]):
        corners_mm = np.concatenate([box.corners_mm() for box in group])
        low, high = corners_mm.min(axis=0), corners_mm.max(axis=0)
        around = group[0]._replace(lengths_mm=high - low, middle_mm=0.5 * (low + high))
        corners.append(_placed(1e-3 * around.corners_mm(), around.pose))
    return np.concatenate(corners)


def _placed(own_m: FloatArray, pose: SensorPose) -> FloatArray:
    return np.asarray(own_m @ pose.rotation.T + pose.centre_m)


def linear(colour: str) -> FloatArray:
    """Return the light of a colour of screens such as #22262b (IEC 61966-2-1), red, green and blue in 0 to 1."""
    shown = np.frombuffer(bytes.fromhex(colour[1:]), dtype=np.uint8) / 255.0
    return np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)


CAMERAS_BYTES: Final = 512 << 10
"""Most that the file may have; pictures with the noise of stereo depth take about 7 kB for each env step."""
_EVERY_PX = (1, 2, 4)
"""Intervals of pixels that are tried until the file is small enough."""
_COLOUR_MASKS = (0xFF, 0xF8, 0xF0, 0xE0, 0xC0)
"""Bits of red, green and blue that are tried until a palette holds all colours."""
_PALETTE = 256
_DEPTH_LEVELS = 254
"""Depths are 1 to 255 between the nearest and the farthest; 0 is unknown."""


def pack_cameras(playback: EpisodePlayback, *, at_most: int = CAMERAS_BYTES) -> bytes | None:
    """Return the file of an episode; None where the task has no camera rig.

    Args:
        playback: the episode.
        at_most: size of the file [bytes].

    Raises:
        PlaybackTooLarge: even with few pixels it is larger.
    """
    moments = [playback.moments[index] for index in playback.last_moments]
    sights = [moment.sight for moment in moments if moment.sight is not None]
    if not sights:
        return None
    frame, size = PictureCrop.around(sights), 0
    for every in _EVERY_PX:
        content = _packed(sights, frame, every)
        size = len(content)
        if size <= at_most:
            return content
    raise PlaybackTooLarge(f"Expected camera pictures of at most {at_most} bytes, got {size} for {len(sights)} looks.")


def _packed(sights: list[Sight], frame: PictureCrop, every_px: int) -> bytes:
    rows, columns = (slice(part.start, part.stop, every_px) for part in (frame.rows, frame.columns))
    palette, indices = _indexed(np.stack([sight.colours[rows, columns] for sight in sights]))
    depths_mm = 1e3 * np.stack([sight.depth_m[rows, columns] for sight in sights]).astype(np.float64)
    header = {
        "first_row": frame.rows.start,
        "first_column": frame.columns.start,
        "every_px": every_px,
        "nearest_mm": frame.nearest_mm,
        "farthest_mm": frame.farthest_mm,
    }
    arrays: dict[str, NDArray[Any] | Changes] = {
        "palette": palette,
        "colours": Changes(values=indices),
        "depths": _depth_levels(depths_mm, frame),
    }
    return pack(header, arrays)


def _indexed(colours: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return a palette, shape [p, 3], and the index of each pixel's colour in it, [..., 3] to [...]."""
    for mask in _COLOUR_MASKS:
        palette, indices = np.unique((colours & mask).reshape(-1, 3), axis=0, return_inverse=True)
        if len(palette) <= _PALETTE:
            break
    return palette, indices.reshape(colours.shape[:-1]).astype(np.uint8)


def _depth_levels(depths_mm: NDArray[np.float64], frame: PictureCrop) -> NDArray[np.uint8]:
    reach_mm = max(frame.farthest_mm - frame.nearest_mm, 1e-3)
    levels = 1 + np.rint((depths_mm - frame.nearest_mm) / reach_mm * _DEPTH_LEVELS)
    return np.where(depths_mm > 0, np.clip(levels, 1, 1 + _DEPTH_LEVELS), 0).astype(np.uint8)
