"""The file of an episode's scene: bodies, moments, and the contact forces on the held part as few arrows.

Its format, which `viewer/container.js` reads: after the magic come the length of a JSON header as a 32-bit number, the
header, and the bytes of named arrays, little-endian, each at a multiple of four bytes from the end of the header, which
is padded to such a multiple itself; all compressed with gzip.
"""

import gzip
import json
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from vitac.errors import VitacError

from ..drawing.drawable import NotDrawable, find_perspective
from ..drawing.playback import EpisodePlayback, Moment
from ..drawing.scene_view import cauchy_stress_pa, contact_pressure_pa, deformation_gradients, nodal_means
from ..fem.contact.forces import PairForces
from ..scene.gripper import SENSOR_COUNT
from ..scene.perspective import Perspective
from ..tactile.markers import SensingSurface
from ..tasks.definition import LARGEST_SURFACE_DIFF_M
from ..tasks.registry import task_definitions

FloatArray = NDArray[np.float64]


PLACES: Final = 6
"""Most places at which the held part is shown to touch the fixed one."""
_HELD, _FIXED = SENSOR_COUNT, SENSOR_COUNT + 1
_REACH_M = 2e-3
"""Contacts within this distance of the strongest one become one arrow."""


def make_arrows(found: PairForces) -> tuple[FloatArray, FloatArray]:
    """Return where forces act on the held part [m] and how large they are [N], shapes [2 + PLACES, 3].

    First those of the left and the right gel, then those of the fixed part, the strongest contact's first; rows without
    a force are zero. A place is the mean of the contacts that its arrow adds up, weighted by their forces.
    """
    places, forces = np.zeros((SENSOR_COUNT + PLACES, 3)), np.zeros((SENSOR_COUNT + PLACES, 3))
    for gel in range(SENSOR_COUNT):
        points_m, forces_n = _select_on_held(found, gel)
        if len(points_m):
            places[gel], forces[gel] = _add_up(points_m, forces_n)
    points_m, forces_n = _select_on_held(found, _FIXED)
    for row in range(SENSOR_COUNT, SENSOR_COUNT + PLACES):
        if not len(points_m):
            break
        strongest = points_m[np.square(forces_n).sum(axis=1).argmax()]
        near = np.square(points_m - strongest).sum(axis=1) <= _REACH_M**2
        places[row], forces[row] = _add_up(points_m[near], forces_n[near])
        points_m, forces_n = points_m[~near], forces_n[~near]
    return places, forces


def _select_on_held(forces: PairForces, other: int) -> tuple[FloatArray, FloatArray]:
    """Return the places [m] and forces [N] of contacts on the held part with another body."""
    first, second = forces.bodies.T
    acts = (first == _HELD) & (second == other)
    reacts = (first == other) & (second == _HELD)
    return (
        np.concatenate([forces.points_m[acts], forces.points_m[reacts]]),
        np.concatenate([forces.forces_n[acts], -forces.forces_n[reacts]]),
    )


def _add_up(points_m: FloatArray, forces_n: FloatArray) -> tuple[FloatArray, FloatArray]:
    weights = np.sqrt(np.square(forces_n).sum(axis=1))[:, None]
    return (weights * points_m).sum(axis=0) / weights.sum(), forces_n.sum(axis=0)


SCENE_BYTES: Final = 200_000
"""Most that the file may have; about 10 kB is usual."""
DISPLACEMENT_UNIT_MM: Final = 0.001
FLOW_UNIT_PX: Final = 1.0 / 64.0
ACTION_DECIMALS: Final = 2
"""Decimals of actions, which are in [-1, 1], of rewards, of positions and heights [mm], and of forces [N]."""
ROTATION_DECIMALS: Final = 4
_DECIMALS = 3
"""Decimals of the curves of observables, in the units of these."""
_PRESSURE_LEVELS = 255
_EVERY = (1, 2, 4, 8)
"""Intervals of IPC steps that are tried until the file is small enough; the end of each env step is always kept."""
DEFAULT_VIEW = (-38.0, 24.0)
"""Azimuth and elevation [deg] for a task without a perspective."""


def pack_scene(playback: EpisodePlayback, *, at_most: int = SCENE_BYTES) -> bytes:
    """Return the file of an episode.

    Args:
        playback: the episode.
        at_most: size of the file [bytes].

    Raises:
        PlaybackTooLarge: even with few moments between env steps it is larger.
    """
    ends = set(playback.last_moments)
    size = 0
    for every in _EVERY:
        kept = [index for index in range(len(playback.moments)) if index in ends or index % every == 0]
        content = _packed(playback, [playback.moments[index] for index in kept])
        size = len(content)
        if size <= at_most:
            return content
    raise PlaybackTooLarge(f"Expected a playback of at most {at_most} bytes, got {size} for {len(ends) - 1} env steps.")


def _packed(playback: EpisodePlayback, moments: list[Moment]) -> bytes:
    ends = [playback.moments[index] for index in playback.last_moments]
    surface = np.unique(playback.gel.surface_triangles)
    pressures_pa = np.array([_pressures_pa(playback, moment) for moment in moments])
    pressure_unit_pa = max(float(pressures_pa.max()), 1.0) / _PRESSURE_LEVELS
    flows = np.stack([moment.marker_flow for moment in ends])
    perspective = look_up_perspective(playback.env_id)
    curves = [(entry.name, curve) for entry in playback.plotted for curve in entry.curves]
    header = {
        "env_id": playback.env_id,
        "end_reason": ends[-1].end_reason,
        "actions": [
            {"name": component.name, "unit": component.unit, "scale": component.scale}
            for component in task_definitions()[playback.env_id].actions
        ],
        "displacement_unit_mm": DISPLACEMENT_UNIT_MM,
        "flow_unit_px": FLOW_UNIT_PX,
        "pressure_unit_kpa": 1e-3 * pressure_unit_pa,
        "sensor_camera": list(playback.camera),
        "surface_limit_mm": 1e3 * LARGEST_SURFACE_DIFF_M,
        "force_limit_n": ends[-1].info.get("force_limit_n"),
        "curves": [{"title": curve.title, "names": curve.names} for _, curve in curves],
        **_described(perspective, ends),
    }
    arrays: dict[str, NDArray[Any] | Changes] = {
        "moment_env_steps": np.array([moment.env_step for moment in moments], dtype=np.uint16),
        "gel_nodes_mm": _mm(playback.gel.rest_position_m[surface]),
        "gel_triangles": np.searchsorted(surface, playback.gel.surface_triangles).astype(np.uint16),
        "sensing_nodes": np.searchsorted(surface, playback.gel.sensing_nodes).astype(np.uint16),
        "sensor_poses": _rounded_poses([_sensor_poses_mm(moment) for moment in moments]),
        "displacements": Changes(
            values=whole_numbers(
                [_displacements_mm(playback, moment, surface) for moment in moments], DISPLACEMENT_UNIT_MM, np.int16
            )
        ),
        "pressures": Changes(values=whole_numbers(pressures_pa, pressure_unit_pa, np.uint8)),
        "held_vertices_mm": _mm(playback.held.vertices_m),
        "held_triangles": playback.held.triangles.astype(np.uint16),
        "measured_vertices": playback.measured.astype(np.uint16),
        "held_poses": _rounded_poses([_held_pose_mm(playback, moment) for moment in moments]),
        "fixed_vertices_mm": _mm(playback.fixed_m),
        "fixed_triangles": playback.fixed.triangles.astype(np.uint16),
        "flow_references": Changes(values=whole_numbers(flows[:, :, 0], FLOW_UNIT_PX, np.int16)),
        "flow_positions": Changes(values=whole_numbers(flows[:, :, 1], FLOW_UNIT_PX, np.int16)),
        "lost_markers": whole_numbers(_same_number([moment.lost_px for moment in ends]), FLOW_UNIT_PX, np.int16),
        "action_values": _rounded(playback.actions),
        "rewards": _rounded(playback.rewards),
        "surface_motions_mm": np.array([1e3 * moment.info["surface_diff_m"] for moment in ends], dtype=np.float32),
    }
    bends_mm = np.array([_own_displacements_mm(playback, moment) for moment in moments])
    if np.abs(bends_mm).max() > DISPLACEMENT_UNIT_MM:
        arrays["held_displacements"] = Changes(values=whole_numbers(bends_mm, DISPLACEMENT_UNIT_MM, np.int16))
    shifts_mm = np.array([1e3 * moment.fixed_shift_m for moment in moments])
    if shifts_mm.any():
        arrays["fixed_shifts_mm"] = _rounded(shifts_mm)
    arrows = [make_arrows(moment.pair_forces) for moment in moments]
    arrays["arrow_places_mm"] = _rounded(np.array([1e3 * places_m for places_m, _ in arrows]))
    arrays["arrow_forces_n"] = _rounded(np.array([forces_n for _, forces_n in arrows]))
    arrays["forces_n"] = _rounded(np.array([np.linalg.norm(moment.contact_forces_n, axis=1) for moment in moments]))
    for number, (name, curve) in enumerate(curves):
        arrays[f"curves_{number}"] = _rounded(np.array([curve.read(moment.info[name]) for moment in ends]), _DECIMALS)
    if perspective is not None:
        heights = [perspective.progress.heights_mm(moment.info) for moment in ends]
        arrays["heights_mm"] = _rounded(np.array(heights))
    return pack(header, arrays)


def _same_number(lost_px: Sequence[Sequence[FloatArray]]) -> FloatArray:
    """Return lost markers after each env step, filled up to the largest number far outside, shape [n, 2, l, 2]."""
    most = max(len(side_px) for both_px in lost_px for side_px in both_px)
    filled = np.full((len(lost_px), 2, most, 2), -np.inf)
    for step, both_px in enumerate(lost_px):
        for side, side_px in enumerate(both_px):
            filled[step, side, : len(side_px)] = side_px
    return filled


def look_up_perspective(env_id: str) -> Perspective | None:
    """Return how a task is looked at; None where it does not say."""
    try:
        return find_perspective(env_id)
    except NotDrawable:
        return None


def _described(perspective: Perspective | None, ends: list[Moment]) -> dict[str, Any]:
    if perspective is None:
        return {"held_name": "held part", "fixed_name": "fixed part", "view_deg": DEFAULT_VIEW}
    progress = perspective.progress
    return {
        "held_name": perspective.held_name,
        "fixed_name": perspective.fixed_name.partition(",")[0],
        "view_deg": (perspective.azimuth_deg, perspective.elevation_deg),
        "cut": {"normal": perspective.cut.normal, "offset_mm": 1e3 * perspective.cut.offset_m},
        "heights_title": progress.title,
        "heights_goal_mm": progress.goal_mm,
        "positions": [perspective.position(moment.info) for moment in ends],
    }


def _rounded(values: NDArray[np.floating[Any]], decimals: int = ACTION_DECIMALS) -> NDArray[np.float32]:
    return values.round(decimals).astype(np.float32)


def _rounded_poses(poses_mm: list[FloatArray]) -> NDArray[np.float32]:
    """Return poses, nine numbers of a rotation and three of a place each, as exactly as they are shown."""
    poses = np.array(poses_mm)
    return np.concatenate([_rounded(poses[..., :9], ROTATION_DECIMALS), _rounded(poses[..., 9:])], axis=-1)


def _mm(lengths_m: FloatArray) -> NDArray[np.float32]:
    return (1e3 * lengths_m).astype(np.float32)


def _sensor_poses_mm(moment: Moment) -> FloatArray:
    """Return world from gel of both sensors: the rotation's rows, then the place [mm], shape [2, 12]."""
    return np.array([[*pose.rotation.ravel(), *(1e3 * pose.centre_m)] for pose in moment.sensor_poses])


def _displacements_mm(playback: EpisodePlayback, moment: Moment, surface: NDArray[np.int64]) -> FloatArray:
    """Return how far each node is from where the undeformed gel has it, in the gel's frame [mm], shape [2, s, 3]."""
    pairs = zip(moment.gel_nodes_m, moment.sensor_poses, strict=True)
    rest_m = playback.gel.rest_position_m[surface]
    return np.array([1e3 * ((nodes_m[surface] - pose.centre_m) @ pose.rotation - rest_m) for nodes_m, pose in pairs])


def _pressures_pa(playback: EpisodePlayback, moment: Moment) -> FloatArray:
    """Return the contact pressure at the sensing nodes of both gels [Pa], shape [2, s]."""
    gel = playback.gel
    triangles = SensingSurface.from_gel(gel).triangles
    pressures = []
    for nodes_m in moment.gel_nodes_m:
        stress_pa = cauchy_stress_pa(
            deformation_gradients(gel.rest_position_m, nodes_m, gel.tetrahedra),
            youngs_modulus_pa=playback.physics.youngs_modulus_pa,
            poisson_ratio=playback.physics.poisson_ratio,
        )
        nodal_pa = nodal_means(stress_pa, gel.rest_position_m, gel.tetrahedra)
        sensing = gel.sensing_nodes
        pressures.append(contact_pressure_pa(nodal_pa[sensing], nodes_m[sensing], triangles))
    return np.array(pressures)


def _held_pose_mm(playback: EpisodePlayback, moment: Moment) -> FloatArray:
    """Return the affine map of the held part from its own frame: its matrix' rows, then the place [mm], shape [12]."""
    own_mm = 1e3 * playback.held.vertices_m
    homogeneous = np.column_stack([own_mm, np.ones(len(own_mm))])
    solution = np.linalg.lstsq(homogeneous, 1e3 * moment.held_m)[0]
    return np.concatenate([solution[:3].T.ravel(), solution[3]])


def _own_displacements_mm(playback: EpisodePlayback, moment: Moment) -> FloatArray:
    """Return how far a soft part's vertices are in its own frame from where its affine map has them [mm], [v, 3]."""
    pose = _held_pose_mm(playback, moment)
    own_mm = np.linalg.solve(pose[:9].reshape(3, 3), (1e3 * moment.held_m - pose[9:]).T).T
    return np.asarray(own_mm - 1e3 * playback.held.vertices_m)


MAGIC: Final = b"VITACPB1"
_LENGTH = struct.Struct("<I")
_ALIGNMENT = 4
_TYPES = frozenset({"uint8", "int16", "uint16", "float32"})


class PlaybackTooLarge(VitacError):
    """An episode does not fit into a playback file; the message says how large it may be."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Changes:
    """An array of whole numbers that is stored as the changes along its first axis, which compress well.

    Attributes:
        values: shape [n, ...].
    """

    values: NDArray[Any]


def pack(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any] | Changes]) -> bytes:
    """Return a file with a header and arrays of the types uint8, int16, uint16 and float32."""
    described: dict[str, Any] = {}
    body = bytearray()
    for name, array in arrays.items():
        are_changes = isinstance(array, Changes)
        values = array.values if isinstance(array, Changes) else array
        assert values.dtype.name in _TYPES, f"{name} is of {values.dtype}"  # noqa: S101 - our own callers
        # Whole numbers wrap around, so the sum of the changes gives the values back.
        stored = np.diff(values, axis=0, prepend=np.zeros_like(values[:1])) if are_changes else values
        described[name] = {"type": values.dtype.name, "shape": values.shape, "at": len(body), "changes": are_changes}
        body += _padded(np.ascontiguousarray(stored, dtype=values.dtype.newbyteorder("<")).tobytes(), b"\0")
    text = _padded(json.dumps(dict(header) | {"arrays": described}, allow_nan=False).encode(), b" ")
    return gzip.compress(MAGIC + _LENGTH.pack(len(text)) + text + body, compresslevel=9, mtime=0)


def whole_numbers(values: ArrayLike, unit: float, dtype: type[np.integer[Any]]) -> NDArray[Any]:
    """Return values as multiples of a unit, those beyond the range of the type at its ends."""
    limits = np.iinfo(dtype)
    return np.clip(np.rint(np.asarray(values, dtype=np.float64) / unit), limits.min, limits.max).astype(dtype)


def _padded(content: bytes, with_byte: bytes) -> bytes:
    return content + with_byte * (-len(content) % _ALIGNMENT)
